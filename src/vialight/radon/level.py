"""Backprojection of whole sinograms along level rays."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray
from vialight.radon.memory import aligned_zeros, padded_depth
from vialight.radon.taps import tap

_TILE = 32
"""Edge of a tile in pixels: its accumulators and the stretch of sinogram that it reads stay in cache."""

_ANGLES_A_PASS = 6
"""Angles summed before an accumulator is written back; twelve weights just fit the registers."""


def backproject(
    filtered: Float32Array,
    psi_rad: FloatArray,
    first_s_mm: float,
    spacing_mm: float,
    x_mm: FloatArray,
    y_mm: FloatArray,
    *,
    slices: Float32Array | None = None,
) -> Float32Array:
    """Smear filtered projections back over their rays and sum them.

    Parameters
    ----------
    filtered
        (psi, s, z) float32, two samples or more.
    psi_rad
        (psi,) angles, in any order.
    first_s_mm, spacing_mm
        Position of the first sample and distance between samples.
    x_mm, y_mm
        Pixel centres.
    slices
        (z, y, x) contiguous float32 memory for the result; by default new memory.

    Returns
    -------
    numpy.ndarray
        (y, x, z) float32, a view of (z, y, x): the plain sum over angles, linearly interpolated in s; what lies outside
        the samples counts as zero.
    """
    psi_rad = np.concatenate([psi_rad, np.zeros(-len(psi_rad) % _ANGLES_A_PASS)])
    cosine, sine = np.cos(psi_rad) / spacing_mm, np.sin(psi_rad) / spacing_mm
    if slices is None:
        slices = np.empty((filtered.shape[2], len(y_mm), len(x_mm)), np.float32)
    _backproject(_padded(filtered), cosine, sine, first_s_mm / spacing_mm, x_mm, y_mm, slices)
    return slices.transpose(1, 2, 0)


def _padded(filtered: Float32Array) -> Float32Array:
    """Copy (psi, s, z) to where every column of slices begins on a cache line, zeros filling the last pass and line."""
    angles, samples, depth = filtered.shape
    padded = aligned_zeros((angles + -angles % _ANGLES_A_PASS, samples, padded_depth(depth)))
    padded[:angles, :, :depth] = filtered
    return padded


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _backproject(
    filtered: Float32Array,
    cosine: FloatArray,
    sine: FloatArray,
    first: float,
    x_mm: FloatArray,
    y_mm: FloatArray,
    total: Float32Array,
) -> None:
    angles, samples, depth = filtered.shape
    stacks = filtered.reshape((angles * samples, depth))
    # Unsigned: a signed index would be looked at for counting from the end.
    one = np.uint64(1)
    tiles_x = (len(x_mm) + _TILE - 1) // _TILE
    tiles_y = (len(y_mm) + _TILE - 1) // _TILE
    for tile in prange(tiles_x * tiles_y):
        y_start = tile // tiles_x * _TILE
        x_start = tile % tiles_x * _TILE
        rows, columns = min(_TILE, len(y_mm) - y_start), min(_TILE, len(x_mm) - x_start)
        sums = np.zeros((rows, columns, depth), np.float32)
        # Index and weights of a row of pixels are found ahead of their use, many at once in a vector register.
        at = np.empty((_ANGLES_A_PASS, columns), np.uint64)
        v, w = np.empty((_ANGLES_A_PASS, columns), np.float32), np.empty((_ANGLES_A_PASS, columns), np.float32)
        for a in range(0, angles, _ANGLES_A_PASS):
            for iy in range(rows):
                for k in range(_ANGLES_A_PASS):
                    offset = -y_mm[y_start + iy] * sine[a + k] - first
                    for ix in range(columns):
                        index, v[k, ix], w[k, ix] = tap(x_mm[x_start + ix] * cosine[a + k] + offset, samples)
                        at[k, ix] = (a + k) * samples + index
                for ix in range(columns):
                    i0, i1, i2, i3, i4, i5 = at[0, ix], at[1, ix], at[2, ix], at[3, ix], at[4, ix], at[5, ix]
                    v0, v1, v2, v3, v4, v5 = v[0, ix], v[1, ix], v[2, ix], v[3, ix], v[4, ix], v[5, ix]
                    w0, w1, w2, w3, w4, w5 = w[0, ix], w[1, ix], w[2, ix], w[3, ix], w[4, ix], w[5, ix]
                    for z in range(depth):
                        sums[iy, ix, z] += (
                            v0 * stacks[i0, z]
                            + w0 * stacks[i0 + one, z]
                            + v1 * stacks[i1, z]
                            + w1 * stacks[i1 + one, z]
                            + v2 * stacks[i2, z]
                            + w2 * stacks[i2 + one, z]
                            + v3 * stacks[i3, z]
                            + w3 * stacks[i3 + one, z]
                            + v4 * stacks[i4, z]
                            + w4 * stacks[i4 + one, z]
                            + v5 * stacks[i5, z]
                            + w5 * stacks[i5 + one, z]
                        )
        for z in range(len(total)):
            for iy in range(rows):
                for ix in range(columns):
                    total[z, y_start + iy, x_start + ix] = sums[iy, ix, z]
