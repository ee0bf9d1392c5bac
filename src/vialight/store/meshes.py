"""Surfaces as binary STL and PLY.

Written here and not by trimesh: its STL has no header of ours, and its PLY has no comment for the unit.  Coordinates
are single precision in both, 1e-6 mm on a part of 20 mm.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vialight.core.errors import InputError
from vialight.store.folders import staged_file

if TYPE_CHECKING:
    from vialight.core.mesh import Mesh

_STL_HEADER = b"vialight: binary STL, lengths in mm"
"""Not to begin with `solid`, by which many readers tell ASCII."""
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PLY_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
_PLY_RESERVED = {"x", "y", "z", "red", "green", "blue", "alpha", "nx", "ny", "nz"}


def write_stl(path: str | Path, mesh: Mesh) -> None:
    """Write a mesh as binary STL, in mm.

    Parameters
    ----------
    path
        The file to make; it appears whole, or not at all.
    mesh
        Its faces keep their order and sense.

    Raises
    ------
    InputError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from vialight.core.mesh import Mesh
    >>> from vialight.store.foreign.meshes import load_mesh
    >>> corner = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> path = Path(tempfile.mkdtemp()) / "corner.stl"
    >>> write_stl(path, corner)
    >>> load_mesh(path).volume_mm3
    4.0
    """
    triangles = np.zeros(len(mesh.faces), dtype=_STL_TRIANGLE)
    triangles["normal"] = mesh.face_normals
    triangles["corners"] = mesh.corners_mm
    header = _STL_HEADER.ljust(80) + len(triangles).to_bytes(4, "little")
    _write(path, header, triangles)


def write_ply(
    path: str | Path,
    mesh: Mesh,
    scalars: Mapping[str, ArrayLike] | None = None,
    colours: NDArray[np.uint8] | None = None,
) -> None:
    """Write a mesh as binary PLY, in mm, with values and colours at its vertices.

    Parameters
    ----------
    path
        The file to make; it appears whole, or not at all.
    mesh
        Its vertices and faces keep their order.
    scalars
        Names, of letters, digits and underscores, and (n,) values; stored in float32.
    colours
        (n, 3) uint8: red, green, blue.

    Raises
    ------
    InputError
        Values or colours do not fit the vertices, a name cannot be stored, or the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from vialight.core.mesh import Mesh
    >>> triangle = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 1, 2]])
    >>> path = Path(tempfile.mkdtemp()) / "triangle.ply"
    >>> write_ply(path, triangle, {"deviation_mm": [0.1, 0.0, -0.1]}, np.full((3, 3), 255, np.uint8))
    >>> path.read_bytes().splitlines()[8]
    b'property uchar red'
    """
    count = len(mesh.vertices_mm)
    columns: dict[str, NDArray[Any]] = {name: mesh.vertices_mm[:, axis] for axis, name in enumerate("xyz")}
    for name, values in (scalars or {}).items():
        if not (name.isascii() and name.isidentifier()) or name in _PLY_RESERVED:
            raise InputError(
                path, f"{name!r} cannot name a scalar", accepted="letters, digits and underscores, but not x, red, ..."
            )
        columns[name] = np.asarray(values)
        if columns[name].shape != (count,):
            raise InputError(path, f"{name} has the shape {columns[name].shape}", accepted=f"({count},), one a vertex")
    types = [(name, "<f4") for name in columns]
    if colours is not None:
        if colours.shape != (count, 3) or colours.dtype != np.uint8:
            raise InputError(
                path, f"colours are {colours.dtype} of shape {colours.shape}", accepted=f"uint8 of shape ({count}, 3)"
            )
        columns |= {name: colours[:, channel] for channel, name in enumerate(("red", "green", "blue"))}
        types += [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.empty(count, dtype=types)
    for name, values in columns.items():
        vertices[name] = values
    faces = np.empty(len(mesh.faces), dtype=_PLY_FACE)
    faces["count"] = 3
    faces["vertices"] = mesh.faces
    names = {"<f4": "float", "u1": "uchar"}
    header = [
        "ply", "format binary_little_endian 1.0", "comment vialight: lengths in mm", f"element vertex {count}",
        *(f"property {names[kind]} {name}" for name, kind in types),
        f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", "",
    ]  # fmt: skip
    _write(path, "\n".join(header).encode("ascii"), vertices, faces)


def _write(path: str | Path, header: bytes, *tables: NDArray[np.void]) -> None:
    with staged_file(path) as unfinished, unfinished.open("wb") as file:
        file.write(header)
        for table in tables:
            file.write(table.data)
