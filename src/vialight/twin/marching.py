"""The kernel of `camera`: rays march through a density."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH

MARGIN = 2
"""Empty voxels all round what rays march through: samples and slopes are taken there without asking where they are."""


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def march(
    density: Float32Array, emission: Float32Array, rise: Float32Array, placed: FloatArray, rays: FloatArray,
    stood: FloatArray, step: float, extinction: float, frames: Float32Array,
) -> None:  # fmt: skip
    """Add to `frames` the integrals along every pixel's ray, in every pose.

    Parameters
    ----------
    density, emission
        (y, x, z) with `MARGIN`: what dims, and what shines; the same array where nothing dims.
    rise
        (y, x, z) with `MARGIN`, by which share the index is higher than that of liquid resin; empty where rays are
        straight.  Nothing dims where they are not.
    placed
        Edge of a voxel, and y, x, z of the first voxel's centre.
    rays
        (row, column, 6) as in `vialight.twin.camera.Imager`.
    stood
        (pose, 5) turn, shift and tilt.
    step
        Voxels between samples.
    extinction
        Per voxel, of a density of 1; see `vialight.twin.camera.frames_of`.
    frames
        (pose, row, column).
    """
    rows, columns, _ = rays.shape
    shape = emission.shape
    dim, bright, risen = density.ravel(), emission.ravel(), rise.ravel()
    for job in prange(len(stood) * rows):
        f, row = job // rows, job % rows
        cosine, sine = np.cos(stood[f, 0]), np.sin(stood[f, 0])
        for column in range(columns):
            if np.isnan(rays[row, column, 0]):
                continue
            point, along, enter, leave = _into_object(rays[row, column], stood[f], cosine, sine, placed, shape)
            if leave <= enter:
                continue
            if risen.size > 0:
                total = _bent(bright, risen, shape, point, along, enter, leave, step)
            elif extinction > 0:
                total = _dimmed(dim, bright, shape, point, along, enter, leave, step, extinction)
            else:
                total = _straight(bright, shape, point, along, enter, leave, step)
            frames[f, row, column] += np.float32(total * placed[0])


_Triple = tuple[float, float, float]
_Shape = tuple[int, int, int]


@njit(fastmath=FAST_MATH, inline="always")
def _straight(
    bright: Float32Array, shape: _Shape, point: _Triple, along: _Triple, enter: float, leave: float, step: float
) -> float:
    """Integrate along a straight ray, in voxels, by the midpoint rule."""
    count = int(np.ceil((leave - enter) / step))
    length = (leave - enter) / count
    first = enter + 0.5 * length
    # Single precision places a sample to 1e-5 of a voxel, and halves the time.
    y, x = np.float32(point[0] + first * along[0]), np.float32(point[1] + first * along[1])
    z = np.float32(point[2] + first * along[2])
    dy, dx, dz = np.float32(length * along[0]), np.float32(length * along[1]), np.float32(length * along[2])
    total = np.float32(0)
    for n in range(count):
        t = np.float32(n)
        total += _sample(bright, shape, y + t * dy, x + t * dx, z + t * dz)
    return float(total * length)


@njit(fastmath=FAST_MATH, inline="always")
def _dimmed(
    dim: Float32Array, bright: Float32Array, shape: _Shape, point: _Triple, along: _Triple, enter: float, leave: float,
    step: float, extinction: float,
) -> float:  # fmt: skip
    """Integrate along a straight ray what is left of its light when it comes to the camera."""
    count = int(np.ceil((leave - enter) / step))
    length = (leave - enter) / count
    total, passed = 0.0, 0.0
    for n in range(count):
        t = enter + (n + 0.5) * length
        y, x, z = point[0] + t * along[0], point[1] + t * along[1], point[2] + t * along[2]
        thick = extinction * length * _sample(dim, shape, y, x, z)
        total += _sample(bright, shape, y, x, z) * np.exp(-passed - thick / 2)
        passed += thick
    return total * length


@njit(fastmath=FAST_MATH, inline="always")
def _bent(
    bright: Float32Array, risen: Float32Array, shape: _Shape, point: _Triple, along: _Triple, enter: float,
    leave: float, step: float,
) -> float:  # fmt: skip
    """Integrate along a ray of ``d(n t)/ds = grad n`` in midpoint steps, until it leaves the volume."""
    low, high_y, high_x, high_z = MARGIN - 1, shape[0] - MARGIN, shape[1] - MARGIN, shape[2] - MARGIN
    dy, dx, dz = along
    y, x, z = point[0] + enter * dy, point[1] + enter * dx, point[2] + enter * dz
    total = 0.0
    for _ in range(int(2 * (leave - enter) / step) + 2):
        y, x, z = y + 0.5 * step * dy, x + 0.5 * step * dx, z + 0.5 * step * dz
        if not (low <= y <= high_y and low <= x <= high_x and low <= z <= high_z):
            break
        total += _sample(bright, shape, y, x, z)
        slope_y = _sample(risen, shape, y + 0.5, x, z) - _sample(risen, shape, y - 0.5, x, z)
        slope_x = _sample(risen, shape, y, x + 0.5, z) - _sample(risen, shape, y, x - 0.5, z)
        slope_z = _sample(risen, shape, y, x, z + 0.5) - _sample(risen, shape, y, x, z - 0.5)
        forward = slope_x * dx + slope_y * dy + slope_z * dz
        turn = step / (1.0 + _sample(risen, shape, y, x, z))
        dy, dx, dz = (
            dy + turn * (slope_y - forward * dy),
            dx + turn * (slope_x - forward * dx),
            dz + turn * (slope_z - forward * dz),
        )
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        dy, dx, dz = dy / length, dx / length, dz / length
        y, x, z = y + 0.5 * step * dy, x + 0.5 * step * dx, z + 0.5 * step * dz
    return total * step


@njit(fastmath=FAST_MATH, cache=True)
def _into_object(
    ray: FloatArray, stood: FloatArray, cosine: float, sine: float, placed: FloatArray, shape: _Shape
) -> tuple[_Triple, _Triple, float, float]:
    """Return a ray's origin and direction (y, x, z) in voxels, and where it enters and leaves what is not empty."""
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
    enter, leave = _clip(y, dy, shape[0], 0.0, 1e9)
    enter, leave = _clip(x, dx, shape[1], enter, leave)
    enter, leave = _clip(z, dz, shape[2], enter, leave)
    return (y, x, z), (dy, dx, dz), enter, leave


