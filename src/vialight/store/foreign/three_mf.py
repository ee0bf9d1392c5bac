"""Meshes from 3MF, as they are to be built: read in one pass, with no more in memory than the mesh that comes of it.

Written here and not by trimesh, which unpacks whatever an archive holds, and follows each way through components that
name each other, of which there may be as many as two to the power of their count.
"""

from __future__ import annotations

import math
import zipfile
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import IO, BinaryIO, NamedTuple
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import InputError
from vialight.system import need_memory, open_archive

_MM = {"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1000.0}
_MM |= {f"{name}s": mm for name, mm in _MM.items()} | {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "inches": 25.4}
"""Beside the names of the standard those that programs are known to write."""
_MODEL = "3d/3dmodel.model"
_MOST_PARTS, _MOST_INSTANCES, _MOST_TRIANGLES = 1000, 100_000, 50_000_000
_DEEPEST = 32
_LEAST_BYTES, _MOST_PACKED = 32_000_000, 30
"""Text that any file may unpack to, and times that a file's own size may be; meshes are packed to a tenth."""
_TRIANGLE_BYTES = 200
_AT_ONCE, _LONGEST_TAG = 1 << 18, 1 << 20
"""Text that is parsed at once, and from one tag to the next: a tag that is not yet whole is read anew each time."""

_Key = tuple[str, str]
"""Part of the archive, and the number of an object in it."""


class _Use(NamedTuple):
    """An object as it is used in another, or in what is built."""

    key: _Key
    turn: NDArray[np.float64]
    """(3, 3) that rows of coordinates are multiplied by."""
    shift: NDArray[np.float64]


@dataclass
class _Object:
    vertices: array[float] = field(default_factory=lambda: array("d"))
    corners: array[int] = field(default_factory=lambda: array("q"))
    components: list[_Use] = field(default_factory=list)


def read_3mf(file: BinaryIO, where: object) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read all that a 3MF has to be built, in mm.

    Parameters
    ----------
    file
        Open for reading.
    where
        Named in errors.

    Returns
    -------
    vertices_mm : numpy.ndarray
        (n, 3) float64.
    faces : numpy.ndarray
        (m, 3) int64, in the order of the file.

    Raises
    ------
    InputError
        It would unpack to much more than meshes do, is built of objects without end, or of a unit that is not known.
    Exception
        It is no 3MF; zip, XML and numbers fail in as many ways as files are broken.
    """
    size = file.seek(0, 2)
    with open_archive(file, where, most_bytes=_LEAST_BYTES + _MOST_PACKED * size) as archive:
        model = _Model(archive, where)
    triangles, instances = model.size_of_build()
    if triangles > _MOST_TRIANGLES or instances > _MOST_INSTANCES:
        raise InputError(
            where,
            f"is built of {instances:.4g} objects with {triangles:.4g} triangles",
            accepted=f"{_MOST_INSTANCES} objects, {_MOST_TRIANGLES:.0e} triangles at most",
            remedy="export it as one mesh",
        )
    need_memory(_TRIANGLE_BYTES * triangles, where, "its mesh", "export it more coarsely")
    return model.built()


class _Model:
    """The objects of a 3MF and what is built of them."""

    def __init__(self, archive: zipfile.ZipFile, where: object) -> None:
        self._where = where
        self.objects: dict[_Key, _Object] = {}
        self.build: list[_Use] = []
        self.uses = 0
        """Components and items."""
        self.mm = 1.0
        names = {name.strip("/").lower(): name for name in archive.namelist()}
        main = next((name for name in names if name.endswith(_MODEL)), None)
        if main is None:
            raise ValueError("it holds no model")
        waiting, read = [main], set[str]()
        while waiting:
            part = waiting.pop()
            if part in read or part not in names:
                continue
            if len(read) >= _MOST_PARTS:
                raise ValueError(f"it has more than {_MOST_PARTS} parts")
            read.add(part)
            reader = _PartReader(self, part, is_main=part == main)
            with archive.open(names[part]) as member:
                reader.read(member)
            waiting.extend(sorted(reader.named))

    def size_of_build(self) -> tuple[float, float]:
        """Return triangles and objects with triangles that are to be built, counted without building anything.

        Uses of which no triangles come are dropped: others may name them more often than could ever be followed.
        """

        @cache
        def size_of(key: _Key, depth: int) -> tuple[float, float]:
            if depth > _DEEPEST:
                raise InputError(
                    self._where, "is built of objects in circles, or too deep", accepted=f"{_DEEPEST} levels at most"
                )
            held = self.objects.get(key, _Object())
            triangles, instances = len(held.corners) / 3, float(len(held.corners) > 0)
            held.components, inner_triangles, inner_instances = total(held.components, depth + 1)
            return triangles + inner_triangles, instances + inner_instances

        def total(uses: list[_Use], depth: int) -> tuple[list[_Use], float, float]:
            sizes = [size_of(use.key, depth) for use in uses]
            kept = [use for use, (triangles, _) in zip(uses, sizes, strict=True) if triangles]
            return kept, sum(size[0] for size in sizes), sum(size[1] for size in sizes)

        self.build, triangles, instances = total(self.build, 0)
        return triangles, instances

    def built(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return vertices in mm and faces of all that is built."""
        vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
        for use in self.build:
            for points, corners in self._instances(use):
                if corners.min() < 0 or corners.max() >= len(points):
                    raise ValueError(f"its triangles name vertices {corners.min()} to {corners.max()}")
                vertices.append(points * self.mm)
                faces.append(corners + count)
                count += len(points)
        return np.concatenate(vertices), np.concatenate(faces)

    def _instances(self, use: _Use) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
        held = self.objects[use.key]
        is_mirrored = np.linalg.det(use.turn) < 0
        if len(held.corners):
            points = np.frombuffer(held.vertices).reshape(-1, 3)
            corners = np.frombuffer(held.corners, np.int64).reshape(-1, 3)
            yield points @ use.turn + use.shift, corners[:, ::-1] if is_mirrored else corners
        for inner in held.components:
            for points, corners in self._instances(inner):
                yield points @ use.turn + use.shift, corners[:, ::-1] if is_mirrored else corners


class _PartReader:
    """Takes in one part of a 3MF: an XML text of which nothing is kept but numbers."""

    def __init__(self, model: _Model, part: str, *, is_main: bool) -> None:
        self._model, self._part, self._is_main = model, part, is_main
        self._object: _Object | None = None
        self._since_tag = 0
        self.named: set[str] = set()
        """Parts that this one takes objects from."""

    def read(self, file: IO[bytes]) -> None:
        parser = expat.ParserCreate(namespace_separator=" ")
        parser.StartElementHandler = self._start
        parser.StartDoctypeDeclHandler = self._refuse
        while piece := file.read(_AT_ONCE):
            parser.Parse(piece, False)
            self._since_tag += len(piece)
            if self._since_tag > _LONGEST_TAG:
                raise ValueError(f"it has no tag in {self._since_tag} bytes of text")
        parser.Parse(b"", True)

    @staticmethod
    def _refuse(*_: object) -> None:
        raise ValueError("it declares a document type, which 3MF forbids")

    def _start(self, name: str, given: dict[str, str]) -> None:
        self._since_tag = 0
        kind = name.rpartition(" ")[2]
        held = self._object
        if kind == "vertex" and held is not None:
            held.vertices.extend((float(given["x"]), float(given["y"]), float(given["z"])))
        elif kind == "triangle" and held is not None:
            held.corners.extend((int(given["v1"]), int(given["v2"]), int(given["v3"])))
        elif kind == "object":
            self._object = self._model.objects.setdefault((self._part, given["id"]), _Object())
        elif kind == "component" and held is not None:
            held.components.append(self._use(given))
        elif kind == "item" and self._is_main:
            self._model.build.append(self._use(given))
        elif kind == "model" and self._is_main:
            unit = given.get("unit", "millimeter")
            if unit not in _MM:
                raise ValueError(f"its unit is {unit[:40]!r}, and not one of {', '.join(_MM)}")
            self._model.mm = _MM[unit]

    def _use(self, given: dict[str, str]) -> _Use:
        path = next((value for name, value in given.items() if name.endswith(" path")), None)
        part = self._part if path is None else path.strip("/").lower()
        self.named.add(part)
        self._model.uses += 1
        if self._model.uses > _MOST_INSTANCES:
            raise ValueError(f"it names objects more than {_MOST_INSTANCES} times")
        numbers = [float(number) for number in given.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()]
        if len(numbers) != 12 or not all(map(math.isfinite, numbers)):
            raise ValueError("a transform is not of 12 numbers")
        return _Use((part, given["objectid"]), np.reshape(numbers[:9], (3, 3)), np.array(numbers[9:]))
