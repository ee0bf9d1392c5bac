"""Weighted sums of rows of slices: where planning spends its time."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vialight.core.arrays import BoolArray, Float32Array
from vialight.core.compiling import FAST_MATH, without_overlap
from vialight.planning.strips.shadows import Int32Array

IDS = np.uint32
ROWS_A_PAIR = 6
"""Rows added before two sums are written back: their weights just fit the registers."""


@without_overlap
def add_shadows(
    sums: Float32Array, row: int, rows: Float32Array, entry: int, k: int, first: Int32Array, weights: Float32Array
) -> None:
    """Add to a row of `sums` four times `TAPS` rows: those from ``first[i, k]`` on, by ``weights[i, :, k]``.

    i are four numbers from `entry` on.
    """
    i0, i1 = np.uint64(first[entry, k]), np.uint64(first[entry + 1, k])
    i2, i3 = np.uint64(first[entry + 2, k]), np.uint64(first[entry + 3, k])
    u0, v0, w0 = weights[entry, 0, k], weights[entry, 1, k], weights[entry, 2, k]
    u1, v1, w1 = weights[entry + 1, 0, k], weights[entry + 1, 1, k], weights[entry + 1, 2, k]
    u2, v2, w2 = weights[entry + 2, 0, k], weights[entry + 2, 1, k], weights[entry + 2, 2, k]
    u3, v3, w3 = weights[entry + 3, 0, k], weights[entry + 3, 1, k], weights[entry + 3, 2, k]
    # Unsigned: a signed index would be looked at for counting from the end.
    one, two = np.uint64(1), np.uint64(2)
    for z in range(sums.shape[1]):
        sums[row, z] += (
            u0 * rows[i0, z]
            + v0 * rows[i0 + one, z]
            + w0 * rows[i0 + two, z]
            + u1 * rows[i1, z]
            + v1 * rows[i1 + one, z]
            + w1 * rows[i1 + two, z]
            + u2 * rows[i2, z]
            + v2 * rows[i2 + one, z]
            + w2 * rows[i2 + two, z]
            + u3 * rows[i3, z]
            + v3 * rows[i3 + one, z]
            + w3 * rows[i3 + two, z]
        )


@without_overlap
def add_rows_to_two(
    sums: Float32Array, near: int, rows: Float32Array, strip: int, ids: NDArray[IDS], shares: Float32Array, count: int
) -> None:
    """Add rows to ``sums[near]`` and the next by the entries of a strip's list, in whole groups of `ROWS_A_PAIR`."""
    far = near + 1
    for k in range(0, count, ROWS_A_PAIR):
        i0, i1, i2, i3 = _four(ids, strip, k)
        i4, i5 = np.uint64(ids[strip, k + 4]), np.uint64(ids[strip, k + 5])
        u0, u1, u2 = shares[strip, 0, k], shares[strip, 0, k + 1], shares[strip, 0, k + 2]
        u3, u4, u5 = shares[strip, 0, k + 3], shares[strip, 0, k + 4], shares[strip, 0, k + 5]
        w0, w1, w2 = shares[strip, 1, k], shares[strip, 1, k + 1], shares[strip, 1, k + 2]
        w3, w4, w5 = shares[strip, 1, k + 3], shares[strip, 1, k + 4], shares[strip, 1, k + 5]
        for z in range(sums.shape[1]):
            r0, r1, r2, r3, r4, r5 = rows[i0, z], rows[i1, z], rows[i2, z], rows[i3, z], rows[i4, z], rows[i5, z]
            sums[near, z] += u0 * r0 + u1 * r1 + u2 * r2 + u3 * r3 + u4 * r4 + u5 * r5
            sums[far, z] += w0 * r0 + w1 * r1 + w2 * r2 + w3 * r3 + w4 * r4 + w5 * r5


@njit(inline="always")
def _four(ids: NDArray[IDS], strip: int, k: int) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    return (
        np.uint64(ids[strip, k]), np.uint64(ids[strip, k + 1]), np.uint64(ids[strip, k + 2]),
        np.uint64(ids[strip, k + 3]),
    )  # fmt: skip


@njit(fastmath=FAST_MATH, cache=True)
def list_by_strip(
    count: int, y: int, x: int, pitch: int, filled: BoolArray, first: Int32Array, weights: Float32Array,
    ids: NDArray[IDS], shares: Float32Array, length: NDArray[IDS],
) -> None:  # fmt: skip
    """Append voxels of a row, those that are not empty, to the lists of the strips that their shadows fall on.

    Parameters
    ----------
    count, y, x
        Voxels, and where the first is.
    pitch
        Numbers of voxels from one y to the next.
    filled
        (y, x) whether there is anything in a voxel.
    first, weights
        (1, voxel) and (sum, tap, voxel), for one sum or two of each strip; see `shadows`.
    ids
        (strip, entry) numbers of voxels.
    shares
        (strip, sum, entry).
    length
        (strip,) entries so far.
    """
    two = weights.shape[0] == 2
    for k in range(count):
        if not filled[y, x + k]:
            continue
        for tap in (np.uint64(0), np.uint64(1), np.uint64(2)):  # `TAPS`, unrolled
            strip = np.uint64(first[0, k]) + tap
            entry = np.uint64(length[strip])
            ids[strip, entry] = y * pitch + x + k
            share = weights[0, tap, k]
            shares[strip, 0, entry] = share
            if two:
                shares[strip, 1, entry] = weights[1, tap, k]
                share += weights[1, tap, k]
            # A share of 0 is written, and then written over: a branch would be guessed wrong half of the time.
            length[strip] = entry + np.uint64(share != 0)


@njit(fastmath=FAST_MATH, cache=True)
def fill_up(strip: int, ids: NDArray[IDS], shares: Float32Array, length: NDArray[IDS], group: int) -> int:
    """Lengthen a strip's list by entries without a share to whole groups, and return how long it is then."""
    begin = int(length[strip])
    end = (begin + group - 1) // group * group
    for entry in range(begin, end):
        ids[strip, entry] = ids[strip, 0]
        for s in range(shares.shape[1]):
            shares[strip, s, entry] = 0
    return end
