"""Backprojection along rays that climb."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.tomography.radon.taps import tap


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
                i, v, w = tap((x * cosine[a] - y * sine[a] - first_s) / spacing, samples)
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
