"""Light that climbs from slice to slice."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from vialight.core.compiling import FAST_MATH, without_overlap
from vialight.planning.strips.level import (
    ANGLES_A_JOB,
    ENTRIES_A_PASS,
    lowest_strip,
    shadows_in_line,
    strips_seen,
    strips_seen_at,
    tile_at,
    tiles_of,
    wanted,
    weaken_line,
)
from vialight.planning.strips.shadows import TAPS, Int32Array, shadows, weaken
from vialight.planning.strips.sums import IDS, ROWS_A_PAIR, add_rows_to_two, add_shadows, fill_up, list_by_strip

_PARTS_A_PASS = ENTRIES_A_PASS // 2
"""Angles, or parts of shadows, summed before a voxel is written back: each counts at the knots before and behind it."""


@njit(fastmath=FAST_MATH, cache=True)
def _stretch(z: int, drift: float, first_height: float, depth: int) -> tuple[int, int]:
    """Return by how many slices the mid-height of the ray through slice z lies off it, and where that number changes.

    Rays climb little, so that long stretches of slices share a whole number of slices: loops over them vectorise.
    """
    offset = int(np.floor(drift * (z + first_height)))
    if drift > 0:
        end = np.ceil((offset + 1) / drift - first_height)
    elif drift < 0:
        end = np.floor(offset / drift - first_height) + 1
    else:
        end = float(depth)
    return offset, int(min(max(end, z + 1.0), float(depth)))


@without_overlap
def _gather_climbing(
    rows: Float32Array, row: int, light: Float32Array, a: int, strip: int, weight: np.float32, drift: float,
    first_height: float, ramp: Float32Array,
) -> None:  # fmt: skip
    """Add to each slice of a row the light of the mid-height of its ray, linear between slices, the end ones going on.

    ``ramp`` is 0, 1, 2, ...: vectors hold no conversion of long integers to floats.
    """
    depth, one = light.shape[2], np.uint64(1)
    start = 0
    while start < depth:
        offset, end = _stretch(start, drift, first_height, depth)
        inner_start, inner_end = min(max(start, -offset), end), max(min(end, depth - 1 - offset), start)
        for z in range(start, inner_start):
            rows[row, z] += weight * light[a, strip, 0]
        for z in range(max(inner_end, inner_start), end):
            rows[row, z] += weight * light[a, strip, depth - 1]
        begin, below = np.uint64(inner_start), np.uint64(inner_start + offset)
        share, step = np.float32(drift * (inner_start + first_height) - offset), np.float32(drift)
        for k in range(np.uint64(max(inner_end - inner_start, 0))):
            low, high = light[a, strip, below + k], light[a, strip, below + k + one]
            rows[row, begin + k] += weight * (low + (share + step * ramp[k]) * (high - low))
        start = end


@without_overlap
def _scatter_climbing(
    light: Float32Array, a: int, strip: int, rows: Float32Array, row: int, weight: np.float32, drift: float,
    first_height: float, ramp: Float32Array,
) -> None:  # fmt: skip
    """Transpose of `_gather_climbing`."""
    depth, one = light.shape[2], np.uint64(1)
    start = 0
    while start < depth:
        offset, end = _stretch(start, drift, first_height, depth)
        inner_start, inner_end = min(max(start, -offset), end), max(min(end, depth - 1 - offset), start)
        for z in range(start, inner_start):
            light[a, strip, 0] += weight * rows[row, z]
        for z in range(max(inner_end, inner_start), end):
            light[a, strip, depth - 1] += weight * rows[row, z]
        begin, below = np.uint64(inner_start), np.uint64(inner_start + offset)
        share, step = np.float32(drift * (inner_start + first_height) - offset), np.float32(drift)
        count = np.uint64(max(inner_end - inner_start, 0))
        for k in range(count):
            light[a, strip, below + k] += weight * (np.float32(1) - share - step * ramp[k]) * rows[row, begin + k]
        for k in range(count):
            light[a, strip, below + k + one] += weight * (share + step * ramp[k]) * rows[row, begin + k]
        start = end


@njit(inline="always")
def _reach(c: float, s: float, x: float, y: float, voxel: float, height: int, width: int) -> tuple[float, float]:
    """Return the least way past the axis that light has gone in a tile whose first voxel is at x, y; and the span."""
    along_x, along_y = (width - 1) * voxel * s, (height - 1) * voxel * c
    return x * s + y * c + min(0.0, along_x) + min(0.0, along_y), max(abs(along_x) + abs(along_y), 1e-6)


@njit(inline="always")
def _way(way: int, along: float, slope: float, absorption: float, both: bool) -> tuple[np.float32, float]:
    """Return weight and drift of light that comes one way; its mean loss over both ways is put in at the voxels."""
    side = 1 - 2 * way
    shrink = 1 / (1 + side * along * slope)
    share = 0.5 * (1 - side * np.tanh(absorption * along)) if both else 1.0
    return np.float32(share * shrink), shrink - 1


@njit(fastmath=FAST_MATH, cache=True)
def _split(
    count: int, row: int, far: int, first: Int32Array, weights: Float32Array, offset: float, step: float, knots: int,
    seen: int,
) -> None:  # fmt: skip
    """Split the shares in ``weights[row]`` between the knots about each voxel, linearly along the light.

    Parameters
    ----------
    count
        Voxels.
    row, far, first, weights
        See `shadows`; ``weights[far]`` is filled, and ``first[row]`` moved to the knot before the voxel.
    offset, step
        Where the first voxel is, in knots, and how far from one to the next.
    knots, seen
        How many there are, and how many strips at each.
    """
    for k in range(count):
        at = min(max(np.float32(offset + k * step), np.float32(0)), np.float32(knots - 1))
        knot = min(np.int32(at), np.int32(knots - 2))
        share = at - np.float32(knot)
        first[row, k] += knot * np.int32(seen)
        for tap in range(TAPS):
            weights[far, tap, k] = share * weights[row, tap, k]
            weights[row, tap, k] -= weights[far, tap, k]


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def backproject(
    tile: int, parts: int, knots: int, there: Float32Array, back: Float32Array, lit: IntArray, cosine: FloatArray,
    sine: FloatArray, first: float, voxel: float, xs: FloatArray, ys: FloatArray, reached_x: IntArray,
    reached_y: IntArray, absorbed_x: Float32Array, absorbed_y: Float32Array, tilt: Float32Array, absorption: float,
    both: bool, first_height: float, depth: int, dose: Float32Array,
) -> None:  # fmt: skip
    """Fill `dose` with the light of all projections; lengths in strip widths, `first_height` in slices.

    What a strip's light has become by its climb is found at some knots along its way through every tile of voxels, and
    is linear between them.

    Parameters
    ----------
    knots
        Two or more.
    there, back
        (psi, strip, z) light that goes one way, and of the same strips the other way; the latter only counts if `both`.
    tile, parts, lit, cosine, sine, first, voxel, xs, ys, reached_x, reached_y, absorbed_x, absorbed_y, tilt, both, dose
        See `level.backproject`.
    absorption
        Per strip width.
    first_height
        Of the first slice, in slices.
    depth
        Slices in whole cache lines.
    """
    angles, _, slices = there.shape
    seen, level = strips_seen(tile, voxel, parts), np.zeros((TAPS, tile), np.float32)
    angles_a_pass, ramp = _PARTS_A_PASS // parts, np.arange(slices).astype(np.float32)
    for number in prange(tiles_of(tile, len(xs), len(ys))):
        y0, x0, height, width = tile_at(number, tile, len(xs), len(ys))
        sums = np.zeros((tile * tile, depth), np.float32)
        at = np.zeros((ENTRIES_A_PASS, tile), np.int32)
        weights = np.zeros((ENTRIES_A_PASS, TAPS, tile), np.float32)
        rows, lows = np.zeros((angles_a_pass * knots * seen, depth), np.float32), np.empty(angles_a_pass, np.int64)
        for a in range(0, angles, angles_a_pass):
            passed = min(angles_a_pass, angles - a)
            is_lit = False
            for k in range(passed):
                c, s = cosine[a + k], sine[a + k]
                lows[k] = lowest_strip(xs[x0] * c - ys[y0] * s - first, c, s, voxel, height, width)
                is_lit = is_lit or (lit[a + k, 1] > lows[k] and lit[a + k, 0] < lows[k] + seen)
            if not is_lit:
                continue
            for k in range(passed):
                c, s = cosine[a + k], sine[a + k]
                near, span = _reach(c, s, xs[x0], ys[y0], voxel, height, width)
                for strip in range(strips_seen_at(c, s, voxel, parts, height, width)):
                    i = lows[k] + strip
                    for knot in range(knots):
                        row = (k * knots + knot) * seen + strip
                        rows[row] = 0
                        if lit[a + k, 0] <= i < lit[a + k, 1]:
                            along = near + span * knot / (knots - 1)
                            weight, drift = _way(0, along, tilt[i], absorption, both)
                            _gather_climbing(rows, row, there, a + k, i, weight, drift, first_height, ramp)
                            if both:
                                weight, drift = _way(1, along, tilt[i], absorption, both)
                                _gather_climbing(rows, row, back, a + k, i, weight, drift, first_height, ramp)
            weights[2 * parts * passed :] = 0
            upright = abs(cosine[a]) >= abs(sine[a])
            for line in range(width if upright else height):
                begin, end = wanted(upright, line, reached_x, reached_y, x0, y0, height, width)
                if begin >= end:
                    continue
                for k in range(passed):
                    c, s, entry = cosine[a + k], sine[a + k], 2 * parts * k
                    near, span = _reach(c, s, xs[x0], ys[y0], voxel, height, width)
                    a_knot = span / (knots - 1)
                    shadows_in_line(upright, line, xs, ys, x0, y0, height, width, first, c, s, voxel, parts,
                                    k * knots * seen - lows[k], entry, at, weights)  # fmt: skip
                    along = xs[x0 + line] * s + ys[y0] * c if upright else xs[x0] * s + ys[y0 + line] * c
                    step = voxel * c if upright else voxel * s
                    for row in range(entry, entry + parts):
                        if absorption:
                            weaken_line(upright, line, xs, ys, x0, y0, height, width, c, s, voxel, row, weights,
                                        absorbed_x, absorbed_y, a + k, level, both)  # fmt: skip
                        _split(height if upright else width, row, row + parts, at, weights, (along - near) / a_knot,
                               step / a_knot, knots, seen)  # fmt: skip
                        for i in range(tile):
                            at[row + parts, i] = at[row, i] + seen
                for i in range(begin, end):
                    add_shadows(sums, i * tile + line if upright else line * tile + i, rows, 0, i, at, weights)
        for iy in range(height):
            for ix in range(width):
                dose[y0 + iy, x0 + ix] = sums[iy * tile + ix, :slices]


@njit(inline="always")
def _voxels_seen(tile: int, voxel: float) -> int:
    """Return how many voxels of a tile throw their shadow on one strip, and some to fill up groups, at most."""
    return min(tile * tile, int(1.5 * tile * (2.5 / voxel + 2))) + ROWS_A_PAIR


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def project(
    tile: int, knots: int, rows: Float32Array, pitch: int, filled: BoolArray, cosine: FloatArray, sine: FloatArray,
    first: float, voxel: float, xs: FloatArray, ys: FloatArray, absorbed_x: Float32Array, absorbed_y: Float32Array,
    tilt: Float32Array, absorption: float, both: bool, first_height: float, projections: Float32Array,
) -> None:  # fmt: skip
    """Add all voxels to `projections`, (psi, strip, z): the transpose of `backproject`; see `level.project`."""
    angles, strips, slices = projections.shape
    seen, ways, level = strips_seen(tile, voxel, 1), 2 if both else 1, np.zeros((TAPS, tile), np.float32)
    room, ramp = _voxels_seen(tile, voxel), np.arange(slices).astype(np.float32)
    for job in prange((angles + ANGLES_A_JOB - 1) // ANGLES_A_JOB):
        at, weights = np.empty((1, tile), np.int32), np.empty((2, TAPS, tile), np.float32)
        # A list for each strip at each knot, of the voxels between it and the next.
        ids, length = np.empty(((knots - 1) * seen, room), IDS), np.empty((knots - 1) * seen, IDS)
        shares = np.empty(((knots - 1) * seen, 2, room), np.float32)
        sums = np.empty((knots, rows.shape[1]), np.float32)
        for number in range(tiles_of(tile, len(xs), len(ys))):
            y0, x0, height, width = tile_at(number, tile, len(xs), len(ys))
            for a in range(job * ANGLES_A_JOB, min((job + 1) * ANGLES_A_JOB, angles)):
                c, s = cosine[a], sine[a]
                low = lowest_strip(xs[x0] * c - ys[y0] * s - first, c, s, voxel, height, width)
                near, span = _reach(c, s, xs[x0], ys[y0], voxel, height, width)
                a_knot = span / (knots - 1)
                length[:] = 0
                for iy in range(height):
                    x, y = xs[x0], ys[y0 + iy]
                    shadows(width, x * c - y * s - first, c, s, voxel, 1, -low, 0, at, weights)
                    if absorption:
                        weaken(width, 0, weights, absorbed_x, absorbed_y, a, x0, y0 + iy, 0.0, 0.0, level, both)
                    _split(width, 0, 1, at, weights, (x * s + y * c - near) / a_knot, voxel * s / a_knot, knots, seen)
                    list_by_strip(width, y0 + iy, x0, pitch, filled, at, weights, ids, shares, length)
                for strip in range(max(0, -low), min(seen, strips - low)):
                    sums[:] = 0
                    last = -1
                    for knot in range(knots - 1):
                        number_of_list = knot * seen + strip
                        if length[number_of_list]:
                            count = fill_up(number_of_list, ids, shares, length, ROWS_A_PAIR)
                            add_rows_to_two(sums, knot, rows, number_of_list, ids, shares, count)
                            last = knot + 1
                    for knot in range(last + 1):
                        for way in range(ways):
                            along = near + a_knot * knot
                            weight, drift = _way(way, along, tilt[low + strip], absorption, both)
                            _scatter_climbing(
                                projections, a, low + strip, sums, knot, weight, drift, first_height, ramp
                            )
