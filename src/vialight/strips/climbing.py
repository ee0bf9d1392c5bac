"""Light that climbs from slice to slice."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray
from vialight.strips.shadows import shadow, shadow_before


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


@njit(fastmath=FAST_MATH, cache=True)
def _gather_climbing(
    lit: Float32Array, light: Float32Array, weight: np.float32, drift: float, first_height: float
) -> None:
    """Add to each slice the light of the mid-height of its ray, linear between slices, the end ones going on."""
    depth = len(lit)
    start = 0
    while start < depth:
        offset, end = _stretch(start, drift, first_height, depth)
        inner_start, inner_end = min(max(start, -offset), end), max(min(end, depth - 1 - offset), start)
        for z in range(start, inner_start):
            lit[z] += weight * light[0]
        for z in range(max(inner_end, inner_start), end):
            lit[z] += weight * light[depth - 1]
        count = inner_end - inner_start
        if count > 0:
            here, below = lit[inner_start:inner_end], light[inner_start + offset : inner_end + offset]
            above = light[inner_start + offset + 1 : inner_end + offset + 1]
            share = np.float32(drift * (inner_start + first_height) - offset)
            step = np.float32(drift)
            for k in range(count):
                high = share + step * np.float32(k)
                here[k] += weight * (below[k] + high * (above[k] - below[k]))
        start = end


@njit(fastmath=FAST_MATH, cache=True)
def _scatter_climbing(
    seen: Float32Array, column: Float32Array, weight: np.float32, drift: float, first_height: float
) -> None:
    """Transpose of `_gather_climbing`."""
    depth = len(column)
    start = 0
    while start < depth:
        offset, end = _stretch(start, drift, first_height, depth)
        inner_start, inner_end = min(max(start, -offset), end), max(min(end, depth - 1 - offset), start)
        for z in range(start, inner_start):
            seen[0] += weight * column[z]
        for z in range(max(inner_end, inner_start), end):
            seen[depth - 1] += weight * column[z]
        count = inner_end - inner_start
        if count > 0:
            here, below = column[inner_start:inner_end], seen[inner_start + offset : inner_end + offset]
            above = seen[inner_start + offset + 1 : inner_end + offset + 1]
            share = np.float32(drift * (inner_start + first_height) - offset)
            step = np.float32(drift)
            for k in range(count):
                below[k] += weight * (np.float32(1) - share - step * np.float32(k)) * here[k]
            for k in range(count):
                above[k] += weight * (share + step * np.float32(k)) * here[k]
        start = end


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def backproject(
    projections: Float32Array,
    cosine: FloatArray,
    sine: FloatArray,
    first: float,
    voxel: float,
    xs: FloatArray,
    ys: FloatArray,
    absorption: float,
    tilt: FloatArray,
    both: bool,
    first_height: float,
    dose: Float32Array,
) -> None:
    """Add to `dose` the light of all projections; lengths in strip widths, `first_height` in slices."""
    angles, samples, depth = projections.shape
    ways = 2 if both else 1
    for iy in prange(len(ys)):
        light = np.empty(depth, np.float32)
        for a in range(angles):
            for ix in range(len(xs)):
                x, y = xs[ix], ys[iy]
                middle, half_top, half_base, start, end = shadow(x, y, cosine[a], sine[a], first, voxel)
                light[:] = 0
                before = 0.0
                for i in range(start, end + 1):
                    until = shadow_before(i + 0.5 - middle, half_top, half_base)
                    if 0 <= i < samples:
                        share, strip = np.float32(until - before), projections[a, i]
                        for z in range(depth):
                            light[z] += share * strip[z]
                    before = until
                # Neighbouring strips climb alike: the middle one's tilt does for all.
                along, slope = x * sine[a] + y * cosine[a], tilt[min(max(int(middle + 0.5), 0), samples - 1)]
                for way in range(ways):
                    side = 1 - 2 * way
                    shrink = 1 / (1 + side * along * slope)
                    weight = np.float32(np.exp(-absorption * side * along) * shrink / ways)
                    _gather_climbing(dose[iy, ix], light, weight, shrink - 1, first_height)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def project(
    volume: Float32Array,
    cosine: FloatArray,
    sine: FloatArray,
    first: float,
    voxel: float,
    xs: FloatArray,
    ys: FloatArray,
    absorption: float,
    tilt: FloatArray,
    both: bool,
    first_height: float,
    projections: Float32Array,
) -> None:
    """Add all voxels to `projections`: the transpose of `backproject`."""
    angles, samples, depth = projections.shape
    ways = 2 if both else 1
    for a in prange(angles):
        seen = np.empty(depth, np.float32)
        for iy in range(len(ys)):
            for ix in range(len(xs)):
                x, y = xs[ix], ys[iy]
                middle, half_top, half_base, start, end = shadow(x, y, cosine[a], sine[a], first, voxel)
                along, slope = x * sine[a] + y * cosine[a], tilt[min(max(int(middle + 0.5), 0), samples - 1)]
                seen[:] = 0
                for way in range(ways):
                    side = 1 - 2 * way
                    shrink = 1 / (1 + side * along * slope)
                    weight = np.float32(np.exp(-absorption * side * along) * shrink / ways)
                    _scatter_climbing(seen, volume[iy, ix], weight, shrink - 1, first_height)
                before = 0.0
                for i in range(start, end + 1):
                    until = shadow_before(i + 0.5 - middle, half_top, half_base)
                    if 0 <= i < samples:
                        share, strip = np.float32(until - before), projections[a, i]
                        for z in range(depth):
                            strip[z] += share * seen[z]
                    before = until
