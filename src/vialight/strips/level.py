"""Light that stays in its slice."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray
from vialight.strips.shadows import shadow, shadow_before

_TILE = 32
_BLOCK = 64
"""Pixels along the edge of a tile, and slices in a block: what is summed together stays in cache."""


@njit(inline="always")
def _loss(along: float, absorption: float, tilt: float, both: bool) -> float:
    """Share of the light that is left after `along`, absorbed and spread; 1 on the axis."""
    if absorption == 0.0 and tilt == 0.0:
        return 1.0
    there = np.exp(-absorption * along) / (1 + along * tilt)
    if not both:
        return float(there)
    return float(0.5 * (there + np.exp(absorption * along) / (1 - along * tilt)))


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
    dose: Float32Array,
) -> None:
    """Add to `dose` the light of all projections; lengths in strip widths."""
    angles, samples, depth = projections.shape
    tiles_x, tiles_y = (len(xs) + _TILE - 1) // _TILE, (len(ys) + _TILE - 1) // _TILE
    blocks = (depth + _BLOCK - 1) // _BLOCK
    for job in prange(tiles_x * tiles_y * blocks):
        tile, low = job // blocks, job % blocks * _BLOCK
        high = min(low + _BLOCK, depth)
        y_start, x_start = tile // tiles_x * _TILE, tile % tiles_x * _TILE
        for a in range(angles):
            for iy in range(y_start, min(y_start + _TILE, len(ys))):
                for ix in range(x_start, min(x_start + _TILE, len(xs))):
                    x, y = xs[ix], ys[iy]
                    middle, half_top, half_base, start, end = shadow(x, y, cosine[a], sine[a], first, voxel)
                    along = x * sine[a] + y * cosine[a]
                    before = 0.0
                    for i in range(start, end + 1):
                        until = shadow_before(i + 0.5 - middle, half_top, half_base)
                        if 0 <= i < samples:
                            weight = np.float32((until - before) * _loss(along, absorption, tilt[i], both))
                            lit, light = dose[iy, ix, low:high], projections[a, i, low:high]
                            for z in range(len(light)):
                                lit[z] += weight * light[z]
                        before = until


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
    projections: Float32Array,
) -> None:
    """Add all voxels to `projections`: the transpose of `backproject`."""
    angles, samples, depth = projections.shape
    blocks = (depth + _BLOCK - 1) // _BLOCK
    for job in prange(angles * blocks):
        a, low = job // blocks, job % blocks * _BLOCK
        high = min(low + _BLOCK, depth)
        for iy in range(len(ys)):
            for ix in range(len(xs)):
                x, y = xs[ix], ys[iy]
                middle, half_top, half_base, start, end = shadow(x, y, cosine[a], sine[a], first, voxel)
                along = x * sine[a] + y * cosine[a]
                before = 0.0
                for i in range(start, end + 1):
                    until = shadow_before(i + 0.5 - middle, half_top, half_base)
                    if 0 <= i < samples:
                        weight = np.float32((until - before) * _loss(along, absorption, tilt[i], both))
                        seen, column = projections[a, i, low:high], volume[iy, ix, low:high]
                        for z in range(len(column)):
                            seen[z] += weight * column[z]
                    before = until
