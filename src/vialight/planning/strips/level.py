"""Light that stays in its slice."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray, IntArray
from vialight.core.compiling import FAST_MATH
from vialight.planning.strips.shadows import TAPS, Int32Array, gathered, shadows, weaken, weaken_gathered
from vialight.planning.strips.sums import add_shadows

ENTRIES_A_PASS = 4
"""Angles, or parts of shadows, summed before a voxel is written back; twelve weights just fit the registers."""

ANGLES_A_JOB = 6
"""Angles for which a tile is read at once."""

SLOW_TILE, FAST_TILE = 16, 64
"""Voxels of such a tile, along the axis along which shadows move less, and along the other."""

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
def strips_seen(tile: int, voxel: float, parts: int) -> int:
    """Return how many strips the shadows of a tile fall on, at any angle."""
    return int(1.42 * voxel * tile) + parts * TAPS + 3


@njit(inline="always")
def strips_seen_at(cosine: float, sine: float, voxel: float, parts: int, height: int, width: int) -> int:
    """Return how many strips, from `lowest_strip` on, the shadows of a tile fall on at one angle, at most."""
    return int(voxel * ((width - 1) * abs(cosine) + (height - 1) * abs(sine) + 1.42)) + parts * TAPS + 1


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def backproject(
    tile: int, parts: int, rows: Float32Array, strips: int, lit: IntArray, cosine: FloatArray, sine: FloatArray,
    first: float, voxel: float, xs: FloatArray, ys: FloatArray, reached_x: IntArray, reached_y: IntArray,
    absorbed_x: Float32Array, absorbed_y: Float32Array, tilt: Float32Array, loses: bool, both: bool,
    dose: Float32Array,
) -> None:  # fmt: skip
    """Fill `dose` with the light of all projections; lengths in strip widths.

    Voxels follow each other along the axis along which their shadows move less, so that the strips of one are still in
    the nearest cache for the next.

    Parameters
    ----------
    tile
        Edge of a tile of voxels.
    parts
        Of each shadow, see `parts_of`.
    rows
        (psi and strip, z): psi to whole passes, strips with `DARK` more at both ends.
    strips
        For each psi, without the dark ones.
    lit
        (psi, 2) first strip with any light, and the one after the last.
    cosine, sine, first, voxel, xs, ys
        Of the geometry.
    reached_x, reached_y
        (y, 2) and (x, 2): first voxel along x, and along y, that is wanted, and the one after the last; others get 0.
    absorbed_x, absorbed_y, tilt, loses, both
        See `weaken`; tilt is (strip,); whether there is anything to be lost.
    dose
        (y, x, z).
    """
    depth, stride = rows.shape[1], strips + 2 * DARK
    angles_a_pass = ENTRIES_A_PASS // parts
    for number in prange(tiles_of(tile, len(xs), len(ys))):
        y0, x0, height, width = tile_at(number, tile, len(xs), len(ys))
        sums = np.zeros((tile * tile, depth), np.float32)
        at, weights = np.empty((ENTRIES_A_PASS, tile), np.int32), np.empty((ENTRIES_A_PASS, TAPS, tile), np.float32)
        slopes = np.empty((TAPS, tile), np.float32)
        for a in range(0, len(cosine), angles_a_pass):
            is_lit = False
            for k in range(angles_a_pass):
                c, s = cosine[a + k], sine[a + k]
                low = lowest_strip(xs[x0] * c - ys[y0] * s - first, c, s, voxel, height, width)
                is_lit = is_lit or (lit[a + k, 1] > low and lit[a + k, 0] < low + strips_seen(tile, voxel, parts))
            if not is_lit:
                continue
            upright = abs(cosine[a]) >= abs(sine[a])
            for line in range(width if upright else height):
                begin, end = wanted(upright, line, reached_x, reached_y, x0, y0, height, width)
                if begin >= end:
                    continue
                for k in range(angles_a_pass):
                    c, s = cosine[a + k], sine[a + k]
                    shadows_in_line(upright, line, xs, ys, x0, y0, height, width, first, c, s, voxel, parts, 0,
                                    k * parts, at, weights)  # fmt: skip
                    for entry in range(k * parts, (k + 1) * parts):
                        if loses:
                            for tap in range(TAPS):
                                for i in range(tile):
                                    slopes[tap, i] = tilt[min(max(at[entry, i] + tap, 0), strips - 1)]
                            weaken_line(upright, line, xs, ys, x0, y0, height, width, c, s, voxel, entry, weights,
                                        absorbed_x, absorbed_y, a + k, slopes, both)  # fmt: skip
                        for i in range(tile):
                            at[entry, i] = (a + k) * stride + DARK + min(max(at[entry, i], -DARK), strips)
                for i in range(begin, end):
                    add_shadows(sums, i * tile + line if upright else line * tile + i, rows, 0, i, at, weights)
        for iy in range(height):
            for ix in range(width):
                dose[y0 + iy, x0 + ix] = sums[iy * tile + ix, : dose.shape[2]]


@njit(inline="always")
def wanted(
    upright: bool, line: int, reached_x: IntArray, reached_y: IntArray, x0: int, y0: int, height: int, width: int
) -> tuple[int, int]:
    """Return the first voxel in a line of a tile that is wanted, and the one after the last."""
    if upright:
        return max(reached_y[x0 + line, 0] - y0, 0), min(reached_y[x0 + line, 1] - y0, height)
    return max(reached_x[y0 + line, 0] - x0, 0), min(reached_x[y0 + line, 1] - x0, width)


@njit(inline="always")
def shadows_in_line(
    upright: bool, line: int, xs: FloatArray, ys: FloatArray, x0: int, y0: int, height: int, width: int, first: float,
    c: float, s: float, voxel: float, parts: int, shift: int, row: int, at: Int32Array, weights: Float32Array,
) -> None:  # fmt: skip
    """Find the shadows of a line of a tile's voxels, along y if it is upright, along x if not."""
    if upright:
        shadows(height, xs[x0 + line] * c - ys[y0] * s - first, -s, c, voxel, parts, shift, row, at, weights)
    else:
        shadows(width, xs[x0] * c - ys[y0 + line] * s - first, c, s, voxel, parts, shift, row, at, weights)


