"""The dose that places of the object have got, from what the projector truly showed.

A place (x, y, z) is lit at stage angle theta by the ray with ``psi = theta - beta + gamma(x_v)`` and
``x_v = x cos(psi) - y sin(psi)``, which is solved by repetition, gamma being small; it passes the place
``s = x sin(psi) + y cos(psi)`` behind the point closest to the axis, at ``z = z_mid (1 + s tilt)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from vialight.core.arrays import FloatArray, IntArray
from vialight.core.config import Rig
from vialight.core.plan import Patterns
from vialight.optics.viewing import pixel_rays, pixels_of, ray_tilt

_REPETITIONS = 6
"""Each makes the error of psi about ten times smaller."""
_MOMENTS_A_BLOCK = 512


@dataclass(frozen=True)
class ShownPatterns:
    """What the projector showed.

    Parameters
    ----------
    time_s
        (moment,) ascending; what begins at one moment lasts until the next.
    pattern
        (moment,) index of the plan's pattern; -1 is black.
    angle_rad
        (moment,) of the stage, counter-clockwise, in the middle of what begins then.
    """

    time_s: FloatArray
    pattern: IntArray
    angle_rad: FloatArray


def dose_over_time(points_mm: FloatArray, patterns: Patterns, rig: Rig, shown: ShownPatterns) -> FloatArray:
    """Return the (moment,) dose that places have got in the mean by each moment; see `doses_over_time`."""
    return np.asarray(doses_over_time(points_mm, patterns, rig, shown).mean(axis=1), dtype=np.float64)


def doses_over_time(points_mm: FloatArray, patterns: Patterns, rig: Rig, shown: ShownPatterns) -> FloatArray:
    """Return the dose that each place has got by each moment.

    Parameters
    ----------
    points_mm
        (point, xyz) object frame.
    patterns
        The plan's.
    rig
        With projector, vial and the resin's absorption.
    shown
        When what was shown, and where the stage then was.

    Returns
    -------
    numpy.ndarray
        (moment, point) in the plan's unit: 1 is the dose meant in the part after one turn.
    """
    projector, optics = rig.need_projector(), rig.writing_optics()
    absorption = rig.resin.absorption_per_mm or 0.0
    camera = projector.as_camera()
    delivery = pixel_rays(projector.columns, projector.rows, camera, optics, absorption).delivery
    lasts_s = np.diff(shown.time_s, append=shown.time_s[-1:])
    gained = np.zeros((len(shown.time_s), len(points_mm)))
    lit = np.flatnonzero((shown.pattern >= 0) & (lasts_s > 0))
    for block in np.array_split(lit, -(-len(lit) // _MOMENTS_A_BLOCK)) if len(lit) else []:
        row, column, behind_mm = _lit_by(points_mm, shown.angle_rad[block], rig)
        place = np.stack([np.broadcast_to(shown.pattern[block][:, None], row.shape), row - patterns.first_row,
                          column - patterns.first_column]).reshape(3, -1)  # fmt: skip
        # Between patterns nothing is interpolated: their numbers are whole.
        level = _looked_up(patterns, place).reshape(row.shape)
        share = map_coordinates(delivery, [row, column], order=1, mode="constant")
        gained[block] = level * share * np.exp(-absorption * behind_mm)
    rate = patterns.dose_rate_per_level * np.radians(rig.stage.speed_deg_s)
    total = np.cumsum(gained * (lasts_s * rate)[:, None], axis=0)
    return np.concatenate([np.zeros((1, len(points_mm))), total[:-1]])


def mj_per_cm2(patterns: Patterns, rig: Rig) -> float | None:
    """Return the mJ/cm^2 of light that a dose of 1 is; None where the rig does not say how bright it is."""
    irradiance = rig.need_projector().irradiance_mw_per_cm2
    if irradiance is None:
        return None
    return float(irradiance / 255 / np.radians(rig.stage.speed_deg_s) / patterns.dose_rate_per_level)


def _lit_by(points_mm: FloatArray, angle_rad: FloatArray, rig: Rig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return, as (moment, point), row and column of the pixel, and how far behind the ray's middle the point lies."""
    projector, optics = rig.need_projector(), rig.writing_optics()
    camera = projector.as_camera()
    x, y, z = points_mm.T
    seen = angle_rad[:, None] - np.radians(projector.azimuth_deg)
    direction = np.zeros(np.broadcast_shapes(seen.shape, x.shape))
    for _ in range(_REPETITIONS):
        psi = seen + direction
        virtual_x, behind = x * np.cos(psi) - y * np.sin(psi), x * np.sin(psi) + y * np.cos(psi)
        tilt = 0.0 if optics is None else ray_tilt(virtual_x, optics)
        column, row, direction = pixels_of(virtual_x, z / (1 + behind * tilt), camera, optics)
        direction = np.nan_to_num(direction)
    return np.nan_to_num(row, nan=-9.0), np.nan_to_num(column, nan=-9.0), behind


def _looked_up(patterns: Patterns, place: FloatArray) -> FloatArray:
    """Return levels at (pattern, row, column), rows and columns between pixels."""
    count, rows, columns = patterns.levels.shape
    number = np.asarray(place[0], np.int64) % count
    low = np.floor(place[1:]).astype(np.int64)
    part = place[1:] - low
    total = np.zeros(place.shape[1])
    for down in (0, 1):
        for right in (0, 1):
            row, column = low[0] + down, low[1] + right
            inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
            weight = (part[0] if down else 1 - part[0]) * (part[1] if right else 1 - part[1])
            levels = patterns.levels[number, np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
            total += np.where(inside, weight * levels, 0.0)
    return total
