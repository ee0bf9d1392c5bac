"""Standard cylinders: volumes as if perfectly reconstructed, height maps, and recordings by the twin's camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.ndimage import gaussian_filter

from soft_parts import frames_of_part, softened
from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.config import Rig
from vialight.core.mesh import Mesh
from vialight.store import write_frames
from vialight.twin.sensor import Sensor

PIXEL_MM = 0.05
"""Of the height maps."""


def cylinder(x: Any, y: Any, z: Any, radius_mm: float, half_mm: float, centre: tuple[float, float] = (0, 0)) -> Any:
    """Signed distance to an upright cylinder."""
    beside, beyond = np.hypot(x - centre[0], y - centre[1]) - radius_mm, np.abs(z) - half_mm
    return np.minimum(np.maximum(beside, beyond), 0) + np.hypot(np.maximum(beside, 0), np.maximum(beyond, 0))


def cylinder_mesh(radius_mm: float, height_mm: float) -> Mesh:
    """Return an upright cylinder about the origin."""
    solid = trimesh.creation.cylinder(radius_mm, height_mm, sections=200)
    return Mesh(solid.vertices, solid.faces)


def volume_of(signed_distance: Any, grid: Grid, *, blur_mm: float = 0.0, noise: float = 0.0) -> Float32Array:
    """Return (z, y, x) of a part, blurred, with noise, cured to 200 counts per mm."""
    z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij")
    density = softened(signed_distance(x, y, z))
    if blur_mm:
        density = gaussian_filter(density, blur_mm / grid.voxel_mm)
    noisy = density + np.random.default_rng(0).normal(0, noise, grid.shape) if noise else density
    return np.asarray(noisy, dtype=np.float32)


def height_map(
    radius_mm: float, centre_mm: tuple[float, float] = (9.17, 8.69), *, size: int = 360, seed: int = 0
) -> FloatArray:
    """Return the map of a cylinder of 10 mm that was set down anywhere: noise, and 2 % of the pixels missing."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:size, :size] * PIXEL_MM
    heights = np.where(np.hypot(column - centre_mm[0], row - centre_mm[1]) < radius_mm, 10.0, 0.0)
    heights += rng.normal(0, 0.004, heights.shape)
    heights[rng.random(heights.shape) < 0.02] = np.nan
    return np.asarray(heights)


def record(
    path: Path, signed_distance: Any, grid: Grid, rig: Rig, shape: tuple[int, int], *, frames: int = 180, seed: int = 0
) -> None:
    """Record a part with the twin's camera, over a turn, and eight frames before it."""
    angles = np.arange(frames, dtype=np.float64) * (2 * np.pi / frames)
    rng, sensor = np.random.default_rng(seed), Sensor()
    clean = frames_of_part(signed_distance, grid, rig, shape, angles)
    dark = np.full((8, *shape), 60.0)
    write_frames(
        path, sensor.photograph(clean + 60.0, rng), angles, dark=sensor.photograph(dark, rng),
        settings={"exposure_s": 0.02, "binning": 1},
    )  # fmt: skip
