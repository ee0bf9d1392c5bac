"""A matched pair of projector and backprojector for printing: light in strips, dose in square voxels.

A sample of a projection is a strip of light, `spacing` wide and of even irradiance; a voxel's dose is the mean over its
square.  The weight between them is the share of the square that the strip covers: the integral, over the strip, of the
square's shadow, which is a trapezoid.  Backprojection is therefore exact for strips, projection is its exact transpose,
and neither aliases, as both integrate over areas instead of reading at points.

With absorption, light loses ``exp(-mu t)`` along the ray (the exponential Radon transform); ``t`` is counted from the
point closest to the axis, away from the projector, so that weights are 1 on the axis.

Arrays keep z innermost: (psi, s, z) and (y, x, z).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray

_TILE = 32
_BLOCK = 64
"""Pixels along the edge of a tile, and slices in a block: what is summed together stays in cache."""


@dataclass(frozen=True)
class StripGeometry:
    """Where strips and voxels lie.

    Parameters
    ----------
    psi_rad
        (psi,) angles of the projections.
    first_s_mm, spacing_mm, samples
        Centre of the first strip, width of a strip, number of strips.
    x_mm, y_mm
        Voxel centres, evenly spaced, with the same pitch along both.
    absorption_per_mm
        Napierian absorption coefficient mu; 0 for none.
    tilt_per_mm
        (s,) climb of the rays, per mm of plan view and per mm of mid-height: light spreads by ``1 + t tilt`` along its
        way.  None for light that is parallel in z.
    z_mm
        (z,) evenly spaced heights of the slices, which are the strips' mid-heights too, to let the rays climb from
        slice to slice; None to keep them in their slice.
    from_both_sides
        Whether the same light comes from psi + pi too, so that half a turn of projections stands for a full one; the
        weight is then the mean of both ways.
    """

    psi_rad: FloatArray
    first_s_mm: float
    spacing_mm: float
    samples: int
    x_mm: FloatArray
    y_mm: FloatArray
    absorption_per_mm: float = 0.0
    tilt_per_mm: FloatArray | None = None
    z_mm: FloatArray | None = None
    from_both_sides: bool = False

    @property
    def voxel_mm(self) -> float:
        """Edge of a voxel."""
        return float(self.x_mm[1] - self.x_mm[0])


def backproject_strips(projections: Float32Array, geometry: StripGeometry) -> Float32Array:
    """Sum the light that reaches each voxel over all angles.

    Parameters
    ----------
    projections
        (psi, s, z) float32, irradiance of the strips where they pass closest to the axis.
    geometry
        Of strips and voxels; what lies outside the strips counts as dark.

    Returns
    -------
    numpy.ndarray
        (y, x, z) float32.
    """
    _check(projections.shape[:2], (len(geometry.psi_rad), geometry.samples))
    dose = np.zeros((len(geometry.y_mm), len(geometry.x_mm), projections.shape[2]), np.float32)
    if geometry.z_mm is None:
        _backproject(np.ascontiguousarray(projections), *_plain(geometry), dose)
    else:
        _backproject_tilted(np.ascontiguousarray(projections), *_plain(geometry), _first_height(geometry), dose)
    return dose


def project_strips(volume: Float32Array, geometry: StripGeometry) -> Float32Array:
    """Sum each strip's voxels: the transpose of `backproject_strips`.

    Parameters
    ----------
    volume
        (y, x, z) float32.
    geometry
        Of strips and voxels.

    Returns
    -------
    numpy.ndarray
        (psi, s, z) float32: for voxels as wide as strips, the integral along the ray in voxels.
    """
    _check(volume.shape[:2], (len(geometry.y_mm), len(geometry.x_mm)))
    projections = np.zeros((len(geometry.psi_rad), geometry.samples, volume.shape[2]), np.float32)
    if geometry.z_mm is None:
        _project(np.ascontiguousarray(volume), *_plain(geometry), projections)
    else:
        _project_tilted(np.ascontiguousarray(volume), *_plain(geometry), _first_height(geometry), projections)
    return projections


def _check(shape: tuple[int, ...], wanted: tuple[int, int]) -> None:
    # Kernels check no bounds: an array of another shape would be read past its end.
    if shape != wanted:
        raise ValueError(f"array begins with {shape}, the geometry with {wanted}")


def _plain(
    geometry: StripGeometry,
) -> tuple[FloatArray, FloatArray, float, float, FloatArray, FloatArray, float, FloatArray, bool]:
    """Return what the kernels take, in strip widths."""
    width = geometry.spacing_mm
    tilt = np.zeros(geometry.samples) if geometry.tilt_per_mm is None else geometry.tilt_per_mm * width
    return (
        np.cos(geometry.psi_rad), np.sin(geometry.psi_rad), geometry.first_s_mm / width, geometry.voxel_mm / width,
        geometry.x_mm / width, geometry.y_mm / width, geometry.absorption_per_mm * width, tilt,
        geometry.from_both_sides,
    )  # fmt: skip


def _first_height(geometry: StripGeometry) -> float:
    """Return the height of the first slice, in slices."""
    assert geometry.z_mm is not None  # for mypy: the callers have asked
    slice_mm = geometry.z_mm[1] - geometry.z_mm[0] if len(geometry.z_mm) > 1 else geometry.voxel_mm
    return float(geometry.z_mm[0] / slice_mm)


@njit(inline="always")
def _shadow_before(u: float, half_top: float, half_base: float) -> float:
    """Share of a unit-area trapezoid that lies below u; the trapezoid is the shadow of a square."""
    if u <= -half_base:
        return 0.0
    if u >= half_base:
        return 1.0
    height = 1.0 / (half_top + half_base)
    if u < -half_top:
        return 0.5 * height * (u + half_base) ** 2 / (half_base - half_top)
    if u <= half_top:
        return 0.5 * height * (half_base - half_top) + height * (u + half_top)
    return 1.0 - 0.5 * height * (half_base - u) ** 2 / (half_base - half_top)


@njit(inline="always")
def _shadow(
    x: float, y: float, cosine: float, sine: float, first: float, voxel: float
) -> tuple[float, float, float, int, int]:
    """Return the shadow's middle, half its top, half its base, and the first and the last strip that it falls on."""
    wide, narrow = abs(cosine) + abs(sine), abs(abs(cosine) - abs(sine))
    half_top, half_base = 0.5 * voxel * narrow, max(0.5 * voxel * wide, 0.5 * voxel * narrow + 1e-9)
    middle = x * cosine - y * sine - first
    return (
        middle, half_top, half_base, int(np.floor(middle - half_base + 0.5)), int(np.floor(middle + half_base + 0.5)),
    )  # fmt: skip


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
def _backproject(
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
                    middle, half_top, half_base, start, end = _shadow(x, y, cosine[a], sine[a], first, voxel)
                    along = x * sine[a] + y * cosine[a]
                    before = 0.0
                    for i in range(start, end + 1):
                        until = _shadow_before(i + 0.5 - middle, half_top, half_base)
                        if 0 <= i < samples:
                            weight = np.float32((until - before) * _loss(along, absorption, tilt[i], both))
                            lit, light = dose[iy, ix, low:high], projections[a, i, low:high]
                            for z in range(len(light)):
                                lit[z] += weight * light[z]
                        before = until


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _project(
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
    angles, samples, depth = projections.shape
    blocks = (depth + _BLOCK - 1) // _BLOCK
    for job in prange(angles * blocks):
        a, low = job // blocks, job % blocks * _BLOCK
        high = min(low + _BLOCK, depth)
        for iy in range(len(ys)):
            for ix in range(len(xs)):
                x, y = xs[ix], ys[iy]
                middle, half_top, half_base, start, end = _shadow(x, y, cosine[a], sine[a], first, voxel)
                along = x * sine[a] + y * cosine[a]
                before = 0.0
                for i in range(start, end + 1):
                    until = _shadow_before(i + 0.5 - middle, half_top, half_base)
                    if 0 <= i < samples:
                        weight = np.float32((until - before) * _loss(along, absorption, tilt[i], both))
                        seen, column = projections[a, i, low:high], volume[iy, ix, low:high]
                        for z in range(len(column)):
                            seen[z] += weight * column[z]
                    before = until


@njit(fastmath=FAST_MATH, cache=True)
def _stretch(z: int, drift: float, first_height: float, depth: int) -> tuple[int, int]:
    """Return by how many slices the mid-height of the ray through slice z lies off it, and where that number changes.

    Rays climb little, so that long stretches of slices share a whole number of slices: loops over them vectorise.
    """
    offset = int(np.floor(drift * (z + first_height)))
    if drift > 0:
        end = np.ceil((offset + 1) / drift - first_height)
    elif drift < 0:
        end = np.floor(offset / drift - first_height) + 1
    else:
        end = float(depth)
    return offset, int(min(max(end, z + 1.0), float(depth)))


@njit(fastmath=FAST_MATH, cache=True)
def _gather_climbing(
    lit: Float32Array, light: Float32Array, weight: np.float32, drift: float, first_height: float
) -> None:
    """Add to each slice the light of the mid-height of its ray, linear between slices, the end ones going on."""
    depth = len(lit)
    start = 0
    while start < depth:
        offset, end = _stretch(start, drift, first_height, depth)
        inner_start, inner_end = min(max(start, -offset), end), max(min(end, depth - 1 - offset), start)
        for z in range(start, inner_start):
            lit[z] += weight * light[0]
        for z in range(max(inner_end, inner_start), end):
            lit[z] += weight * light[depth - 1]
        count = inner_end - inner_start
        if count > 0:
            here, below = lit[inner_start:inner_end], light[inner_start + offset : inner_end + offset]
            above = light[inner_start + offset + 1 : inner_end + offset + 1]
            share = np.float32(drift * (inner_start + first_height) - offset)
            step = np.float32(drift)
            for k in range(count):
                high = share + step * np.float32(k)
                here[k] += weight * (below[k] + high * (above[k] - below[k]))
        start = end


@njit(fastmath=FAST_MATH, cache=True)
def _scatter_climbing(
    seen: Float32Array, column: Float32Array, weight: np.float32, drift: float, first_height: float
) -> None:
    """Transpose of `_gather_climbing`."""
    depth = len(column)
    start = 0
    while start < depth:
        offset, end = _stretch(start, drift, first_height, depth)
        inner_start, inner_end = min(max(start, -offset), end), max(min(end, depth - 1 - offset), start)
        for z in range(start, inner_start):
            seen[0] += weight * column[z]
        for z in range(max(inner_end, inner_start), end):
            seen[depth - 1] += weight * column[z]
        count = inner_end - inner_start
        if count > 0:
            here, below = column[inner_start:inner_end], seen[inner_start + offset : inner_end + offset]
            above = seen[inner_start + offset + 1 : inner_end + offset + 1]
            share = np.float32(drift * (inner_start + first_height) - offset)
            step = np.float32(drift)
            for k in range(count):
                below[k] += weight * (np.float32(1) - share - step * np.float32(k)) * here[k]
            for k in range(count):
                above[k] += weight * (share + step * np.float32(k)) * here[k]
        start = end


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _backproject_tilted(
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
    first_height: float,
    dose: Float32Array,
) -> None:
    angles, samples, depth = projections.shape
    ways = 2 if both else 1
    for iy in prange(len(ys)):
        light = np.empty(depth, np.float32)
        for a in range(angles):
            for ix in range(len(xs)):
                x, y = xs[ix], ys[iy]
                middle, half_top, half_base, start, end = _shadow(x, y, cosine[a], sine[a], first, voxel)
                light[:] = 0
                before = 0.0
                for i in range(start, end + 1):
                    until = _shadow_before(i + 0.5 - middle, half_top, half_base)
                    if 0 <= i < samples:
                        share, strip = np.float32(until - before), projections[a, i]
                        for z in range(depth):
                            light[z] += share * strip[z]
                    before = until
                # Neighbouring strips climb alike: the middle one's tilt does for all.
                along, slope = x * sine[a] + y * cosine[a], tilt[min(max(int(middle + 0.5), 0), samples - 1)]
                for way in range(ways):
                    side = 1 - 2 * way
                    shrink = 1 / (1 + side * along * slope)
                    weight = np.float32(np.exp(-absorption * side * along) * shrink / ways)
                    _gather_climbing(dose[iy, ix], light, weight, shrink - 1, first_height)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _project_tilted(
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
    first_height: float,
    projections: Float32Array,
) -> None:
    angles, samples, depth = projections.shape
    ways = 2 if both else 1
    for a in prange(angles):
        seen = np.empty(depth, np.float32)
        for iy in range(len(ys)):
            for ix in range(len(xs)):
                x, y = xs[ix], ys[iy]
                middle, half_top, half_base, start, end = _shadow(x, y, cosine[a], sine[a], first, voxel)
                along, slope = x * sine[a] + y * cosine[a], tilt[min(max(int(middle + 0.5), 0), samples - 1)]
                seen[:] = 0
                for way in range(ways):
                    side = 1 - 2 * way
                    shrink = 1 / (1 + side * along * slope)
                    weight = np.float32(np.exp(-absorption * side * along) * shrink / ways)
                    _scatter_climbing(seen, volume[iy, ix], weight, shrink - 1, first_height)
                before = 0.0
                for i in range(start, end + 1):
                    until = _shadow_before(i + 0.5 - middle, half_top, half_base)
                    if 0 <= i < samples:
                        share, strip = np.float32(until - before), projections[a, i]
                        for z in range(depth):
                            strip[z] += share * seen[z]
                    before = until
