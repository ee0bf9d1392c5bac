"""Ramp filters as products with Toeplitz matrices."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH, aligned_zeros
from vialight.core.errors import InputError
from vialight.tomography.radon.workers import Workers

FilterName = Literal["ram-lak", "shepp-logan", "cosine", "hann"]

_SAMPLES_A_PASS = 12
"""Samples that a filter weighs before a filtered one is written back."""

_PARTS = 4
"""Of an angle, filtered by one thread each where angles are few."""


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


def fold(sinogram: Float32Array) -> Float32Array:
    """Add to each ray the same one seen from the other side: ``q(psi, s) = p(psi, s) + p(psi + pi, -s)``.

    Parameters
    ----------
    sinogram
        (psi, s, z) float32: an even number of angles, evenly over a full turn, and s symmetric about 0.

    Returns
    -------
    numpy.ndarray
        (psi, s, z) float32, the first half of the angles.

    Examples
    --------
    >>> fold(np.arange(4, dtype=np.float32).reshape(2, 2, 1)).ravel()
    array([3., 3.], dtype=float32)
    """
    folded = np.empty((len(sinogram) // 2, *sinogram.shape[1:]), np.float32)
    _fold(sinogram, folded)
    return folded


def filter_rays(matrix: Float32Array, rays: Float32Array) -> Float32Array:
    """Filter the rays of every angle and height.

    The same as ``matrix @ rays`` by half the work, as a filter alike in both directions keeps apart what is even and
    what is odd along a row.  And without BLAS: the threads of OpenBLAS stay awake after each product and take a core
    from the kernels that follow, which made a reconstruction on two cores a third slower.

    Parameters
    ----------
    matrix
        (s, s) float32, see `ramp_filter`; the same if both its axes are turned round.
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
    samples = rays.shape[1]
    half = (samples + 1) // 2
    ahead, mirrored = matrix[:half, :half] / np.float32(2), matrix[:half, : -half - 1 : -1] / np.float32(2)
    filtered = aligned_zeros(rays.shape)
    _filter_rays(padded_filter(ahead + mirrored), padded_filter(ahead - mirrored), rays, filtered)
    return filtered


def padded_filter(matrix: Float32Array) -> Float32Array:
    """Return a filter as `filter_few` wants it: columns of zeros fill the last pass."""
    return np.pad(matrix, ((0, 0), (0, -len(matrix) % _SAMPLES_A_PASS)))


def filter_few(padded: Float32Array, rays: Float32Array, workers: Workers) -> Float32Array:
    """Filter a few angles, shared out evenly among threads.

    Parameters
    ----------
    padded
        See `padded_filter`.
    rays
        (psi, s, z) contiguous float32, as many samples as the filter has columns, those that fill it zero.
    workers
        Threads.

    Returns
    -------
    numpy.ndarray
        (psi, s, z) float32, as many samples as the filter has rows.
    """
    samples, depth = len(padded), rays.shape[2]
    filtered = aligned_zeros((len(rays), samples, depth))
    part = -(-samples // _PARTS)

    def work(worker: int, task: int) -> None:
        del worker
        angle, stretch = task // _PARTS, slice(task % _PARTS * part, (task % _PARTS + 1) * part)
        _filter_part(padded[stretch], rays[angle], filtered[angle, stretch])

    workers.run(len(rays) * _PARTS, work)
    return filtered


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _fold(sinogram: Float32Array, folded: Float32Array) -> None:
    angles, samples, depth = folded.shape
    for a in prange(angles):
        for i in range(samples):
            for z in range(depth):
                folded[a, i, z] = sinogram[a, i, z] + sinogram[a + angles, samples - 1 - i, z]


@njit(parallel=True, nogil=True, fastmath=FAST_MATH, cache=True)
def _filter_rays(even: Float32Array, odd: Float32Array, rays: Float32Array, filtered: Float32Array) -> None:
    angles, samples, depth = rays.shape
    half, last = len(even), samples - 1
    for a in prange(angles):
        row = rays[a]
        sums, differences = np.zeros((2, even.shape[1], depth), np.float32)
        for i in range(half):
            # The middle of an odd number of samples is its own mirror image, and counts once.
            share = np.float32(0.5) if i == last - i else np.float32(1)
            for z in range(depth):
                sums[i, z] = share * (row[i, z] + row[last - i, z])
                differences[i, z] = row[i, z] - row[last - i, z]
        upper, lower = np.zeros((2, half, depth), np.float32)
        _weigh(even, sums, upper)
        _weigh(odd, differences, lower)
        for i in range(half):
            for z in range(depth):
                filtered[a, i, z] = upper[i, z] + lower[i, z]
                filtered[a, last - i, z] = upper[i, z] - lower[i, z]


@njit(nogil=True, fastmath=FAST_MATH, cache=True)
def _filter_part(matrix: Float32Array, row: Float32Array, filtered: Float32Array) -> None:
    _weigh(matrix, row, filtered)


@njit(inline="always")
def _weigh(matrix: Float32Array, row: Float32Array, filtered: Float32Array) -> None:
    samples, depth = filtered.shape
    for j in range(0, matrix.shape[1], _SAMPLES_A_PASS):
        for i in range(samples):
            m0, m1, m2, m3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
            m4, m5, m6, m7 = matrix[i, j + 4], matrix[i, j + 5], matrix[i, j + 6], matrix[i, j + 7]
            m8, m9, m10, m11 = matrix[i, j + 8], matrix[i, j + 9], matrix[i, j + 10], matrix[i, j + 11]
            for z in range(depth):
                filtered[i, z] += (
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
