"""Columns cut through a mesh: where parallel lines enter and leave it, by scan conversion.

Along a column lengths are exact, so that volumes, projections and voxels of a body follow from its crossings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vialight.core.arrays import FloatArray, IntArray
from vialight.core.mesh import Mesh


class ColumnGrid(NamedTuple):
    """Parallel columns through a region, along one axis.

    The columns' positions run along the next two axes cyclically: `u` is axis + 1, `v` is axis + 2, which makes
    (u, v, axis) right-handed.
    """

    axis: int
    """0, 1, 2 for columns along x, y, z."""
    low_uv_mm: tuple[float, float]
    """Corner of the region."""
    pitch_mm: float
    shape: tuple[int, int]
    """Columns along (v, u)."""


def column_grid(bounds_mm: FloatArray, axis: int, pitch_mm: float) -> ColumnGrid:
    """Cover (2, 3) bounds with columns along an axis.

    Examples
    --------
    >>> column_grid(np.array([[0, 0, 0], [1, 2, 3]]), axis=2, pitch_mm=0.5).shape
    (4, 2)
    """
    u, v = (axis + 1) % 3, (axis + 2) % 3
    low, extents = bounds_mm[0], bounds_mm[1] - bounds_mm[0]
    count_v, count_u = (max(1, int(np.ceil(extents[k] / pitch_mm - 1e-9))) for k in (v, u))
    return ColumnGrid(axis, (float(low[u]), float(low[v])), pitch_mm, (count_v, count_u))


class Crossings(NamedTuple):
    """Where columns meet faces."""

    column: IntArray
    """(n,) index into the flattened (v, u) grid."""
    height_mm: FloatArray
    """(n,) coordinate along the axis."""
    outward: IntArray
    """(n,) 1 where the face looks along the axis (the column leaves the body), -1 where it looks against it."""
    face: IntArray
    """(n,) the face that is met."""
    shares: FloatArray
    """(n, 3) weights of the face's corners there; they sum to 1."""


def crossings(mesh: Mesh, grid: ColumnGrid) -> Crossings:
    """Find where columns cross faces, by scan conversion, in no particular order.

    Each edge is evaluated from its lower-numbered vertex in both faces that share it, and intervals are half-open: so a
    column crosses exactly one of two neighbours, and a closed mesh is crossed as often inwards as outwards.
    """
    points = np.roll(mesh.vertices_mm, -(grid.axis + 1), axis=1)
    low = np.array(grid.low_uv_mm)
    # Columns stand at the middles of their cells; in these units they have integer coordinates.
    uv = (points[:, :2] - low) / grid.pitch_mm - 0.5
    height = points[:, 2]
    face, row, first, last = _row_intervals(uv, mesh.faces, grid.shape)
    counts = last - first
    of_span = np.repeat(np.arange(len(face)), counts)
    u = first[of_span] + _count_up(counts)
    face, v = face[of_span], row[of_span]

    a, b, c = (mesh.faces[:, corner] for corner in range(3))
    edge_1, edge_2 = uv[b] - uv[a], uv[c] - uv[a]
    doubled_area = edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0]
    du, dv = u - uv[a[face], 0], v - uv[a[face], 1]
    along_1 = (du * edge_2[face, 1] - dv * edge_2[face, 0]) / doubled_area[face]
    along_2 = (dv * edge_1[face, 0] - du * edge_1[face, 1]) / doubled_area[face]
    z_a, z_b, z_c = height[a[face]], height[b[face]], height[c[face]]
    z = z_a + along_1 * (z_b - z_a) + along_2 * (z_c - z_a)
    # Rounding must not carry a crossing of a face on edge out of that face.
    z = np.clip(z, np.minimum(np.minimum(z_a, z_b), z_c), np.maximum(np.maximum(z_a, z_b), z_c))
    shares = np.stack([1 - along_1 - along_2, along_1, along_2], axis=1).clip(0, 1)
    return Crossings(v * grid.shape[1] + u, z, np.sign(doubled_area[face]).astype(np.int64), face, shares)


def thickness(mesh: Mesh, grid: ColumnGrid) -> FloatArray:
    """Measure the length of each column that lies inside a closed mesh: its projection, as a sum along the axis.

    Returns
    -------
    numpy.ndarray
        (v, u) mm, row 0 at the lowest v.
    """
    found = crossings(mesh, grid)
    lengths = np.bincount(
        found.column, weights=found.outward * found.height_mm, minlength=grid.shape[0] * grid.shape[1]
    )
    return np.asarray(lengths.reshape(grid.shape))


def _row_intervals(
    uv: FloatArray, faces: IntArray, shape: tuple[int, int]
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return, for every face and row of columns that it meets: face, row, first column, column after the last."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    start, end = np.minimum(start, end), np.maximum(start, end)
    v_ends = np.stack([uv[start, 1], uv[end, 1]])
    low_row = np.clip(np.ceil(v_ends.min(axis=0)), 0, shape[0]).astype(np.int64)
    high_row = np.clip(np.ceil(v_ends.max(axis=0)), 0, shape[0]).astype(np.int64)
    counts = high_row - low_row
    edge = np.repeat(np.arange(len(start)), counts)
    row = low_row[edge] + _count_up(counts)
    origin, slope_end = uv[start[edge]], uv[end[edge]]
    u = origin[:, 0] + (row - origin[:, 1]) / (slope_end[:, 1] - origin[:, 1]) * (slope_end[:, 0] - origin[:, 0])
    face = edge // 3
    # A row that meets a face crosses exactly two of its edges.
    order = np.lexsort((u, row, face))
    column = np.clip(np.ceil(u[order]), 0, shape[1]).astype(np.int64)
    return face[order][::2], row[order][::2], column[::2], column[1::2]


def _count_up(counts: IntArray) -> IntArray:
    """Return 0, 1, ..., count - 1 for every count, one after the other."""
    ends = np.cumsum(counts)
    return np.asarray(np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts))
