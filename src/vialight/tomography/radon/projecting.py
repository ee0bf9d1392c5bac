"""Projection along rays that climb."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH


def project_tilted(
    columns: Float32Array,
    psi_rad: FloatArray,
    s_mm: FloatArray,
    tilt_per_mm: FloatArray,
    z_mm: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
) -> Float32Array:
    """Integrate a volume along the plan view of rays that are parallel seen from above and form a fan in z.

    A ray is followed from row to row of pixels, or from column to column where it crosses those more steeply, linearly
    interpolated between the two next to it (Joseph 1982) and between their slices.

    Parameters
    ----------
    columns
        (y, x, z) float32; beyond its end slices a volume goes on as it ends, beside it there is nothing.
    psi_rad, s_mm
        (psi,) angles and (s,) positions of the rays.
    tilt_per_mm
        (s,), see `backproject_tilted`.
    z_mm
        (z,) evenly spaced heights of the slices, and mid-heights of the rays.
    x_mm, y_mm
        Pixel centres, of one spacing.

    Returns
    -------
    numpy.ndarray
        (psi, s, z_mid) float32.

    Examples
    --------
    >>> axis, level = np.arange(-2.0, 3.0), np.zeros(1)
    >>> project_tilted(np.ones((5, 5, 1), np.float32), np.zeros(1), np.zeros(1), level, level, axis, axis)
    array([[[5.]]], dtype=float32)
    """
    first_height = z_mm[0] / (z_mm[1] - z_mm[0]) if len(z_mm) > 1 else 0.0
    out = np.zeros((len(psi_rad), len(s_mm), len(z_mm)), np.float32)
    _project_tilted(columns, np.cos(psi_rad), np.sin(psi_rad), s_mm, tilt_per_mm, first_height, x_mm, y_mm, out)
    return out


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _project_tilted(
    columns: Float32Array,
    cosine: FloatArray,
    sine: FloatArray,
    s_mm: FloatArray,
    tilt: FloatArray,
    first_height: float,
    x_mm: FloatArray,
    y_mm: FloatArray,
    out: Float32Array,
) -> None:
    """Heights in slices."""
    voxel = x_mm[1] - x_mm[0]
    for a in prange(len(cosine)):
        c, s = cosine[a], sine[a]
        along_y = abs(c) >= abs(s)
        steps, across = (len(y_mm), len(x_mm)) if along_y else (len(x_mm), len(y_mm))
        length = np.float32(voxel / max(abs(c), abs(s)))
        crossed = np.empty(columns.shape[2], np.float32)
        for i in range(len(s_mm)):
            for k in range(steps):
                if along_y:
                    y = y_mm[k]
                    x = (s_mm[i] + y * s) / c
                    position = (x - x_mm[0]) / voxel
                else:
                    x = x_mm[k]
                    y = (x * c - s_mm[i]) / s
                    position = (y - y_mm[0]) / voxel
                if not 0 <= position <= across - 1:
                    continue
                j = min(int(position), across - 2)
                w = length * np.float32(position - j)
                v = length - w
                left, right = (columns[k, j], columns[k, j + 1]) if along_y else (columns[j, k], columns[j + 1, k])
                for z in range(len(crossed)):
                    crossed[z] = v * left[z] + w * right[z]
                climb = (x * s + y * c) * tilt[i]
                _add_climbing(out[a, i], crossed, first_height * climb, climb)


@njit(fastmath=FAST_MATH, cache=True)
def _add_climbing(sums: Float32Array, crossed: Float32Array, start: float, climb: float) -> None:
    """Add to sum h what is at position start + h (1 + climb) of a column, linear between slices.

    Rays climb little, so that long stretches of heights are a whole number of slices and a fraction away.
    """
    count, last = len(sums), len(crossed) - 1
    h = 0
    while h < count:
        shift = int(np.floor(start + h * climb))
        end = float(count)
        if climb > 0:
            end = np.ceil((shift + 1 - start) / climb)
        elif climb < 0:
            end = np.floor((shift - start) / climb) + 1
        stretch_end = int(min(max(end, h + 1.0), float(count)))
        inner = min(max(h, -shift), stretch_end)
        inner_end = max(min(stretch_end, last - shift), inner)
        sums[h:inner] += crossed[0]
        sums[inner_end:stretch_end] += crossed[last]
        here, below = sums[inner:inner_end], crossed[inner + shift : inner_end + shift]
        above = crossed[inner + shift + 1 : inner_end + shift + 1]
        share, step = np.float32(start + inner * climb - shift), np.float32(climb)
        for n in range(inner_end - inner):
            here[n] += below[n] + (share + step * np.float32(n)) * (above[n] - below[n])
        h = stretch_end
