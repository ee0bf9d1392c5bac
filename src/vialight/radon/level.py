"""Backprojection of whole sinograms along level rays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray
from vialight.memory import aligned_zeros
from vialight.radon.taps import tap

_TILE_ROWS, _TILE_COLUMNS = 32, 16
"""Pixels of a tile: its sums stay in the second cache; what a row of it reads stays in the first for the next row."""

_ANGLES_A_PASS = 6
"""Angles summed before an accumulator is written back; twelve weights just fit the registers."""

_FEW_SLICES, _MANY_SLICES = 16, 64
"""Slices that a kernel takes at a time.  Known to the compiler, they make addresses cheap, which saves a fifth."""


def backproject(
    filtered: Float32Array,
    psi_rad: FloatArray,
    first_s_mm: float,
    spacing_mm: float,
    x_mm: FloatArray,
    y_mm: FloatArray,
    *,
    radius_mm: float = np.inf,
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
    radius_mm
        Farther from the axis nothing is wanted: pixels that lie there are 0.
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
    for start in range(0, len(slices), _MANY_SLICES):
        stack = slices[start : start + _MANY_SLICES]
        depth = _FEW_SLICES if len(stack) <= _FEW_SLICES else _MANY_SLICES
        _KERNELS[depth](
            _padded(filtered[..., start : start + _MANY_SLICES], depth),
            cosine, sine, first_s_mm / spacing_mm, x_mm, y_mm, radius_mm, stack,
        )  # fmt: skip
    return slices.transpose(1, 2, 0)


def _padded(filtered: Float32Array, depth: int) -> Float32Array:
    """Copy (psi, s, z) to where every stack of slices begins on a cache line, zeros filling the last pass and stack."""
    angles, samples, count = filtered.shape
    padded = aligned_zeros((angles + -angles % _ANGLES_A_PASS, samples, depth))
    padded[:angles, :, :count] = filtered
    return padded


def _kernel(depth: int) -> Callable[..., None]:
    """Return the kernel for stacks of `depth` slices."""
    stack = np.uint64(depth)

    @njit(parallel=True, fastmath=FAST_MATH, cache=True)
    def run(
        filtered: Float32Array,
        cosine: FloatArray,
        sine: FloatArray,
        first: float,
        x_mm: FloatArray,
        y_mm: FloatArray,
        radius: float,
        total: Float32Array,
    ) -> None:
        angles, samples, _ = filtered.shape
        flat = filtered.reshape(-1)
        tiles_x = (len(x_mm) + _TILE_COLUMNS - 1) // _TILE_COLUMNS
        tiles_y = (len(y_mm) + _TILE_ROWS - 1) // _TILE_ROWS
        for tile in prange(tiles_x * tiles_y):
            y_start = tile // tiles_x * _TILE_ROWS
            x_start = tile % tiles_x * _TILE_COLUMNS
            x, y = x_mm[x_start : x_start + _TILE_COLUMNS], y_mm[y_start : y_start + _TILE_ROWS]
            if np.hypot(max(x[0], -x[-1], 0.0), max(y[0], -y[-1], 0.0)) > radius:
                total[:, y_start : y_start + len(y), x_start : x_start + len(x)] = 0
                continue
            sums = np.zeros(len(y) * len(x) * depth, np.float32)
            # Place and weights of a row of pixels are found ahead of their use, many at once in a vector register.
            # Places are unsigned: a signed index would be looked at for counting from the end.
            at = np.empty((_ANGLES_A_PASS, _TILE_COLUMNS), np.uint64)
            v, w = np.empty(at.shape, np.float32), np.empty(at.shape, np.float32)
            for a in range(0, angles, _ANGLES_A_PASS):
                for iy in range(len(y)):
                    for k in range(_ANGLES_A_PASS):
                        offset = -y[iy] * sine[a + k] - first
                        for ix in range(len(x)):
                            index, v[k, ix], w[k, ix] = tap(x[ix] * cosine[a + k] + offset, samples)
                            at[k, ix] = ((a + k) * samples + index) * depth
                    for ix in range(len(x)):
                        i0, i1, i2, i3, i4, i5 = at[0, ix], at[1, ix], at[2, ix], at[3, ix], at[4, ix], at[5, ix]
                        v0, v1, v2, v3, v4, v5 = v[0, ix], v[1, ix], v[2, ix], v[3, ix], v[4, ix], v[5, ix]
                        w0, w1, w2, w3, w4, w5 = w[0, ix], w[1, ix], w[2, ix], w[3, ix], w[4, ix], w[5, ix]
                        here = np.uint64((iy * len(x) + ix) * depth)
                        for n in range(depth):
                            z = np.uint64(n)
                            sums[here + z] += (
                                v0 * flat[i0 + z]
                                + w0 * flat[i0 + stack + z]
                                + v1 * flat[i1 + z]
                                + w1 * flat[i1 + stack + z]
                                + v2 * flat[i2 + z]
                                + w2 * flat[i2 + stack + z]
                                + v3 * flat[i3 + z]
                                + w3 * flat[i3 + stack + z]
                                + v4 * flat[i4 + z]
                                + w4 * flat[i4 + stack + z]
                                + v5 * flat[i5 + z]
                                + w5 * flat[i5 + stack + z]
                            )
            for iy in range(len(y)):
                for ix in range(len(x)):
                    if np.hypot(x[ix], y[iy]) > radius:
                        sums[(iy * len(x) + ix) * depth : (iy * len(x) + ix + 1) * depth] = 0
            for n in range(len(total)):
                for iy in range(len(y)):
                    for ix in range(len(x)):
                        total[n, y_start + iy, x_start + ix] = sums[(iy * len(x) + ix) * depth + n]

    kernel: Callable[..., None] = run
    return kernel


_KERNELS = {depth: _kernel(depth) for depth in (_FEW_SLICES, _MANY_SLICES)}
