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

from dataclasses import dataclass

import numpy as np

from vialight.arrays import Float32Array, FloatArray
from vialight.strips import climbing, level


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
        level.backproject(np.ascontiguousarray(projections), *_plain(geometry), dose)
    else:
        climbing.backproject(np.ascontiguousarray(projections), *_plain(geometry), _first_height(geometry), dose)
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
        level.project(np.ascontiguousarray(volume), *_plain(geometry), projections)
    else:
        climbing.project(np.ascontiguousarray(volume), *_plain(geometry), _first_height(geometry), projections)
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
