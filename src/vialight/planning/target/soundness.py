"""Whether a mesh says, for every point, if it is inside the part."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import FloatArray, IntArray
from vialight.core.columns import column_grid, crossings
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.planning.target.self_intersection import intersecting_faces

_COLUMNS_ACROSS = 200
_ROUNDING = 1e-5
"""Of the part's size: stretches shorter than this have no say."""


def check_sound(mesh: Mesh, where: object = "part") -> None:
    """Refuse a mesh that does not bound a part; nothing is repaired here.

    Parameters
    ----------
    mesh
        As read, in any unit.
    where
        What to call it in errors: its file.

    Raises
    ------
    InputError
        The mesh has holes or faces that disagree about outside, is inside out or flat, cuts through itself, or holds
        bodies that overlap or are inside out; with the place.

    Notes
    -----
    Overlaps without any face that cuts another (a body in a file twice) and single bodies inside out are looked for
    along 200 columns across the part, so that those thinner than that may pass; voxels count them once, or not at all.

    Examples
    --------
    >>> corner = Mesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> check_sound(corner)
    >>> check_sound(Mesh(corner.vertices_mm, corner.faces[:3]))
    Traceback (most recent call last):
    vialight.core.errors.InputError: part: is not watertight: 3 of its edges have a face on one side only, the first ...
    """
    if not mesh.is_watertight:
        raise _not_watertight(mesh, where)
    size = float(mesh.extents_mm.max())
    if abs(mesh.volume_mm3) <= 1e-12 * size**3:
        raise InputError(where, "encloses no volume", accepted="a solid part", remedy="give its walls a thickness")
    if mesh.volume_mm3 < 0:
        raise InputError(
            where, f"is inside out (its volume comes out as {mesh.volume_mm3:.4g} mm^3)",
            accepted="faces that look outwards", remedy="flip its normals and export it again",
        )  # fmt: skip
    pairs = intersecting_faces(mesh)
    if len(pairs):
        raise InputError(
            where,
            f"cuts through itself: {len(pairs)} pairs of faces, the first at {_point(mesh.corners_mm[pairs[0]])}",
            accepted="a surface without self-intersections",
            remedy="unite its bodies (boolean union), or let a mesh tool repair it",
        )
    _check_bodies(mesh, where, _ROUNDING * size)


def _not_watertight(mesh: Mesh, where: object) -> InputError:
    a, b, c = mesh.faces.T
    whole = mesh.faces[(a != b) & (b != c) & (c != a)]
    start, end = whole.ravel(), np.roll(whole, -1, axis=1).ravel()
    edges, of_edge = np.unique(
        np.stack([np.minimum(start, end), np.maximum(start, end)], 1), axis=0, return_inverse=True
    )
    of_edge = of_edge.ravel()
    walks = np.bincount(of_edge, weights=np.where(start < end, 1, -1), minlength=len(edges))
    sides = np.bincount(of_edge, minlength=len(edges))
    odd = np.flatnonzero((walks != 0) & (sides % 2 == 1))
    if len(odd):
        what = f"is not watertight: {len(odd)} of its edges have a face on one side only"
        remedy = "close its holes in a mesh tool, or export it again as a solid"
    else:
        odd = np.flatnonzero(walks)
        what = f"is not watertight: at {len(odd)} of its edges neighbouring faces disagree about outside"
        remedy = "let a mesh tool make its normals consistent"
    if not len(odd):
        return InputError(where, "has no face with three corners", accepted="a solid part", remedy="export it again")
    place = _point(mesh.vertices_mm[edges[odd[0]]])
    return InputError(where, f"{what}, the first at {place}", accepted="a closed surface", remedy=remedy)


def _check_bodies(mesh: Mesh, where: object, shortest_mm: float) -> None:
    """Walk up columns: outside the count of bodies entered is 0 and inside 1, or something lies in something else."""
    pitch = float(mesh.extents_mm[:2].max()) / _COLUMNS_ACROSS
    grid = column_grid(mesh.bounds_mm, 2, pitch)
    found = crossings(mesh, grid)
    order = np.lexsort((found.height_mm, found.column))
    column, height = found.column[order], found.height_mm[order]
    entered = np.cumsum(-found.outward[order])[:-1]
    odd = (np.diff(height) > shortest_mm) & (np.diff(column) == 0) & ((entered < 0) | (entered > 1))
    if not odd.any():
        return
    first = int(odd.argmax())
    place = _column_point(
        int(column[first]), float(height[first : first + 2].mean()), grid.low_uv_mm, pitch, grid.shape
    )
    if entered[first] < 0:
        raise InputError(
            where, f"one of its bodies is inside out, at {place}", accepted="faces that look outwards",
            remedy="flip that body's normals",
        )  # fmt: skip
    raise InputError(
        where, f"its bodies overlap, or one is in it twice, at {place}", accepted="bodies apart from each other",
        remedy="unite them (boolean union); a cavity's faces look into the cavity",
    )  # fmt: skip


def _column_point(column: int, height: float, low: tuple[float, float], pitch: float, shape: tuple[int, int]) -> str:
    v, u = divmod(column, shape[1])
    return _point(np.array([[low[0] + (u + 0.5) * pitch, low[1] + (v + 0.5) * pitch, height]]))


def _point(points: FloatArray | IntArray) -> str:
    x, y, z = np.asarray(points, dtype=np.float64).reshape(-1, 3).mean(axis=0)
    return f"({x:.3g}, {y:.3g}, {z:.3g}) mm"
