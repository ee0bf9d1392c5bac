"""A matched pair of projector and backprojector for printing: light in strips, dose in square voxels.

A sample of a projection is a strip of light, `spacing` wide and of even irradiance; a voxel's dose is the mean over its
square.  The weight between them is the share of the square that the strip covers: the integral, over the strip, of the
square's shadow, which is a trapezoid.  Backprojection is therefore exact for strips, projection is its exact transpose,
and neither aliases, as both integrate over areas instead of reading at points.

With absorption, light loses ``exp(-mu t)`` along the ray (the exponential Radon transform); ``t`` is counted from the
point closest to the axis, away from the projector, so that weights are 1 on the axis.

Arrays keep z innermost: (psi, s, z) and (y, x, z).  `shadows` has the weights, `level` and `climbing` the loops over
them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from vialight.core.compiling import aligned_zeros
from vialight.planning.strips import climbing, level
from vialight.planning.strips.layouts import SPARE, filled_boxes, lit_strips, voxel_rows, whole_vectors
from vialight.planning.strips.shadows import absorbed, parts_of

_TILE, _WIDE_TILE, _DEPTH_OF_WIDE_TILES = 16, 32, 96
"""Edges of tiles in voxels; up to how many slices a wide one stays in a cache of 512 kB."""

_CLIMB_A_KNOT, _ABSORPTION_A_KNOT = 0.35, 0.15
"""Slices that light may climb, and share of it that may be absorbed, from one knot to the next, between which it is
interpolated: the second leaves light that comes one way within 0.15^2 / 10 of what it is."""


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
    within_mm
        Distance from the axis up to which the dose of voxels is wanted; it is 0 for others, and they throw no shadow.
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
    within_mm: float = np.inf

    def __post_init__(self) -> None:
        parts_of(self.voxel_mm / self.spacing_mm)  # kernels would not count strips beyond these

    @property
    def voxel_mm(self) -> float:
        """Edge of a voxel."""
        return float(self.x_mm[1] - self.x_mm[0])


def backproject_strips(projections: Float32Array, geometry: StripGeometry) -> Float32Array:
    """Sum the light that reaches each voxel over all angles.

    A full turn, where each strip is lit from both ends, is summed as half a turn of light that differs by its way.

    Parameters
    ----------
    projections
        (psi, s, z) float32, irradiance of the strips where they pass closest to the axis.
    geometry
        Of strips and voxels, which may be up to 3.5 strips wide; what lies outside the strips counts as dark.

    Returns
    -------
    numpy.ndarray
        (y, x, z) float32.
    """
    _check(projections.shape[:2], (len(geometry.psi_rad), geometry.samples))
    climbs = geometry.z_mm is not None
    if _is_lit_from_both_ends(geometry) and (climbs or not _plain(geometry).loses):
        half = len(geometry.psi_rad) // 2
        there, back = projections[:half], projections[half:, ::-1]
        geometry = replace(geometry, psi_rad=geometry.psi_rad[:half], from_both_sides=True)
        if not climbs:
            return _level_dose(there + back, geometry)
        dose = _climbing_dose(np.ascontiguousarray(there), np.ascontiguousarray(back), geometry)
        dose *= np.float32(2)  # the mean of both ways is what light from both sides brings
        return dose
    if climbs:
        light = np.ascontiguousarray(projections)
        return _climbing_dose(light, light, geometry)
    return _level_dose(projections, geometry)


def _is_lit_from_both_ends(geometry: StripGeometry) -> bool:
    """Whether each projection comes again half a turn later, in the same strips."""
    half, odd = divmod(len(geometry.psi_rad), 2)
    tilt = geometry.tilt_per_mm
    return (
        not (odd or geometry.from_both_sides)
        and bool(np.allclose(geometry.psi_rad[half:] - geometry.psi_rad[:half], np.pi, atol=1e-9))
        and abs(geometry.first_s_mm + (geometry.samples - 1) / 2 * geometry.spacing_mm) < 1e-9
        and (tilt is None or bool(np.allclose(tilt, tilt[::-1], rtol=1e-6)))
    )


def _climbing_dose(there: Float32Array, back: Float32Array, geometry: StripGeometry) -> Float32Array:
    slices, plain = there.shape[2], _plain(geometry)
    dose = np.empty((len(geometry.y_mm), len(geometry.x_mm), slices), np.float32)
    depth, parts = whole_vectors(slices), parts_of(plain.voxel)
    tile = _tile(depth, parts)
    first, last = lit_strips(there).T
    if back is not there:
        first_back, last_back = lit_strips(back).T
        first, last = np.minimum(first, first_back), np.maximum(last, last_back)
    climbing.backproject(
        tile, parts, _knots(geometry, tile, alike=back is there), there, back, np.stack([first, last], axis=1),
        *plain.rays, *plain.reached, *plain.losses, plain.absorption, geometry.from_both_sides,
        _first_slice(geometry), depth, dose,
    )  # fmt: skip
    return dose


def _level_dose(projections: Float32Array, geometry: StripGeometry) -> Float32Array:
    (angles, strips, slices), plain = projections.shape, _plain(geometry)
    dose = np.empty((len(geometry.y_mm), len(geometry.x_mm), slices), np.float32)
    depth, parts = whole_vectors(slices), parts_of(plain.voxel)
    more = -angles % level.ENTRIES_A_PASS
    rows = aligned_zeros((angles + more, strips + 2 * level.DARK, depth))
    rows[:angles, level.DARK : -level.DARK, :slices] = projections
    lit, plain = np.pad(lit_strips(projections), ((0, more), (0, 0))), plain.lengthened(more)
    level.backproject(
        _tile(depth, parts), parts, rows.reshape(-1, depth), strips, lit, *plain.rays, *plain.reached, *plain.losses,
        plain.loses, geometry.from_both_sides, dose,
    )  # fmt: skip
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
    slices, plain = volume.shape[2], _plain(geometry)
    if parts_of(plain.voxel) > 1:
        raise ValueError(f"voxels {plain.voxel} strips wide are only backprojected to")
    laid = voxel_rows(volume, plain.reached[0])
    depth = laid.by_y.shape[1]
    if geometry.z_mm is not None:
        projections = np.zeros((len(geometry.psi_rad), geometry.samples, slices), np.float32)
        tile = _tile(depth, 1)
        climbing.project(
            tile, _knots(geometry, tile, alike=True), laid.by_y[SPARE:], laid.pitch_y, laid.filled, *plain.rays,
            *plain.losses, plain.absorption, geometry.from_both_sides, _first_slice(geometry), projections,
        )  # fmt: skip
        return projections
    seen = aligned_zeros((len(geometry.psi_rad) * geometry.samples, depth))
    upright = np.abs(plain.cosine) >= np.abs(plain.sine)
    for turned, side, angles, rows, pitch, filled in (
        (plain, 1, np.flatnonzero(upright), laid.by_y, laid.pitch_y, laid.filled),
        (plain.transposed(), -1, np.flatnonzero(~upright), laid.by_x, laid.pitch_x, laid.filled.T),
    ):
        level.project(
            angles, rows, SPARE, pitch, filled_boxes(filled, level.SLOW_TILE, level.FAST_TILE), *turned.rays,
            *turned.losses, side, plain.loses, geometry.from_both_sides, geometry.samples, seen,
        )  # fmt: skip
    return np.ascontiguousarray(seen.reshape(len(geometry.psi_rad), geometry.samples, depth)[:, :, :slices])


def _check(shape: tuple[int, ...], wanted: tuple[int, int]) -> None:
    # Kernels check no bounds: an array of another shape would be read past its end.
    if shape != wanted:
        raise ValueError(f"array begins with {shape}, the geometry with {wanted}")


class _Plain(NamedTuple):
    """A geometry as the kernels take it, in strip widths."""

    cosine: FloatArray
    sine: FloatArray
    first: float
    voxel: float
    x: FloatArray
    y: FloatArray
    reached: tuple[IntArray, IntArray]
    """First voxel that is wanted, and the one after the last: along x for every y, along y for every x."""
    absorption: float
    tilt: Float32Array

    @property
    def rays(self) -> tuple[FloatArray, FloatArray, float, float, FloatArray, FloatArray]:
        """Where shadows fall."""
        return self.cosine, self.sine, self.first, self.voxel, self.x, self.y

    @property
    def losses(self) -> tuple[Float32Array, Float32Array, Float32Array]:
        """What is left of light."""
        return *absorbed(self.absorption, self.cosine, self.sine, self.x, self.y), self.tilt

    @property
    def loses(self) -> bool:
        """Whether anything is lost at all."""
        return self.absorption != 0 or bool(self.tilt.any())

    def transposed(self) -> _Plain:
        """Return the same with x and y in each other's places; light then comes from the other side."""
        return self._replace(
            cosine=-self.sine, sine=-self.cosine, x=self.y, y=self.x, reached=self.reached[::-1],
            absorption=-self.absorption,
        )  # fmt: skip

    def lengthened(self, angles: int) -> _Plain:
        """Return the same with some more angles."""
        return self._replace(cosine=np.pad(self.cosine, (0, angles)), sine=np.pad(self.sine, (0, angles)))


