"""The kernel of `camera`: rays march through a density."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def march(
    density: Float32Array, emission: Float32Array, placed: FloatArray, bounds: FloatArray, rays: FloatArray,
    stood: FloatArray, step: float, extinction: float, frames: Float32Array,
) -> None:  # fmt: skip
    """Add to `frames` the integrals along every pixel's ray, in every pose.

    Parameters
    ----------
    density, emission
        (y, x, z): what dims, and what shines; the same array where nothing dims.
    placed
        Edge of a voxel, and y, x, z of the first voxel's centre.
    bounds
        First and last index along y, x, z that rays are followed through.
    rays
        (row, column, 6) as in `vialight.twin.camera.Imager`.
    stood
        (pose, 5) turn, shift and tilt.
    step
        Voxels between samples.
    extinction
        See `vialight.twin.camera.frames_of`.
    frames
        (pose, row, column).
    """
    voxel = placed[0]
    rows, columns, _ = rays.shape
    for job in prange(len(stood) * rows):
        f, row = job // rows, job % rows
        cosine, sine = np.cos(stood[f, 0]), np.sin(stood[f, 0])
        for column in range(columns):
            if np.isnan(rays[row, column, 0]):
                continue
            x, y, z, dx, dy, dz, enter, leave = _into_object(rays[row, column], stood[f], cosine, sine, placed, bounds)
            if leave <= enter:
                continue
            count = int(np.ceil((leave - enter) / step))
            length = (leave - enter) / count
            total, passed = 0.0, 0.0
            for n in range(count):
                t = enter + (n + 0.5) * length
                at_y, at_x, at_z = y + t * dy, x + t * dx, z + t * dz
                if extinction > 0:
                    thick = extinction * length * voxel * _sample(density, at_y, at_x, at_z)
                    total += _sample(emission, at_y, at_x, at_z) * np.exp(-passed - thick / 2)
                    passed += thick
                else:
                    total += _sample(emission, at_y, at_x, at_z)
            frames[f, row, column] += np.float32(total * length * voxel)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def march_bent(
    density: Float32Array, index: Float32Array, placed: FloatArray, bounds: FloatArray, rays: FloatArray,
    stood: FloatArray, step: float, frames: Float32Array,
) -> None:  # fmt: skip
    """Do as `march` where the index varies, without extinction: ``d(n t)/ds = grad n`` in midpoint steps.

    Parameters
    ----------
    index
        (y, x, z) by which share the resin's index is higher than when liquid.
    density, placed, bounds, rays, stood, step, frames
        As for `march`.
    """
    rows, columns, _ = rays.shape
    for job in prange(len(stood) * rows):
        f, row = job // rows, job % rows
        cosine, sine = np.cos(stood[f, 0]), np.sin(stood[f, 0])
        for column in range(columns):
            if np.isnan(rays[row, column, 0]):
                continue
            x, y, z, dx, dy, dz, enter, leave = _into_object(rays[row, column], stood[f], cosine, sine, placed, bounds)
            if leave <= enter:
                continue
            x, y, z = x + enter * dx, y + enter * dy, z + enter * dz
            total = 0.0
            for _ in range(int(2 * (leave - enter) / step) + 2):
                x, y, z = x + 0.5 * step * dx, y + 0.5 * step * dy, z + 0.5 * step * dz
                if not (bounds[0] <= y <= bounds[1] and bounds[2] <= x <= bounds[3] and bounds[4] <= z <= bounds[5]):
                    break
                total += _sample(density, y, x, z)
                slope_y = _sample(index, y + 0.5, x, z) - _sample(index, y - 0.5, x, z)
                slope_x = _sample(index, y, x + 0.5, z) - _sample(index, y, x - 0.5, z)
                slope_z = _sample(index, y, x, z + 0.5) - _sample(index, y, x, z - 0.5)
                along = slope_x * dx + slope_y * dy + slope_z * dz
                turn = step / (1.0 + _sample(index, y, x, z))
                dx, dy, dz = (
                    dx + turn * (slope_x - along * dx),
                    dy + turn * (slope_y - along * dy),
                    dz + turn * (slope_z - along * dz),
                )
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                dx, dy, dz = dx / length, dy / length, dz / length
                x, y, z = x + 0.5 * step * dx, y + 0.5 * step * dy, z + 0.5 * step * dz
            frames[f, row, column] += np.float32(total * step * placed[0])


@njit(fastmath=FAST_MATH, cache=True)
def _into_object(
    ray: FloatArray, stood: FloatArray, cosine: float, sine: float, placed: FloatArray, bounds: FloatArray
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return a ray's origin and direction in voxels of the object, and where it enters and leaves the bounds."""
    voxel, first_y, first_x, first_z = placed
    _, shift_x, shift_y, tilt_x, tilt_y = stood
    # Into the object: back by shift, tilt and turn; then in voxels.
    x, y, z = ray[0] - shift_x, ray[1] - shift_y, ray[2]
    dx, dy, dz = ray[3], ray[4], ray[5]
    x, y, z = x - tilt_x * z, y - tilt_y * z, z + tilt_x * x + tilt_y * y
    dx, dy, dz = dx - tilt_x * dz, dy - tilt_y * dz, dz + tilt_x * dx + tilt_y * dy
    x, y = cosine * x + sine * y, cosine * y - sine * x
    dx, dy = cosine * dx + sine * dy, cosine * dy - sine * dx
    x, y, z = (x - first_x) / voxel, (y - first_y) / voxel, (z - first_z) / voxel
    enter, leave = _clip(y, dy, bounds[0], bounds[1], 0.0, 1e9)
    enter, leave = _clip(x, dx, bounds[2], bounds[3], enter, leave)
    enter, leave = _clip(z, dz, bounds[4], bounds[5], enter, leave)
    return x, y, z, dx, dy, dz, enter, leave


