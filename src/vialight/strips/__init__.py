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
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vialight.arrays import BoolArray, Float32Array, FloatArray, IntArray
from vialight.memory import aligned_zeros, padded_depth
from vialight.strips import climbing, level
from vialight.strips.shadows import absorbed

_TILE, _WIDE_TILE, _DEPTH_OF_WIDE_TILES = 16, 32, 96
"""Edges of tiles in voxels; up to how many slices a wide one stays in a cache of 512 kB."""

_CLIMB_A_KNOT = 0.35
"""Slices that light may climb from one knot to the next, between which it is interpolated."""


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
        # A shadow is up to sqrt(2) voxels wide; more than three strips would not be counted.
        if self.voxel_mm > math.sqrt(2) * self.spacing_mm:
            raise ValueError(f"voxels of {self.voxel_mm} mm are too wide for strips of {self.spacing_mm} mm")

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
    angles, strips, slices = projections.shape
    dose = np.empty((len(geometry.y_mm), len(geometry.x_mm), slices), np.float32)
    depth, lit, plain = padded_depth(slices), _lit_strips(projections), _plain(geometry)
    tile = _tile(depth)
    if geometry.z_mm is not None:
        climbing.backproject(
            tile, _knots(geometry, tile), np.ascontiguousarray(projections), lit, *plain.rays, plain.reached,
            *plain.losses, plain.absorption, geometry.from_both_sides, _first_height(geometry), depth, dose,
        )  # fmt: skip
        return dose
    more = -angles % level.ANGLES_A_PASS
    rows = aligned_zeros((angles + more, strips + 2 * level.DARK, depth))
    rows[:angles, level.DARK : -level.DARK, :slices] = projections
    lit, plain = np.pad(lit, ((0, more), (0, 0))), plain.lengthened(more)
    level.backproject(
        tile, rows.reshape(-1, depth), strips, lit, *plain.rays, plain.reached, *plain.losses, plain.loses,
        geometry.from_both_sides, dose,
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
    depth = padded_depth(slices)
    tile = _tile(depth)
    rows = aligned_zeros((*volume.shape[:2], depth))
    rows[:, :, :slices] = volume
    columns = np.arange(volume.shape[1])
    lit = volume.any(axis=2) & (columns >= plain.reached[:, :1]) & (columns < plain.reached[:, 1:])
    rows, lit = rows.reshape(-1, depth), lit.ravel()
    if geometry.z_mm is not None:
        projections = np.zeros((len(geometry.psi_rad), geometry.samples, slices), np.float32)
        climbing.project(
            tile, _knots(geometry, tile), rows, lit, *plain.rays, *plain.losses, plain.absorption,
            geometry.from_both_sides, _first_height(geometry), projections,
        )  # fmt: skip
        return projections
    projections = aligned_zeros((len(geometry.psi_rad), geometry.samples, depth))
    level.project(tile, rows, lit, *plain.rays, *plain.losses, plain.loses, geometry.from_both_sides, projections)
    return np.ascontiguousarray(projections[:, :, :slices])


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
    reached: IntArray
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

    def lengthened(self, angles: int) -> _Plain:
        """Return the same with some more angles."""
        return self._replace(cosine=np.pad(self.cosine, (0, angles)), sine=np.pad(self.sine, (0, angles)))


def _plain(geometry: StripGeometry) -> _Plain:
    width = geometry.spacing_mm
    tilt = np.zeros(geometry.samples) if geometry.tilt_per_mm is None else geometry.tilt_per_mm * width
    x, y = geometry.x_mm / width, geometry.y_mm / width
    half_chord = np.sqrt(np.maximum((geometry.within_mm / width) ** 2 - y**2, 0))[:, None]
    reached = np.searchsorted(x, np.concatenate([-half_chord, np.nextafter(half_chord, np.inf)], axis=1))
    return _Plain(
        np.cos(geometry.psi_rad), np.sin(geometry.psi_rad), geometry.first_s_mm / width, geometry.voxel_mm / width,
        x, y, reached.astype(np.int64), geometry.absorption_per_mm * width, tilt.astype(np.float32),
    )  # fmt: skip


def _tile(depth: int) -> int:
    """Return the edge of tiles of voxels for a number of slices."""
    return _WIDE_TILE if depth <= _DEPTH_OF_WIDE_TILES else _TILE


def _knots(geometry: StripGeometry, tile: int) -> int:
    """Return at how many places of its way through a tile the climb of light has to be found."""
    assert geometry.z_mm is not None  # for mypy: the callers have asked
    tilt = 0.0 if geometry.tilt_per_mm is None else float(np.abs(geometry.tilt_per_mm).max())
    climb = tile * math.sqrt(2) * tilt * float(np.abs(geometry.z_mm).max())
    return 1 + max(1, math.ceil(climb / _CLIMB_A_KNOT))


def _lit_strips(projections: Float32Array) -> IntArray:
    """Return (psi, 2) the first strip with any light, and the one after the last."""
    lit: BoolArray = np.asarray(projections.any(axis=2))
    last = lit.shape[1] - lit[:, ::-1].argmax(axis=1)
    return np.stack([lit.argmax(axis=1), np.where(lit.any(axis=1), last, 0)], axis=1)


def _first_height(geometry: StripGeometry) -> float:
    """Return the height of the first slice, in slices."""
    assert geometry.z_mm is not None  # for mypy: the callers have asked
    slice_mm = geometry.z_mm[1] - geometry.z_mm[0] if len(geometry.z_mm) > 1 else geometry.voxel_mm
    return float(geometry.z_mm[0] / slice_mm)