def _plain(geometry: StripGeometry) -> _Plain:
    width = geometry.spacing_mm
    tilt = np.zeros(geometry.samples) if geometry.tilt_per_mm is None else geometry.tilt_per_mm * width
    x, y = geometry.x_mm / width, geometry.y_mm / width
    reached: BoolArray = np.square(x) + np.square(y)[:, None] <= (geometry.within_mm / width) ** 2
    return _Plain(
        np.cos(geometry.psi_rad), np.sin(geometry.psi_rad), geometry.first_s_mm / width, geometry.voxel_mm / width,
        x, y, (_ends(reached), _ends(reached.T)), geometry.absorption_per_mm * width, tilt.astype(np.float32),
    )  # fmt: skip


def _ends(inside: BoolArray) -> IntArray:
    """Return (row, 2) the first place in every row of a convex region, and the one after the last; twice 0 for none."""
    last = inside.shape[1] - inside[:, ::-1].argmax(axis=1)
    return np.stack([inside.argmax(axis=1), np.where(inside.any(axis=1), last, 0)], axis=1)


def _tile(depth: int, parts: int) -> int:
    """Return the edge of tiles of voxels for a number of slices, and of parts of their shadows."""
    return _WIDE_TILE if depth <= _DEPTH_OF_WIDE_TILES and parts == 1 else _TILE


