"""Stage: what finished patterns do, whoever computed them.

The judge of every method: it knows only grey levels, angles and the rig.  Pixels are square and count by the share
that each has in what a ray stands for, patterns are held over their angle, and the dose of a voxel is the mean over its
square of rays a third of it apart.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, Grid, centred
from vialight.core.compiling import FAST_MATH
from vialight.core.config import Rig
from vialight.core.plan import Patterns
from vialight.optics.viewing import pixel_rays, pixels_of, ray_tilt
from vialight.planning.strips import StripGeometry, backproject_strips

SUBVOXELS = 3
"""Rays across a voxel, and stage angles for each pattern."""

_RAYS_A_BLOCK = 32_000_000
"""Whose light is held at once: 128 MB, and as much again while it is sorted by its way."""


def dose_of_patterns(
    patterns: Patterns, rig: Rig, grid: Grid, *, subvoxels: int = SUBVOXELS, climbing: bool = True
) -> Float32Array:
    """Compute the dose that patterns make in one turn, block by block of slices.

    Parameters
    ----------
    patterns
        Of any origin.
    rig
        That shows them: it may be another than they were computed for.
    grid
        Voxels wanted.
    subvoxels
        Rays across a voxel, and stage angles for each pattern: 1 to 3.
    climbing
        Follow the rays' climb in z; else light stays in the slice in which it passes the axis.

    Returns
    -------
    numpy.ndarray
        (z, y, x) float32, 1 being the dose that is meant inside the part.
    """
    optics = rig.writing_optics()
    spacing = grid.voxel_mm / subvoxels
    radius = float(np.hypot(grid.x_mm[-1], grid.y_mm[-1])) + grid.voxel_mm
    if optics is not None:
        radius = min(radius, optics.field_radius_mm)
    s_mm = centred(2 * int(radius / spacing), spacing)
    tilt = None if optics is None else ray_tilt(s_mm, optics)
    held = patterns.step_rad / subvoxels
    # On both sides of the angle at which a pattern is due: without a vial, all light would change between two at once.
    parts = np.arange(len(patterns.angles_rad) * subvoxels, dtype=np.float64) - (subvoxels - 1) / 2
    psi = patterns.angles_rad[0] - np.radians(rig.need_projector().azimuth_deg) + parts * held
    dose = np.empty(grid.shape, np.float32)
    # One slice more than light climbs: it tells what a slice spans of the image.
    largest_climb = 0.0 if tilt is None or not climbing else float(tilt.max()) * radius * np.abs(grid.z_mm).max()
    margin = int(np.ceil(largest_climb / grid.voxel_mm)) + 1
    per_level = _dose_rate_per_level(patterns, rig)
    slices = max(_RAYS_A_BLOCK // (len(psi) * len(s_mm)) - 2 * margin, 1)
    for start in range(0, grid.shape[0], slices):
        stop = min(start + slices, grid.shape[0])
        z_mm = grid.z_mm[0] + np.arange(start - margin, stop + margin, dtype=np.float64) * grid.voxel_mm
        geometry = StripGeometry(
            psi, float(s_mm[0]), spacing, len(s_mm), grid.x_mm, grid.y_mm, rig.resin.absorption_per_mm or 0.0, tilt,
            z_mm if climbing and tilt is not None else None,
        )  # fmt: skip
        lit = backproject_strips(_light_of_patterns(patterns, rig, per_level, psi, s_mm, z_mm), geometry)
        dose[start:stop] = lit[:, :, margin : lit.shape[2] - margin].transpose(2, 0, 1) * np.float32(held)
    return dose


def _dose_rate_per_level(patterns: Patterns, rig: Rig) -> Float32Array:
    """Return, for every pixel of the patterns, the dose rate that one level of it brings into the resin."""
    projector, (_, rows, columns) = rig.need_projector(), patterns.levels.shape
    first = patterns.first_row, patterns.first_column
    # Pixels that this projector has not, another than the patterns were made for, stay dark.
    there = max(min(rows, projector.rows - first[0]), 0), max(min(columns, projector.columns - first[1]), 0)
    absorption = rig.resin.absorption_per_mm or 0.0
    rays = pixel_rays(there[1], there[0], projector.as_camera(), rig.writing_optics(), absorption, first=first)
    per_level = np.zeros((rows, columns), np.float32)
    per_level[: there[0], : there[1]] = rays.delivery * patterns.dose_rate_per_level
    return per_level


def _light_of_patterns(
    patterns: Patterns, rig: Rig, per_level: Float32Array, psi_rad: FloatArray, s_mm: FloatArray, z_mm: FloatArray
) -> Float32Array:
    """Return the light of patterns as parallel rays in the resin, (psi, s, z), where they pass closest to the axis.

    Positions and heights are two or more, evenly spaced: each ray stands for what lies half way to the next.
    """
    projector = rig.need_projector()
    column, row, direction = pixels_of(s_mm[:, None], z_mm, projector.as_camera(), rig.writing_optics())
    out = np.zeros((len(psi_rad), len(s_mm), len(z_mm)), np.float32)
    turned = psi_rad + np.radians(projector.azimuth_deg) - patterns.angles_rad[0]
    _look_up(
        np.ascontiguousarray(patterns.levels.transpose(1, 2, 0)), row - patterns.first_row, _widths(row, 1),
        column - patterns.first_column, _widths(column, 0),
        np.nan_to_num(direction) / patterns.step_rad % len(patterns.levels), turned / patterns.step_rad, per_level, out,
    )  # fmt: skip
    return out


def _widths(position: FloatArray, axis: int) -> FloatArray:
    """Return how many pixels each of two or more samples spans, next to none where they lie on each other."""
    return np.maximum(np.abs(np.asarray(np.gradient(position, axis=axis), dtype=np.float64)), 1e-6)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _look_up(
    levels: NDArray[np.uint8],
    row: FloatArray,
    height: FloatArray,
    column: FloatArray,
    width: FloatArray,
    direction: FloatArray,
    turned: FloatArray,
    per_level: Float32Array,
    out: Float32Array,
) -> None:
    """Average, for every ray, the pixels that light what it stands for, of the pattern that is then shown.

    Levels are (row, column, pattern): what a ray stands for is found once, and summed in all patterns.  Both
    directions, 0 to the count of patterns, and turns, -1/2 to that less 1/2, are in patterns.
    """
    rows, columns, count = levels.shape
    rays, depth = row.shape
    for i in prange(rays):
        light = np.zeros((depth, count), np.float32)
        for z in range(depth):
            top, bottom = row[i, z] + 0.5 - height[i, z] / 2, row[i, z] + 0.5 + height[i, z] / 2
            left, right = column[i, z] + 0.5 - width[i, z] / 2, column[i, z] + 0.5 + width[i, z] / 2
            if not np.isfinite(top + bottom + left + right):
                continue
            for r in range(max(int(np.floor(top)), 0), min(int(np.ceil(bottom)), rows)):
                high = min(bottom, r + 1.0) - max(top, r)
                for c in range(max(int(np.floor(left)), 0), min(int(np.ceil(right)), columns)):
                    area = high * (min(right, c + 1.0) - max(left, c))
                    share = np.float32(area / (height[i, z] * width[i, z])) * per_level[r, c]
                    for k in range(count):
                        light[z, k] += share * np.float32(levels[r, c, k])
        for p in range(len(turned)):
            for z in range(depth):
                k = int(np.floor(turned[p] - direction[i, z] + 0.5))
                out[p, i, z] = light[z, k + count if k < 0 else k]


@dataclass(frozen=True)
class Score:
    """What a dose does to a part, as the field defines it.

    Doses are divided by the largest in-part dose, as by VAMToolbox, unless stated otherwise.

    Parameters
    ----------
    voxel_error_rate
        Share of all judged voxels that are void and get as much dose as the least exposed voxel of the part.
    process_window
        Least in-part dose minus largest void dose: positive where some dose separates the two.
    in_part_dose_range
        Largest minus least in-part dose.
    jaccard
        Of the part and what cures, at the best threshold.
    best_threshold
        Dose, in units of what is meant in the part, at which that is.
    in_part_mean, in_part_std, void_max
        Dose, in the same units.
    light_efficiency
        Mean level over all pixels that light the write volume, as a share of the brightest.
    """

    voxel_error_rate: float
    process_window: float
    in_part_dose_range: float
    jaccard: float
    best_threshold: float
    in_part_mean: float
    in_part_std: float
    void_max: float
    light_efficiency: float

    def to_json(self) -> dict[str, Any]:
        """Return the figures under their names; None for what is not known, as JSON has no NaN."""
        return {name: None if np.isnan(value) else value for name, value in asdict(self).items()}


def judged_voxels(grid: Grid) -> BoolArray:
    """Return (1, y, x): the circle in the grid; its corners are out of the light's way, or out of the vial.

    Examples
    --------
    >>> judged_voxels(Grid((1, 4, 4), 1.0))[0].sum()
    np.int64(12)
    """
    radius = max(grid.shape[1:]) / 2 * grid.voxel_mm
    return np.asarray(np.hypot(grid.x_mm, grid.y_mm[:, None]) <= radius)[None]


def score_dose(dose: Float32Array, inside: Float32Array, judged: BoolArray, patterns: Patterns | None = None) -> Score:
    """Judge a dose against the part that was meant.

    Parameters
    ----------
    dose, inside
        (z, y, x); the share of each voxel inside the part, which from 1/2 on is meant to cure.
    judged
        (z, y, x) or broadcastable: voxels that count, those that light can reach.
    patterns
        For the light efficiency.

    Examples
    --------
    >>> dose = np.array([[[1.0, 0.9, 0.5, 0.2]]], np.float32)
    >>> score = score_dose(dose, np.array([[[1, 1, 0, 0]]], np.float32), np.ones((1, 1, 4), bool))
    >>> score.jaccard, round(score.process_window, 3), round(score.in_part_dose_range, 3)
    (1.0, 0.4, 0.1)
    """
    judged = np.broadcast_to(judged, dose.shape)
    part = (inside >= 0.5) & judged
    in_part, in_void = np.sort(dose[part]), np.sort(dose[judged & ~part])
    least, largest = float(in_part[0]), float(in_part[-1])
    void_max = float(in_void[-1]) if len(in_void) else 0.0
    overlap = len(in_void) - int(np.searchsorted(in_void, least))
    # Every in-part dose is tried as a threshold: what cures is all that gets at least that.
    cured_part = len(in_part) - np.arange(len(in_part))
    cured_void = len(in_void) - np.searchsorted(in_void, in_part)
    jaccard = cured_part / (len(in_part) + cured_void)
    best = int(jaccard.argmax())
    return Score(
        voxel_error_rate=overlap / int(judged.sum()),
        process_window=(least - void_max) / largest,
        in_part_dose_range=(largest - least) / largest,
        jaccard=float(jaccard[best]),
        best_threshold=float(in_part[best]),
        in_part_mean=float(in_part.mean(dtype=np.float64)),
        in_part_std=float(in_part.std(dtype=np.float64)),
        void_max=void_max,
        light_efficiency=float(patterns.levels.mean(dtype=np.float64) / 255) if patterns is not None else float("nan"),
    )
