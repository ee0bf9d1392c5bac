"""The forward model: from projections to dose, and its transpose.

Projections are dose rates per radian of turn, as they would be where the ray passes closest to the axis; a dose of 1 is
what the inside of the part is meant to get in one turn.  What the vial, the glass and the resin before the axis take
away is put back when patterns are made, so that it does not appear here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vialight.core.arrays import TURN_RAD, Float32Array, FloatArray, Grid, centred
from vialight.planning.strips import StripGeometry, backproject_strips, project_strips
from vialight.tomography.radon import FilterName, filter_rays, ramp_filter


@dataclass(frozen=True)
class Light:
    """How light makes dose.

    Parameters
    ----------
    geometry
        Of strips and voxels.
    projector_blur_mm
        Standard deviation of the projector's point spread in the resin.
    diffusion_mm
        Standard deviation of what diffuses in the resin while it cures.
    held
        Angles that each projection shines at, evenly over its share of the turn, on both sides of its own: the vial
        turns while a pattern is held.  1 takes it for a flash.
    """

    geometry: StripGeometry
    projector_blur_mm: float = 0.0
    diffusion_mm: float = 0.0
    held: int = 1

    @property
    def step_rad(self) -> float:
        """Turn that one projection stands for: with `from_both_sides`, both of its ways together."""
        return TURN_RAD / len(self.geometry.psi_rad)

    @property
    def geometry_held(self) -> StripGeometry:
        """With every angle that projections shine at, those of one after those of the other."""
        one_way = self.step_rad / (2 if self.geometry.from_both_sides else 1)
        beside = centred(self.held, one_way / self.held)
        return replace(self.geometry, psi_rad=(self.geometry.psi_rad[:, None] + beside).ravel())

    @property
    def reach(self) -> Float32Array:
        """(y, x, 1): 1 for voxels that every projection reaches, 0 else."""
        geometry = self.geometry
        half_width = -geometry.first_s_mm - 0.5 * geometry.spacing_mm
        radius = np.hypot(geometry.x_mm, geometry.y_mm[:, None])
        return (radius <= half_width).astype(np.float32)[:, :, None]


def light_for(
    grid: Grid,
    angles: int,
    *,
    radius_mm: float | None = None,
    absorption_per_mm: float = 0.0,
    tilt_at: FloatArray | None = None,
    climbing: bool = False,
    projector_blur_mm: float = 0.0,
    diffusion_mm: float = 0.0,
    held: int = 1,
) -> Light:
    """Choose strips as wide as voxels for a grid.

    Parameters
    ----------
    grid
        The target's voxels.
    angles
        Projections in a full turn, even.
    radius_mm
        About the axis, that light reaches from all sides; by default that of the circle in the grid.
    absorption_per_mm
        See `StripGeometry`.
    tilt_at
        (samples,) of `strip_positions`, see `StripGeometry.tilt_per_mm`.
    climbing
        Let rays climb from slice to slice.
    projector_blur_mm, diffusion_mm, held
        See `Light`.
    """
    positions = strip_positions(
        max(grid.shape[1:]) / 2 * grid.voxel_mm if radius_mm is None else radius_mm, grid.voxel_mm
    )
    # Opposite projections are alike: only half of them are computed.
    count = angles // 2
    geometry = StripGeometry(
        psi_rad=np.arange(count, dtype=np.float64) * (TURN_RAD / angles),
        first_s_mm=float(positions[0]),
        spacing_mm=grid.voxel_mm,
        samples=len(positions),
        x_mm=grid.x_mm,
        y_mm=grid.y_mm,
        absorption_per_mm=absorption_per_mm,
        tilt_per_mm=tilt_at,
        z_mm=grid.z_mm if climbing else None,
        from_both_sides=True,
        within_mm=float(positions[-1]),
    )
    return Light(geometry, projector_blur_mm, diffusion_mm, held)


def strip_positions(radius_mm: float, width_mm: float) -> FloatArray:
    """Return (s,) centres of strips that cover a circle about the axis."""
    return centred(2 * int(np.ceil(radius_mm / width_mm - 1e-6)), width_mm)  # 2.4 / 0.2 is a little more than 12


def dose_of(projections: Float32Array, light: Light) -> Float32Array:
    """Return the dose (y, x, z) that projections (psi, s, z) make in one turn."""
    shown = _blur(projections, light, light.projector_blur_mm)
    lit = backproject_strips(shown if light.held == 1 else np.repeat(shown, light.held, axis=0), light.geometry_held)
    lit *= np.float32(light.step_rad / light.held)
    return _diffuse(lit, light)


def collect(volume: Float32Array, light: Light) -> Float32Array:
    """Return the transpose of `dose_of` applied to a volume (y, x, z)."""
    seen = _project(_diffuse(volume, light), light)
    seen *= np.float32(light.step_rad)
    return _blur(seen, light, light.projector_blur_mm)


def filtered_projections(volume: Float32Array, light: Light, filter_name: FilterName = "ram-lak") -> Float32Array:
    """Return the projections, negative ones included, whose dose is the volume but for absorption and blur."""
    # With the same climb as the dose, the pair stays symmetric, and iterations on it stable.
    clear = replace(light, geometry=replace(light.geometry, absorption_per_mm=0.0))
    geometry = clear.geometry
    # A column of voxels in a strip is one voxel long for each; half, as light comes from both sides of the turn.
    scale = np.float32(geometry.voxel_mm**2 / geometry.spacing_mm / 2)
    matrix = ramp_filter(filter_name, geometry.samples, geometry.spacing_mm) * scale
    return filter_rays(matrix, _project(volume, clear))


def _project(volume: Float32Array, light: Light) -> Float32Array:
    """Return what strips see of a volume, the mean over the angles that they are held at."""
    seen = project_strips(volume, light.geometry_held)
    if light.held == 1:
        return seen
    return np.asarray(seen.reshape(-1, light.held, *seen.shape[1:]).mean(axis=1))


def _blur(projections: Float32Array, light: Light, sigma_mm: float) -> Float32Array:
    if sigma_mm == 0:
        return projections
    sigma = sigma_mm / light.geometry.spacing_mm
    return _gaussian(projections, (0.0, sigma, sigma_mm / light.geometry.voxel_mm))


def _diffuse(volume: Float32Array, light: Light) -> Float32Array:
    if light.diffusion_mm == 0:
        return volume
    return _gaussian(volume, (light.diffusion_mm / light.geometry.voxel_mm,) * 3)


def _gaussian(array: Float32Array, sigma: tuple[float, float, float]) -> Float32Array:
    from scipy.ndimage import gaussian_filter

    # Constant zero outside makes the blur its own transpose.
    return np.asarray(gaussian_filter(array, sigma, mode="constant", truncate=4.0))
