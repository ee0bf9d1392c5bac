"""Which faces of a mesh cut through each other.

Pairs whose boxes overlap are found in a tree over the faces, walked against itself one level at a time; of these, two
faces cut each other where each has corners on both sides of the other's plane and both meet the planes' common line
in one stretch (Moeller, "A fast triangle-triangle intersection test", 1997).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vialight.core.arrays import FloatArray, IntArray
from vialight.core.mesh import Mesh

_TOLERANCE = 1e-5
"""Of the part's size: 0.1 um on a print, and coarser than the single precision of mesh files."""
_PAIRS_AT_ONCE = 200_000


def intersecting_faces(mesh: Mesh) -> IntArray:
    """Find pairs of faces that cut through each other.

    Faces that only touch (share a corner, an edge, or lie in one plane) do not count, and neither do cuts that are
    shorter or less deep than 1e-5 of the part's size.

    Returns
    -------
    numpy.ndarray
        (pairs, 2) int64 indices of faces, the smaller first.

    Examples
    --------
    >>> crossed = Mesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [.5, .5, -1], [.5, .5, 1], [3, 3, 0]], [[0, 1, 2], [3, 4, 5]])
    >>> intersecting_faces(crossed).tolist()
    [[0, 1]]
    """
    tolerance = _TOLERANCE * float(mesh.extents_mm.max())
    corners = mesh.corners_mm
    normals = mesh.face_normals
    found = [
        pairs[_cut_each_other(pairs, corners, normals, tolerance)]
        for pairs in _overlapping_pairs(corners.min(axis=1), corners.max(axis=1))
    ]
    return np.sort(np.concatenate([np.empty((0, 2), dtype=np.int64), *found]), axis=1)


def _overlapping_pairs(low: FloatArray, high: FloatArray) -> Iterator[IntArray]:
    """Give, in portions, (pairs, 2) indices of (n, 3) boxes that overlap."""
    count = len(low)
    levels = max(1, int(np.ceil(np.log2(count))))
    order = np.argsort(_along_a_curve((low + high) / 2), kind="stable")
    padding = ((0, 2**levels - count), (0, 0))
    lows = [np.pad(low[order], padding, constant_values=np.inf)]
    highs = [np.pad(high[order], padding, constant_values=-np.inf)]
    for _ in range(levels):
        lows.append(np.minimum(lows[-1][::2], lows[-1][1::2]))
        highs.append(np.maximum(highs[-1][::2], highs[-1][1::2]))
    waiting = [(levels, np.zeros((1, 2), dtype=np.int64))]
    while waiting:
        level, nodes = waiting.pop()
        if level == 0:
            yield order[nodes[nodes[:, 0] != nodes[:, 1]]]
            continue
        pairs = _overlapping_children(nodes, lows[level - 1], highs[level - 1])
        # Deepest first and in portions: a fan of 10,000 faces makes 25 million pairs.
        starts = range(0, len(pairs), _PAIRS_AT_ONCE)
        waiting.extend((level - 1, pairs[start : start + _PAIRS_AT_ONCE]) for start in starts)


def _overlapping_children(nodes: IntArray, low: FloatArray, high: FloatArray) -> IntArray:
    """Pair the children of paired nodes; of a node paired with itself, its first with its second only once."""
    one, other = nodes.T
    differ = one != other
    a = np.concatenate([2 * one, 2 * one, 2 * one[differ] + 1, 2 * one + 1])
    b = np.concatenate([2 * other, 2 * other + 1, 2 * other[differ], 2 * other + 1])
    for axis in range(3):
        overlap = (low[a, axis] <= high[b, axis]) & (low[b, axis] <= high[a, axis])
        a, b = a[overlap], b[overlap]
    return np.stack([a, b], axis=1)


def _along_a_curve(points: FloatArray) -> IntArray:
    """Return Morton codes: points with close codes are close in space."""
    extent = np.ptp(points, axis=0).max() or 1.0
    steps = ((points - points.min(axis=0)) / extent * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((steps[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _cut_each_other(
    pairs: IntArray, corners: FloatArray, normals: FloatArray, tolerance: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    cut = np.ones(len(pairs), dtype=np.bool_)
    for face, other in (pairs.T, pairs.T[::-1]):
        rest = np.flatnonzero(cut)
        height = _heights(face[rest], other[rest], corners, normals)
        cut[rest] = (height.max(axis=1) > tolerance) & (height.min(axis=1) < -tolerance)
    rest = np.flatnonzero(cut)
    one, two = pairs[rest].T
    direction = np.cross(normals[one], normals[two])
    with np.errstate(invalid="ignore"):  # faces of one plane have no common line, and were left out but for rounding
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    low_1, high_1 = _stretch(one, two, direction, corners, normals, tolerance)
    low_2, high_2 = _stretch(two, one, direction, corners, normals, tolerance)
    cut[rest] = np.minimum(high_1, high_2) - np.maximum(low_1, low_2) > tolerance
    return cut


def _heights(face: IntArray, other: IntArray, corners: FloatArray, normals: FloatArray) -> FloatArray:
    """Return (pairs, 3): how far the corners of `face` are above the plane of `other`."""
    return np.asarray(np.einsum("pki,pi->pk", corners[face] - corners[other, None, 0], normals[other]))


def _stretch(
    face: IntArray, other: IntArray, direction: FloatArray, corners: FloatArray, normals: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Return from where to where along `direction` a face meets the plane of another."""
    height = _heights(face, other, corners, normals)
    height[np.abs(height) <= tolerance] = 0.0
    along = np.einsum("pki,pi->pk", corners[face], direction)
    next_height, next_along = np.roll(height, -1, axis=1), np.roll(along, -1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        on_edge = along + (next_along - along) * height / (height - next_height)
    meets = height * next_height < 0
    stops = np.concatenate([np.where(meets, on_edge, np.nan), np.where(height == 0, along, np.nan)], axis=1)
    return np.nanmin(stops, axis=1), np.nanmax(stops, axis=1)
