"""Light that stays in its slice."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, BoolArray, Float32Array, FloatArray, IntArray
from vialight.strips.shadows import TAPS, shadows, weaken
from vialight.strips.sums import IDS, ROWS_A_SUM, add_rows, add_shadows, fill_up, list_by_strip

ANGLES_A_PASS = 4
"""Angles summed before a voxel is written back; twelve weights just fit the registers."""

ANGLES_A_JOB = 6
"""Angles for which a tile is read at once."""

DARK = 3
"""Dark strips before the first and after the last: where shadows fall that no strip lights."""


@njit(inline="always")
def tiles_of(tile: int, voxels_x: int, voxels_y: int) -> int:
    """Return how many tiles of an edge cover the voxels."""
    return ((voxels_x + tile - 1) // tile) * ((voxels_y + tile - 1) // tile)


@njit(inline="always")
def tile_at(number: int, tile: int, voxels_x: int, voxels_y: int) -> tuple[int, int, int, int]:
    """Return first row, first column, rows and columns of a tile."""
    tiles_x = (voxels_x + tile - 1) // tile
    y0, x0 = number // tiles_x * tile, number % tiles_x * tile
    return y0, x0, min(tile, voxels_y - y0), min(tile, voxels_x - x0)


@njit(inline="always")
def lowest_strip(start: float, cosine: float, sine: float, voxel: float, height: int, width: int) -> int:
    """Return a strip that no shadow of a tile falls below; `start` is where that of its first voxel has its middle."""
    least = min(0.0, (width - 1) * voxel * cosine) + min(0.0, -(height - 1) * voxel * sine)
    return int(np.floor(start + least - 0.71 * voxel + 0.5)) - 1


@njit(inline="always")
def strips_seen(tile: int, voxel: float) -> int:
    """Return how many strips the shadows of a tile fall on, at any angle."""
    return int(1.42 * voxel * tile) + TAPS + 3


@njit(inline="always")
def strips_seen_at(cosine: float, sine: float, voxel: float, height: int, width: int) -> int:
    """Return how many strips, from `lowest_strip` on, the shadows of a tile fall on at one angle, at most."""
    return int(voxel * ((width - 1) * abs(cosine) + (height - 1) * abs(sine) + 1.42)) + TAPS + 1


@njit(inline="always")
def voxels_seen(tile: int, voxel: float) -> int:
    """Return how many voxels of a tile throw their shadow on one strip, and some to fill up groups, at most."""
    return min(tile * tile, int(1.5 * tile * (2.5 / voxel + 2))) + ROWS_A_SUM


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def backproject(
    tile: int, rows: Float32Array, strips: int, lit: IntArray, cosine: FloatArray, sine: FloatArray, first: float,
    voxel: float, xs: FloatArray, ys: FloatArray, reached: IntArray, absorbed_x: Float32Array, absorbed_y: Float32Array,
    tilt: Float32Array, loses: bool, both: bool, dose: Float32Array,
) -> None:  # fmt: skip
    """Fill `dose` with the light of all projections; lengths in strip widths.

    Parameters
    ----------
    tile
        Edge of a tile of voxels.
    rows
        (psi and strip, z): psi to whole passes, strips with `DARK` more at both ends.
    strips
        For each psi, without the dark ones.
    lit
        (psi, 2) first strip with any light, and the one after the last.
    cosine, sine, first, voxel, xs, ys
        Of the geometry.
    reached
        (y, 2) first voxel that is wanted, and the one after the last; others get 0.
    absorbed_x, absorbed_y, tilt, loses, both
        See `weaken`; tilt is (strip,); whether there is anything to be lost.
    dose
        (y, x, z).
    """
    depth, stride = rows.shape[1], strips + 2 * DARK
    for number in prange(tiles_of(tile, len(xs), len(ys))):
        y0, x0, height, width = tile_at(number, tile, len(xs), len(ys))
        sums = np.zeros((tile * tile, depth), np.float32)
        at, weights = np.empty((ANGLES_A_PASS, tile), np.int32), np.empty((ANGLES_A_PASS, TAPS, tile), np.float32)
        slopes = np.empty((TAPS, tile), np.float32)
        for a in range(0, len(cosine), ANGLES_A_PASS):
            is_lit = False
            for k in range(ANGLES_A_PASS):
                c, s = cosine[a + k], sine[a + k]
                low = lowest_strip(xs[x0] * c - ys[y0] * s - first, c, s, voxel, height, width)
                is_lit = is_lit or (lit[a + k, 1] > low and lit[a + k, 0] < low + strips_seen(tile, voxel))
            if not is_lit:
                continue
            for iy in range(height):
                begin, end = max(reached[y0 + iy, 0], x0) - x0, min(reached[y0 + iy, 1], x0 + width) - x0
                if begin >= end:
                    continue
                for k in range(ANGLES_A_PASS):
                    c, s, x, y = cosine[a + k], sine[a + k], xs[x0], ys[y0 + iy]
                    shadows(width, x * c - y * s - first, c, s, voxel, 0, k, at, weights)
                    if loses:
                        for tap in range(TAPS):
                            for ix in range(width):
                                slopes[tap, ix] = tilt[min(max(at[k, ix] + tap, 0), strips - 1)]
                        weaken(width, k, weights, absorbed_x, absorbed_y, a + k, x0, y0 + iy, x * s + y * c, voxel * s,
                               slopes, both)  # fmt: skip
                    for ix in range(width):
                        at[k, ix] = (a + k) * stride + DARK + min(max(at[k, ix], -DARK), strips)
                for ix in range(begin, end):
                    add_shadows(sums, iy * tile + ix, rows, ix, at, weights)
        for iy in range(height):
            for ix in range(width):
                dose[y0 + iy, x0 + ix] = sums[iy * tile + ix, : dose.shape[2]]


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def project(
    tile: int, rows: Float32Array, lit: BoolArray, cosine: FloatArray, sine: FloatArray, first: float, voxel: float,
    xs: FloatArray, ys: FloatArray, absorbed_x: Float32Array, absorbed_y: Float32Array, tilt: Float32Array,
    loses: bool, both: bool, projections: Float32Array,
) -> None:  # fmt: skip
    """Add all voxels to `projections`: the transpose of `backproject`.

    Parameters
    ----------
    rows
        (y and x, z).
    lit
        (y and x,) whether a voxel is to be added, and has anything in it.
    tile, cosine, sine, first, voxel, xs, ys, absorbed_x, absorbed_y, tilt, loses, both
        As for `backproject`.
    projections
        (psi, strip, z), z as long as in `rows`.
    """
    angles, strips, _ = projections.shape
    seen, room = strips_seen(tile, voxel), voxels_seen(tile, voxel)
    for job in prange((angles + ANGLES_A_JOB - 1) // ANGLES_A_JOB):
        at, weights = np.empty((1, tile), np.int32), np.empty((1, TAPS, tile), np.float32)
        slopes = np.empty((TAPS, tile), np.float32)
        ids, length = np.empty((seen, room), IDS), np.empty(seen, IDS)
        shares = np.empty((seen, 1, room), np.float32)
        for number in range(tiles_of(tile, len(xs), len(ys))):
            y0, x0, height, width = tile_at(number, tile, len(xs), len(ys))
            for a in range(job * ANGLES_A_JOB, min((job + 1) * ANGLES_A_JOB, angles)):
                c, s = cosine[a], sine[a]
                low = lowest_strip(xs[x0] * c - ys[y0] * s - first, c, s, voxel, height, width)
                length[:] = 0
                for iy in range(height):
                    x, y = xs[x0], ys[y0 + iy]
                    shadows(width, x * c - y * s - first, c, s, voxel, -low, 0, at, weights)
                    if loses:
                        for tap in range(TAPS):
                            for ix in range(width):
                                slopes[tap, ix] = tilt[min(max(at[0, ix] + low + tap, 0), strips - 1)]
                        weaken(width, 0, weights, absorbed_x, absorbed_y, a, x0, y0 + iy, x * s + y * c, voxel * s,
                               slopes, both)  # fmt: skip
                    list_by_strip(width, (y0 + iy) * len(xs) + x0, lit, at, weights, ids, shares, length)
                for strip in range(max(0, -low), min(seen, strips - low)):
                    if length[strip]:
                        count = fill_up(strip, ids, shares, length, ROWS_A_SUM)
                        add_rows(projections, a, low + strip, rows, strip, ids, shares, count)