@njit(fastmath=FAST_MATH, cache=True)
def _clip(start: float, slope: float, count: int, enter: float, leave: float) -> tuple[float, float]:
    """Shorten a stretch of a ray to where one coordinate lies between the empty voxels next to the others."""
    low, high = float(MARGIN - 1), float(count - MARGIN)
    if abs(slope) < 1e-12:
        return (enter, leave) if low <= start <= high else (1.0, 0.0)
    a, b = (low - start) / slope, (high - start) / slope
    return max(enter, min(a, b)), min(leave, max(a, b))


@njit(fastmath=FAST_MATH, inline="always")
def _sample(flat: Float32Array, shape: _Shape, y: Any, x: Any, z: Any) -> Any:
    """Interpolate linearly between voxel centres, in either precision, at least a voxel from the volume's ends."""
    j, i, k = np.int32(y), np.int32(x), np.int32(z)
    v, u, w = np.float32(y - j), np.float32(x - i), np.float32(z - k)
    one, next_x, next_y = np.uint32(1), np.uint32(shape[2]), np.uint32(shape[1] * shape[2])
    here = np.uint32(j) * next_y + np.uint32(i) * next_x + np.uint32(k)
    a = flat[here] + w * (flat[here + one] - flat[here])
    beside = here + next_x
    b = flat[beside] + w * (flat[beside + one] - flat[beside])
    here += next_y
    c = flat[here] + w * (flat[here + one] - flat[here])
    beside += next_y
    d = flat[beside] + w * (flat[beside + one] - flat[beside])
    a, c = a + u * (b - a), c + u * (d - c)
    return a + v * (c - a)
