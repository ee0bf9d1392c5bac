"""Arrays as the loops want them: rows of slices in whole vectors, and which of them are dark or empty."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from vialight.core.arrays import BoolArray, Float32Array, IntArray
from vialight.core.compiling import aligned_zeros

_FLOATS_A_VECTOR = 8
_PAGE, _LINES = 4096, 16
"""Bytes after which addresses come to the same places of the nearest cache, and lines that are wanted there at once."""

SPARE = 32
"""Empty voxels before the first and after the last: a strip may ask for some beside them."""


def whole_vectors(slices: int) -> int:
    """Return how many slices fill whole vectors.

    Examples
    --------
    >>> whole_vectors(72), whole_vectors(73)
    (72, 80)
    """
    return slices + -slices % _FLOATS_A_VECTOR


def lit_strips(projections: Float32Array) -> IntArray:
    """Return (psi, 2): the first strip with any light, and the one after the last; twice 0 where there is none."""
    lit = np.zeros((len(projections), 2), np.int64)
    _find_lit(projections, lit)
    return lit


@njit(parallel=True, cache=True)
def _find_lit(projections: Float32Array, lit: IntArray) -> None:
    for a in prange(len(projections)):
        first, last = 0, projections.shape[1]
        while last > 0 and not projections[a, last - 1].any():
            last -= 1
        while first < last and not projections[a, first].any():
            first += 1
        if last > 0:
            lit[a, 0], lit[a, 1] = first, last


class VoxelRows(NamedTuple):
    """A volume laid out for projection."""

    by_y: Float32Array
    """(y and x, z), `SPARE` more at both ends, and some at the end of each line."""
    by_x: Float32Array
    """(x and y, z), likewise."""
    pitch_y: int
    """Rows from one y to the next in `by_y`."""
    pitch_x: int
    """Rows from one x to the next in `by_x`."""
    filled: BoolArray
    """(y, x) whether there is anything in a voxel at any height."""


def voxel_rows(volume: Float32Array, reached: IntArray) -> VoxelRows:
    """Lay a volume out for projection.

    Parameters
    ----------
    volume
        (y, x, z).
    reached
        (y, 2) first voxel along x that is wanted, and the one after the last; others are taken for empty.
    """
    count_y, count_x, slices = volume.shape
    depth = whole_vectors(slices)
    pitch_y, pitch_x = _pitch(count_x, depth), _pitch(count_y, depth)
    by_y = aligned_zeros((count_y * pitch_y + 2 * SPARE, depth))
    by_x = aligned_zeros((count_x * pitch_x + 2 * SPARE, depth))
    filled = np.zeros((count_y, count_x), np.bool_)
    _lay_out(volume, reached, pitch_y, pitch_x, by_y, by_x, filled)
    return VoxelRows(by_y, by_x, pitch_y, pitch_x, filled)


def _pitch(voxels: int, depth: int) -> int:
    """Return a distance of lines that puts neighbouring ones into different places of the nearest cache.

    Strips gather from some lines at once, which would drive each other out if they lay whole pages apart.

    Examples
    --------
    >>> _pitch(128, 72) > 128  # 128 lines of 288 bytes are nine pages
    True
    """
    pitches = voxels + np.arange(_PAGE // _LINES)
    places = np.sort(np.arange(_LINES) * (pitches * depth * 4)[:, None] % _PAGE, axis=1)
    gaps = np.diff(places, axis=1, append=places[:, :1] + _PAGE)
    return int(pitches[gaps.min(axis=1).argmax()])


@njit(parallel=True, cache=True)
def _lay_out(
    volume: Float32Array, reached: IntArray, pitch_y: int, pitch_x: int, by_y: Float32Array, by_x: Float32Array,
    filled: BoolArray,
) -> None:  # fmt: skip
    for y in prange(volume.shape[0]):
        for x in range(reached[y, 0], reached[y, 1]):
            near, far = SPARE + y * pitch_y + x, SPARE + x * pitch_x + y
            anything = False
            for z in range(volume.shape[2]):
                value = volume[y, x, z]
                by_y[near, z] = value
                by_x[far, z] = value
                anything |= value != 0
            filled[y, x] = anything


def filled_boxes(filled: BoolArray, high: int, wide: int) -> IntArray:
    """Return (box, 4): what is filled, cut into boxes of a size at most.

    Each is its first index along the first axis, the one after its last, and the same along the second axis.

    Examples
    --------
    >>> filled_boxes(np.array([[False, True, False], [False, False, False]]), 2, 3)
    array([[0, 1, 1, 2]])
    """
    boxes = []
    for first in range(0, filled.shape[0], high):
        for second in range(0, filled.shape[1], wide):
            i, j = np.nonzero(filled[first : first + high, second : second + wide])
            if len(i):
                boxes.append([first + i.min(), first + i.max() + 1, second + j.min(), second + j.max() + 1])
    return np.array(boxes, dtype=np.int64).reshape(-1, 4)
