"""The gelation threshold I_p from the true surface of a print: its CT scan, or a reference that it is known to meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from vialight.core.arrays import FloatArray, IntArray, Volume
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.metrology import Registration, register, sample_surface
from vialight.metrology.surface import isosurface

SAMPLES = 40_000
BLOCKS = 32
"""Pieces of the surface whose medians tell how well that of the whole is known."""
LEAST_NEAR = 0.5
"""Share of a surface that the print's must be near."""
_ROUNDS = 2
"""A threshold moves the surface that is laid on the given one; that by half the contrast is near the place already."""


@dataclass(frozen=True)
class SurfaceThreshold:
    """I_p from a surface.

    Parameters
    ----------
    threshold
        Median, by area, of the density on the surface: the level at which as much of it lies outside as inside.
    std
        Its standard uncertainty: by how much the medians of pieces of the surface differ, and of the blur.
    slope_per_mm
        By how much the density falls with each mm outwards, in the median.
    densities
        (n,) on points spread evenly over the surface.
    registration
        From the print to the surface.
    """

    threshold: float
    std: float
    slope_per_mm: float
    densities: FloatArray
    registration: Registration

    @property
    def spread(self) -> float:
        """Robust standard deviation over the surface."""
        return 1.4826 * float(np.median(np.abs(self.densities - self.threshold)))


def surface_threshold(volume: Volume, surface: Mesh, where: object = "") -> SurfaceThreshold:
    """Find the level at which a print's surface meets a given one: as often outside it as inside.

    The median, for at sharp edges any finite resolution leaves less density on the true surface, and where the given
    surface is not the print's it says nothing of the threshold: neither moves a median by much.

    Parameters
    ----------
    volume
        Density, counts per mm.
    surface
        The true one, in any place: the print is laid on it first.
    where
        Named in errors.

    Raises
    ------
    InputError
        The print's surface is not near the given one.
    """
    samples = sample_surface(surface, SAMPLES)
    points = samples.points_mm[samples.weights_mm2 > 0]  # each for as much area
    low, high = np.percentile(volume.density, [2, 99.5])
    threshold = float(low + high) / 2
    for _ in range(_ROUNDS):
        registration = register(isosurface(volume, threshold), surface)
        back = np.linalg.inv(registration.matrix)
        placed = points @ back[:3, :3].T + back[:3, 3]
        inwards = _gradient(volume, placed)
        densities = _at(volume, placed)
        threshold = float(np.median(densities))
        _check_near(volume, placed, inwards, float(high - low), where)
    slope = float(np.median(np.linalg.norm(inwards, axis=1)))
    medians = [np.median(densities[block]) for block in _blocks(placed)]
    # Not that of their mean: pieces differ by how they are curved and where edges are, which any other print shares.
    # As at a cylinder's rim, blur of standard deviation s moves it by s^2 / (2 r), and may be none or all of the
    # edge's softness; r as volume and area have it.
    blur_mm = float(high - low) / slope / np.sqrt(2 * np.pi)
    blurred = (
        slope * blur_mm**2 * samples.weights_mm2.sum() / (4 * abs(surface.volume_mm3)) if surface.is_closed else 0.0
    )
    std = float(np.hypot(np.std(medians, ddof=1), blurred / np.sqrt(3)))
    return SurfaceThreshold(threshold, std, slope, densities, registration)


def _check_near(volume: Volume, points: FloatArray, inwards: FloatArray, contrast: float, where: object) -> None:
    reach = 3 * volume.grid.voxel_mm * inwards / np.maximum(np.linalg.norm(inwards, axis=1), 1e-30)[:, None]
    share = float((_at(volume, points + reach) - _at(volume, points - reach) > contrast / 2).mean())
    if share < LEAST_NEAR:
        raise InputError(
            where, f"the print's surface is within 3 voxels of the given one on {share:.0%} of its area",
            accepted=f"the surface of the print that was recorded, in mm: {LEAST_NEAR:.0%}",
            remedy="check the mesh and its unit",
        )  # fmt: skip


def _blocks(points: FloatArray) -> list[IntArray]:
    """Cut points into `BLOCKS` pieces of as many each, by halves across the longest side."""
    blocks = [np.arange(len(points))]
    while len(blocks) < BLOCKS:
        halves = []
        for block in blocks:
            axis = int(np.argmax(np.ptp(points[block], axis=0)))
            halves += np.array_split(block[np.argsort(points[block, axis])], 2)
        blocks = halves
    return blocks


def _at(volume: Volume, points: FloatArray) -> FloatArray:
    grid = volume.grid
    origin = np.asarray(grid.origin_mm)
    indices = (points[:, ::-1] - origin) / grid.voxel_mm
    return np.asarray(map_coordinates(volume.density, indices.T, order=1, mode="nearest"), dtype=np.float64)


def _gradient(volume: Volume, points: FloatArray) -> FloatArray:
    steps = np.eye(3) * volume.grid.voxel_mm / 2
    return np.stack(
        [(_at(volume, points + step) - _at(volume, points - step)) / volume.grid.voxel_mm for step in steps], axis=1
    )