@njit(inline="always")
def weaken_line(
    upright: bool, line: int, xs: FloatArray, ys: FloatArray, x0: int, y0: int, height: int, width: int, c: float,
    s: float, voxel: float, row: int, weights: Float32Array, absorbed_x: Float32Array, absorbed_y: Float32Array,
    angle: int, slopes: Float32Array, both: bool,
) -> None:  # fmt: skip
    """Weaken the shadows of such a line."""
    if upright:
        weaken(height, row, weights, absorbed_y, absorbed_x, angle, y0, x0 + line, xs[x0 + line] * s + ys[y0] * c,
               voxel * c, slopes, both)  # fmt: skip
    else:
        weaken(width, row, weights, absorbed_x, absorbed_y, angle, x0, y0 + line, xs[x0] * s + ys[y0 + line] * c,
               voxel * s, slopes, both)  # fmt: skip


@njit(inline="always")
def parts_at(cosine: float, sine: float, voxel: float) -> int:
    """Return in how many parts of `TAPS` the voxels of a line that throw their shadow on one strip come, at most."""
    return int(np.ceil(((abs(cosine) + abs(sine) + 1 / voxel) / abs(cosine) - 1e-5) / TAPS))


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def project(
    angles: IntArray, rows: Float32Array, spare: int, pitch: int, boxes: IntArray, cosine: FloatArray, sine: FloatArray,
    first: float, voxel: float, fast: FloatArray, slow: FloatArray, absorbed_fast: Float32Array,
    absorbed_slow: Float32Array, tilt: Float32Array, side: int, loses: bool, both: bool, strips: int,
    projections: Float32Array,
) -> None:  # fmt: skip
    """Add all voxels to `projections` for some angles: the transpose of `backproject`.

    Strips gather from lines of voxels along the axis along which shadows move faster: from few in each line, and from
    much the same for the next strip.

    Parameters
    ----------
    angles
        Numbers of those at which shadows move faster along the fast axis.
    rows
        (slow and fast, z) voxels, with `spare` more at both ends.
    pitch
        Rows from one line to the next, as many as there are voxels in it or more.
    boxes
        (box, 4): where voxels are that have anything in them, each no larger than a tile: first slow, the one after the
        last, first fast, the one after the last.
    cosine, sine
        A shadow is at ``fast cosine - slow sine``.
    first, voxel, fast, slow, absorbed_fast, absorbed_slow, tilt, loses, both
        As for `backproject`.
    side
        1, or -1 where ``fast sine + slow cosine`` counts against the light.
    strips
        For each psi.
    projections
        (psi and strip, z), z as long as in `rows`.
    """
    for job in prange((len(angles) + ANGLES_A_JOB - 1) // ANGLES_A_JOB):
        most, room = parts_at(np.sqrt(0.5), np.sqrt(0.5), voxel), strips_seen(max(FAST_TILE, SLOW_TILE), voxel, 1)
        at, weights = (
            np.zeros((SLOW_TILE * most + 3, room), np.int32),
            np.zeros((SLOW_TILE * most + 3, TAPS, room), np.float32),
        )
        begin, end = np.empty(room, np.int32), np.empty(room, np.int32)
        for number in range(len(boxes)):
            slow0, fast0 = boxes[number, 0], boxes[number, 2]
            height, width = boxes[number, 1] - slow0, boxes[number, 3] - fast0
            for a in angles[job * ANGLES_A_JOB : (job + 1) * ANGLES_A_JOB]:
                c, s = cosine[a], sine[a]
                parts, seen = parts_at(c, s, voxel), strips_seen_at(c, s, voxel, 1, height, width)
                low = lowest_strip(fast[fast0] * c - slow[slow0] * s - first, c, s, voxel, height, width)
                begin[:seen], end[:seen] = height, 0
                for line in range(height):
                    start = (low + first - fast[fast0] * c + slow[slow0 + line] * s) / (voxel * c)
                    voxel_0 = spare + (slow0 + line) * pitch
                    gathered(seen, start, c, s, voxel, parts, width, line, voxel_0 + fast0, at, weights, begin, end)
                    if loses:
                        for row in range(line * parts, (line + 1) * parts):
                            along = side * (fast[0] * s + slow[slow0 + line] * c)
                            weaken_gathered(seen, row, low, at, weights, absorbed_fast, absorbed_slow, a, slow0 + line,
                                            voxel_0, along, side * voxel * s, tilt, both)  # fmt: skip
                weights[height * parts :] = 0
                for k in range(max(0, -low), min(seen, strips - low)):
                    for entry in range(begin[k] * parts, end[k] * parts, ENTRIES_A_PASS):
                        add_shadows(projections, a * strips + low + k, rows, entry, k, at, weights)