def _knots(geometry: StripGeometry, tile: int, *, alike: bool) -> int:
    """Return at how many places of its way through a tile the climb of light has to be found.

    Light that is not alike both ways needs some for the difference in what is absorbed, ``tanh(mu t)``.
    """
    assert geometry.z_mm is not None  # for mypy: the callers have asked
    assert geometry.z_mm is not None  # for mypy: the callers have asked
    tilt = 0.0 if geometry.tilt_per_mm is None else float(np.abs(geometry.tilt_per_mm).max())
    way_mm = (tile - 1) * math.sqrt(2) * geometry.voxel_mm
    intervals = way_mm * tilt * float(np.abs(geometry.z_mm).max()) / _slice_mm(geometry) / _CLIMB_A_KNOT
    if not alike:
        intervals = max(intervals, way_mm * geometry.absorption_per_mm / _ABSORPTION_A_KNOT)
    return 1 + max(1, math.ceil(intervals))


def _first_slice(geometry: StripGeometry) -> float:
    """Return the height of the first slice, in slices."""
    assert geometry.z_mm is not None  # for mypy: the callers have asked
    return float(geometry.z_mm[0] / _slice_mm(geometry))


def _slice_mm(geometry: StripGeometry) -> float:
    """Return the distance of slices."""
    assert geometry.z_mm is not None  # for mypy: the callers have asked
    return float(geometry.z_mm[1] - geometry.z_mm[0]) if len(geometry.z_mm) > 1 else geometry.voxel_mm