@njit(fastmath=FAST_MATH, cache=True)
def _clip(start: float, slope: float, low: float, high: float, enter: float, leave: float) -> tuple[float, float]:
    """Shorten a stretch of a ray to where one coordinate lies within bounds."""
    if abs(slope) < 1e-12:
        return (enter, leave) if low <= start <= high else (1.0, 0.0)
    a, b = (low - start) / slope, (high - start) / slope
    return max(enter, min(a, b)), min(leave, max(a, b))


@njit(fastmath=FAST_MATH, inline="always")
def _sample(volume: Float32Array, y: float, x: float, z: float) -> float:
    """Interpolate linearly between voxel centres; beyond them density falls to 0 within a voxel."""
    j, i, k = int(np.floor(y)), int(np.floor(x)), int(np.floor(z))
    v, u, w = np.float32(y - j), np.float32(x - i), np.float32(z - k)
    total = np.float32(0)
    rows, columns, depth = volume.shape
    if 0 <= j < rows - 1 and 0 <= i < columns - 1 and 0 <= k < depth - 1:
        a = volume[j, i, k] + w * (volume[j, i, k + 1] - volume[j, i, k])
        b = volume[j, i + 1, k] + w * (volume[j, i + 1, k + 1] - volume[j, i + 1, k])
        c = volume[j + 1, i, k] + w * (volume[j + 1, i, k + 1] - volume[j + 1, i, k])
        d = volume[j + 1, i + 1, k] + w * (volume[j + 1, i + 1, k + 1] - volume[j + 1, i + 1, k])
        a, c = a + u * (b - a), c + u * (d - c)
        return float(a + v * (c - a))
    for dj in range(2):
        for di in range(2):
            for dk in range(2):
                if 0 <= j + dj < rows and 0 <= i + di < columns and 0 <= k + dk < depth:
                    weight = (v if dj else 1 - v) * (u if di else 1 - u) * (w if dk else 1 - w)
                    total += weight * volume[j + dj, i + di, k + dk]
    return float(total)
