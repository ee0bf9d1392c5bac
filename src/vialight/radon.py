"""The parallel-beam Radon transform of stacks of slices: ramp filters, projection and backprojection.

A ray is the line ``x cos(psi) - y sin(psi) = s`` of the object frame.  Arrays keep z innermost, so that the index and
the weight of a pixel are computed once and applied to a whole column of slices.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray
from vialight.errors import InputError

FilterName = Literal["ram-lak", "shepp-logan", "cosine", "hann"]

_TILE = 32
"""Edge of a tile in pixels: its accumulators and the stretch of sinogram that it reads stay in cache."""

_ANGLES_A_PASS = 6
"""Angles summed before an accumulator is written back; twelve weights just fit the registers."""

_SAMPLES_A_PASS = 12
"""Samples that a filter weighs before a filtered one is written back."""

_CACHE_LINE = 64
"""Bytes.  A vector that lies across two lines takes two reads; NumPy begins large arrays 16 bytes into a line."""


def ramp_filter(name: FilterName, count: int, spacing_mm: float) -> Float32Array:
    """Return a ramp filter as the matrix that convolves a row of samples.

    Parameters
    ----------
    name
        ``ram-lak``: the band-limited ramp, sampled exactly in space (Kak and Slaney 1988, eq. 3.61), so that there is
        no offset as from a ramp sampled in frequency.  ``shepp-logan``: the ramp times sinc(f / 2 f_N), also exact in
        space.  ``cosine`` and ``hann``: the band-limited ramp times cos(pi f / 2 f_N) and cos^2(pi f / 2 f_N), as
        exact combinations of shifted ``ram-lak`` samples.
    count
        Samples in a row.
    spacing_mm
        Distance between samples; f_N = 1 / (2 spacing).

    Returns
    -------
    numpy.ndarray
        (count, count) float32, 1/mm: ``filtered = matrix @ row``.  Symmetric Toeplitz.

    Examples
    --------
    >>> ramp_filter("ram-lak", 2, 1.0)
    array([[ 0.25      , -0.10132118],
           [-0.10132118,  0.25      ]], dtype=float32)
    """
    lag = np.arange(count, dtype=np.float64)
    if name == "ram-lak":
        kernel = _ram_lak(lag)
    elif name == "shepp-logan":
        kernel = -2 / (np.pi**2 * (4 * lag**2 - 1))
    elif name == "cosine":
        # cos(pi f / 2 f_N) = cos(2 pi f spacing / 2): the mean of the ramp half a sample to the left and to the right.
        kernel = (_ram_lak(lag - 0.5) + _ram_lak(lag + 0.5)) / 2
    elif name == "hann":
        kernel = _ram_lak(lag) / 2 + (_ram_lak(lag - 1) + _ram_lak(lag + 1)) / 4
    else:
        raise InputError("filter", f"is {name!r}", accepted=", ".join(get_args(FilterName)))
    index = np.arange(count)
    return np.asarray(kernel[np.abs(index[:, None] - index[None, :])] / spacing_mm, dtype=np.float32)


def _ram_lak(lag: FloatArray) -> FloatArray:
    """Return the band-limited ramp at any lag in samples: the inverse transform of |f| for |f| <= 1/2."""
    return np.sinc(lag) / 2 - np.sinc(lag / 2) ** 2 / 4


def filter_rays(matrix: Float32Array, rays: Float32Array) -> Float32Array:
    """Filter the rays of every angle and height.

    The same as ``matrix @ rays``, without BLAS: the threads of OpenBLAS stay awake after each product and take a core
    from the kernels that follow, which made a reconstruction on two cores a third slower.

    Parameters
    ----------
    matrix
        (s, s) float32, see `ramp_filter`.
    rays
        (psi, s, z) float32.

    Returns
    -------
    numpy.ndarray
        (psi, s, z) float32.

    Examples
    --------
    >>> filter_rays(np.eye(2, dtype=np.float32), np.ones((1, 2, 1), np.float32)).ravel()
    array([1., 1.], dtype=float32)
    """
    filtered = np.zeros(rays.shape, np.float32)
    _filter_rays(np.pad(matrix, ((0, 0), (0, -len(matrix) % _SAMPLES_A_PASS))), rays, filtered)
    return filtered


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
    floats_a_line = _CACHE_LINE // 4
    shape = (angles + -angles % _ANGLES_A_PASS, samples, depth + -depth % floats_a_line)
    room = np.empty(int(np.prod(shape)) + floats_a_line, np.float32)
    start = -room.ctypes.data % _CACHE_LINE // 4
    padded = room[start : start + room.size - floats_a_line].reshape(shape)
    padded[:angles, :, :depth] = filtered
    padded[:angles, :, depth:] = 0
    padded[angles:] = 0
    return padded


def backproject_tilted(
    filtered: Float32Array,
    psi_rad: FloatArray,
    first_s_mm: float,
    spacing_mm: float,
    tilt_per_mm: FloatArray,
    mid_height_mm: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
    z_mm: FloatArray,
) -> Float32Array:
    """Backproject along rays that are parallel seen from above and form a fan in z.

    A ray of mid-height ``z_mid`` runs at height ``z_mid (1 + t tilt(s))``, with t along its plan view from the point
    closest to the axis.

    Parameters
    ----------
    filtered
        (psi, s, z_mid) float32.
    psi_rad, first_s_mm, spacing_mm, x_mm, y_mm
        As for `backproject`.
    tilt_per_mm
        (s,) rise per mm of plan view and per mm of mid-height.
    mid_height_mm
        (z_mid,) evenly spaced, two or more.
    z_mm
        (z,) evenly spaced heights of the voxels.

    Returns
    -------
    numpy.ndarray
        (y, x, z) float32.
    """
    total = np.zeros((len(y_mm), len(x_mm), len(z_mm)), np.float32)
    cosine, sine = np.cos(psi_rad), np.sin(psi_rad)
    _backproject_tilted(
        filtered, cosine, sine, first_s_mm, spacing_mm, tilt_per_mm, mid_height_mm, x_mm, y_mm, z_mm, total
    )
    return total


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _filter_rays(matrix: Float32Array, rays: Float32Array, filtered: Float32Array) -> None:
    angles, samples, depth = rays.shape
    padded = matrix.shape[1]
    for a in prange(angles):
        row = np.zeros((padded, depth), np.float32)
        row[:samples] = rays[a]
        for j in range(0, padded, _SAMPLES_A_PASS):
            for i in range(samples):
                m0, m1, m2, m3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
                m4, m5, m6, m7 = matrix[i, j + 4], matrix[i, j + 5], matrix[i, j + 6], matrix[i, j + 7]
                m8, m9, m10, m11 = matrix[i, j + 8], matrix[i, j + 9], matrix[i, j + 10], matrix[i, j + 11]
                for z in range(depth):
                    filtered[a, i, z] += (
                        m0 * row[j, z]
                        + m1 * row[j + 1, z]
                        + m2 * row[j + 2, z]
                        + m3 * row[j + 3, z]
                        + m4 * row[j + 4, z]
                        + m5 * row[j + 5, z]
                        + m6 * row[j + 6, z]
                        + m7 * row[j + 7, z]
                        + m8 * row[j + 8, z]
                        + m9 * row[j + 9, z]
                        + m10 * row[j + 10, z]
                        + m11 * row[j + 11, z]
                    )


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
                        index, v[k, ix], w[k, ix] = _tap(x_mm[x_start + ix] * cosine[a + k] + offset, samples)
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


@njit(inline="always")
def _tap(position: float, samples: int) -> tuple[int, np.float32, np.float32]:
    """Return index and the two weights of linear interpolation; weights 0 outside the samples.  Free of branches."""
    index = max(min(int(position), samples - 2), 0)
    weight = np.float32(position - index)
    inside = np.float32(1) if 0 <= position <= samples - 1 else np.float32(0)
    return index, inside * (np.float32(1) - weight), inside * weight


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _backproject_tilted(
    filtered: Float32Array,
    cosine: FloatArray,
    sine: FloatArray,
    first_s: float,
    spacing: float,
    tilt: FloatArray,
    heights: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
    z_mm: FloatArray,
    total: Float32Array,
) -> None:
    angles, samples, _ = filtered.shape
    height_spacing = heights[1] - heights[0]
    last = len(heights) - 2
    for iy in prange(len(y_mm)):
        for a in range(angles):
            for ix in range(len(x_mm)):
                x, y = x_mm[ix], y_mm[iy]
                i, v, w = _tap((x * cosine[a] - y * sine[a] - first_s) / spacing, samples)
                # z = z_mid (1 + along * tilt), as the rise of a ray is proportional to its mid-height.
                along = x * sine[a] + y * cosine[a]
                shrink = 1 / (1 + along * (v * tilt[i] + w * tilt[i + 1]))
                step = (z_mm[1] - z_mm[0]) * shrink / height_spacing if len(z_mm) > 1 else 0.0
                start = (z_mm[0] * shrink - heights[0]) / height_spacing
                for z in range(len(z_mm)):
                    position = start + z * step
                    j = min(max(int(position), 0), last)
                    q = np.float32(min(max(position - j, 0.0), 1.0))
                    p = np.float32(1) - q
                    total[iy, ix, z] += v * (p * filtered[a, i, j] + q * filtered[a, i, j + 1]) + w * (
                        p * filtered[a, i + 1, j] + q * filtered[a, i + 1, j + 1]
                    )
