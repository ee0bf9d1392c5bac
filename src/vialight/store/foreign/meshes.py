"""Meshes of other programs, read."""

from __future__ import annotations

import io
import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import InputError
from vialight.core.mesh import Mesh, merge_coincident
from vialight.system import need_memory, open_plain

MESH_SUFFIXES = (".stl", ".ply", ".obj", ".3mf")
_STL_HEADER_BYTES = 84
_STL_TRIANGLE_BYTES = 50
_MOST_BYTES = 4_000_000_000
_COPIES = 12
"""Times its file that reading a mesh needs, some for a while only."""
_LONGEST_REASON = 200


def load_mesh(path: str | Path) -> Mesh:
    """Read a mesh as it stands: nothing is repaired, rescaled or reordered.

    Vertices that coincide exactly become one (STL has no shared vertices), in order of first appearance.  Files
    without a unit are taken to be in mm, as the whole field does; 3MF states one, and is converted to mm.

    Parameters
    ----------
    path
        STL (binary or ASCII), PLY, OBJ or 3MF.

    Raises
    ------
    InputError
        The file is missing, no mesh, empty, cut short, or holds coordinates that are not finite.
    """
    path = Path(path)
    if path.suffix.lower() not in MESH_SUFFIXES and (path.suffix or path.exists()):
        raise InputError(
            path, f"is not a kind of mesh file that can be read ({path.suffix or 'no suffix'})",
            accepted=", ".join(MESH_SUFFIXES), remedy="convert it",
        )  # fmt: skip
    try:
        with open_plain(path, _MOST_BYTES) as file:
            size = file.seek(0, 2)
            need_memory(_COPIES * size, path, "its mesh", "export it more coarsely")
            file.seek(0)
            content = file.read(size)
    except OSError as error:
        raise InputError(
            path, f"cannot be read ({error.strerror})", accepted="a mesh file", remedy="check the path"
        ) from error
    if not content:
        raise InputError(path, "is empty (0 bytes)", accepted="a mesh with faces", remedy="export it again")
    if path.suffix.lower() == ".stl":
        _check_stl_is_whole(path, content)
    vertices, faces = _parse(path, content)
    if not len(faces):
        raise InputError(path, "holds no triangles", accepted="a mesh with faces", remedy="export it again")
    try:
        return Mesh(*merge_coincident(vertices, faces))
    except InputError as error:
        raise InputError(path, str(error).removeprefix("mesh: ")) from error


def _check_stl_is_whole(path: Path, content: bytes) -> None:
    count = int.from_bytes(content[80:84], "little")
    expected = _STL_HEADER_BYTES + _STL_TRIANGLE_BYTES * count
    if content.lstrip()[:5].lower() == b"solid" and len(content) != expected:
        if b"facet" in content and b"endsolid" not in content[-4096:].lower():
            raise InputError(path, "is cut short: ASCII STL without endsolid", remedy="copy or export it again")
        if b"facet" not in content:
            raise InputError(path, "is not a mesh", accepted="STL, binary or ASCII", remedy="export it again")
    elif len(content) < _STL_HEADER_BYTES:
        raise InputError(path, f"is not a mesh ({len(content)} bytes)", accepted="STL, binary or ASCII")
    elif len(content) < expected:
        found = (len(content) - _STL_HEADER_BYTES) // _STL_TRIANGLE_BYTES
        raise InputError(
            path, f"is cut short, or not a mesh: {found} of {count} announced triangles are there",
            accepted="STL, binary or ASCII", remedy="copy or export it again",
        )  # fmt: skip


def _parse(path: Path, content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    kind = path.suffix.lower()
    try:
        if kind == ".3mf":
            from vialight.store.foreign.three_mf import read_3mf

            return read_3mf(io.BytesIO(content), path)
        import trimesh

        logging.getLogger("trimesh").setLevel(logging.CRITICAL)
        # From its content and not its path: OBJ and PLY may name other files, of materials and textures.
        options = {"skip_materials": True} if kind == ".obj" else {}
        loaded = trimesh.load_mesh(io.BytesIO(content), file_type=kind[1:], process=False, **options)
        return np.asarray(loaded.vertices, dtype=np.float64), np.asarray(loaded.faces, dtype=np.int64)
    except InputError:
        raise
    except ModuleNotFoundError as error:
        package = str(error).rpartition("named ")[2].strip("'")
        raise InputError(
            path, f"{path.suffix} needs the package {package}", accepted="STL, PLY, OBJ",
            remedy=f"pip install {package}, or convert the file",
        ) from error  # fmt: skip
    except Exception as error:  # a parser fails in as many ways as files are broken
        raise InputError(
            path, f"is cut short, or not a mesh ({type(error).__name__}: {str(error)[:_LONGEST_REASON]})",
            accepted=", ".join(MESH_SUFFIXES), remedy="copy or export it again",
        ) from error  # fmt: skip
