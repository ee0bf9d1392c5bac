"""Backprojection of whole sinograms along level rays."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH, FLOATS_A_LINE, aligned_zeros, is_aligned, without_overlap
from vialight.tomography.radon.taps import tap

_TILE = 16
"""Pixels along the edge of a tile: its sums stay in the second cache; what a run of pixels reads in the first, for the
next run."""

_GAP = 64
"""Floats between rows of a tile's sums: pixels below each other would else want the same places of the first cache."""

_ANGLES_A_PASS = 6
"""Angles summed before an accumulator is written back; twelve weights just fit the registers."""

_FEW_SLICES, _MANY_SLICES = 16, 64
"""Slices taken at a time."""

_Lines = tuple[int, ...]
"""As many numbers, of no meaning, as a stack of slices has cache lines: the length of a tuple is known to the compiler,
which makes addresses cheap and saves a fifth."""


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
    s_of_x, s_of_y = np.cos(psi_rad) / spacing_mm, -np.sin(psi_rad) / spacing_mm
    if slices is None:
        slices = np.empty((filtered.shape[2], len(y_mm), len(x_mm)), np.float32)
    for start in range(0, len(slices), _MANY_SLICES):
        stack = slices[start : start + _MANY_SLICES]
        depth = _FEW_SLICES if len(stack) <= _FEW_SLICES else _MANY_SLICES
        _backproject(
            _padded(filtered[..., start : start + _MANY_SLICES], depth), (0,) * (depth // FLOATS_A_LINE),
            s_of_x, s_of_y, first_s_mm / spacing_mm, x_mm, y_mm, radius_mm, stack,
        )  # fmt: skip
    return slices.transpose(1, 2, 0)


def _padded(filtered: Float32Array, depth: int) -> Float32Array:
    """Return (psi, s, z) with stacks of slices that begin on cache lines, and zeros that fill the last pass and stack.

    What `filter_rays` makes of full stacks lies so already, and is not copied.
    """
    angles, samples, count = filtered.shape
    shape = (angles + -angles % _ANGLES_A_PASS, samples, depth)
    if filtered.shape == shape and is_aligned(filtered):
        return filtered
    padded = aligned_zeros(shape)
    padded[:angles, :, :count] = filtered
    return padded


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _backproject(
    filtered: Float32Array,
    lines: _Lines,
    s_of_x: FloatArray,
    s_of_y: FloatArray,
    first: float,
    x_mm: FloatArray,
    y_mm: FloatArray,
    radius: float,
    total: Float32Array,
) -> None:
    angles, samples, depth = filtered.shape
    flat = filtered.reshape(-1)
    tiles_x, tiles_y = (len(x_mm) + _TILE - 1) // _TILE, (len(y_mm) + _TILE - 1) // _TILE
    for tile in prange(tiles_x * tiles_y):
        y_start, x_start = tile // tiles_x * _TILE, tile % tiles_x * _TILE
        x, y = x_mm[x_start : x_start + _TILE], y_mm[y_start : y_start + _TILE]
        if np.hypot(max(x[0], -x[-1], 0.0), max(y[0], -y[-1], 0.0)) > radius:
            total[:, y_start : y_start + len(y), x_start : x_start + len(x)] = 0
            continue
        pitch = len(x) * depth + _GAP
        sums = np.zeros(len(y) * pitch, np.float32)
        # Place and weights of a run of pixels are found ahead of their use, many at once in a vector register.
        # Places are unsigned: a signed index would be looked at for counting from the end.
        at = np.empty((_ANGLES_A_PASS, _TILE), np.uint64)
        v, w = np.empty(at.shape, np.float32), np.empty(at.shape, np.float32)
        for a in range(0, angles, _ANGLES_A_PASS):
            # Runs lie where s changes less from pixel to pixel, so that they read fewer samples.
            if abs(s_of_x[a]) < abs(s_of_y[a]):
                along, across, s_along, s_across, pitch_along, pitch_across = x, y, s_of_x, s_of_y, depth, pitch
            else:
                along, across, s_along, s_across, pitch_along, pitch_across = y, x, s_of_y, s_of_x, pitch, depth
            for j in range(len(across)):
                for k in range(_ANGLES_A_PASS):
                    offset = across[j] * s_across[a + k] - first
                    for i in range(len(along)):
                        index, v[k, i], w[k, i] = tap(along[i] * s_along[a + k] + offset, samples)
                        at[k, i] = ((a + k) * samples + index) * depth
                for i in range(len(along)):
                    _add_pass(sums, np.uint64(j * pitch_across + i * pitch_along), flat, lines, at, v, w, i)
        for iy in range(len(y)):
            for ix in range(len(x)):
                if np.hypot(x[ix], y[iy]) > radius:
                    sums[iy * pitch + ix * depth : iy * pitch + (ix + 1) * depth] = 0
            for n in range(len(total)):
                for ix in range(len(x)):
                    total[n, y_start + iy, x_start + ix] = sums[iy * pitch + ix * depth + n]


@without_overlap
def _add_pass(
    sums: Float32Array, here: np.uint64, flat: Float32Array, lines: _Lines,
    at: NDArray[np.uint64], v: Float32Array, w: Float32Array, i: int,
) -> None:  # fmt: skip
    """Add to a pixel's stack of `sums`, from `here` on, what a pass of angles brings: samples by v, the next by w."""
    depth = len(lines) * FLOATS_A_LINE
    stack = np.uint64(depth)
    i0, i1, i2, i3, i4, i5 = at[0, i], at[1, i], at[2, i], at[3, i], at[4, i], at[5, i]
    v0, v1, v2, v3, v4, v5 = v[0, i], v[1, i], v[2, i], v[3, i], v[4, i], v[5, i]
    w0, w1, w2, w3, w4, w5 = w[0, i], w[1, i], w[2, i], w[3, i], w[4, i], w[5, i]
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
