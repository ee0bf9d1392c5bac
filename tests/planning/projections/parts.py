"""Parts, light and rigs that the tests of projections share."""

from __future__ import annotations

import numpy as np

from twin.rigs import printer
from vialight.core.arrays import Float32Array, Grid
from vialight.core.config import Rig
from vialight.optics.viewing import ray_tilt
from vialight.planning.projections import Goal, Light, light_for
from vialight.planning.projections.forward import strip_positions

RIG = printer(0.08)
"""The paper's: glass, finite throw, absorption of 0.08 / mm."""


def star(grid: Grid, void_slices: int = 0) -> Float32Array:
    """A star of five arms with a hole, unlike its mirror image, (y, x, z), uniform along z; radius 4 mm."""
    r, angle = np.hypot(grid.x_mm, grid.y_mm[:, None]), np.arctan2(grid.y_mm[:, None], grid.x_mm)
    plan = (r < 3.2 + 0.8 * np.cos(5 * angle)) & (np.hypot(grid.x_mm - 0.8, grid.y_mm[:, None] - 0.6) > 0.8)
    inside = np.repeat(plan[:, :, None], grid.shape[0], axis=2).astype(np.float32)
    if void_slices:
        inside[:, :, :void_slices] = inside[:, :, -void_slices:] = 0
    return inside


def light_of(rig: Rig, grid: Grid, angles: int, *, climbing: bool = False, diffusion_mm: float = 0.0) -> Light:
    """The forward model of a plan: absorption and spread."""
    optics = rig.writing_optics()
    positions = strip_positions(grid.shape[1] / 2 * grid.voxel_mm, grid.voxel_mm)
    return light_for(
        grid, angles, absorption_per_mm=rig.resin.absorption_per_mm or 0.0,
        tilt_at=None if optics is None else ray_tilt(positions, optics), climbing=climbing, diffusion_mm=diffusion_mm,
    )  # fmt: skip


def small_goal(depth: int = 2, voxel_mm: float = 0.2, angles: int = 120) -> tuple[Goal, Light, Grid]:
    """The star in a few slices, without a vial."""
    grid = Grid((depth, 46, 46), voxel_mm)
    light = light_for(grid, angles)
    return Goal(star(grid), light.reach), light, grid
