"""Printing a plan's patterns on the twin, as the printer would: by the clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from vialight.core.arrays import Grid
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns
from vialight.twin.exposure import dose_of
from vialight.twin.machine import Frame, Twin

FRAME_RATE_HZ = 10.0
"""Of the camera, Orth et al. 2022."""


class Moment(NamedTuple):
    """What happened at a tick of the camera."""

    frame: Frame | None
    """None where it was dropped."""
    is_lit: bool
    """Whether the projector is on."""


def grid_round(part: Mesh, voxel_mm: float, *, margin_mm: float = 1.5, reach_mm: float = np.inf) -> Grid:
    """Return voxels that hold a part at any angle and a margin of resin, but no more than the projector reaches.

    Examples
    --------
    >>> part = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> grid_round(part, 0.5, margin_mm=1.0)
    Grid(shape=(12, 16, 12), voxel_mm=0.5, centre_z_mm=2.0)
    """
    low, high = part.bounds_mm
    half = np.minimum(np.maximum(np.abs(low), np.abs(high))[:2] + margin_mm, reach_mm)
    across, along = (2 * int(np.ceil(side / voxel_mm - 1e-9)) for side in half)
    deep = int(np.ceil((high[2] - low[2] + 2 * margin_mm) / voxel_mm - 1e-9))
    return Grid((deep, along, across), voxel_mm, float(low[2] + high[2]) / 2)


def dose_a_turn_mj_per_cm2(patterns: Patterns, twin: Twin) -> float:
    """Return what a dose of 1 in the plan's unit is in this printer, mJ/cm^2."""
    projector = twin.rig.need_projector()
    assert projector.irradiance_mw_per_cm2 is not None  # the twin has seen to it
    a_level = projector.irradiance_mw_per_cm2 / 255 / np.radians(twin.rig.stage.speed_deg_s)
    return float(a_level / patterns.dose_rate_per_level)


def check_that_it_gels(patterns: Patterns, twin: Twin, turns: float) -> None:
    """Raise InputError where the largest dose of all voxels stays below the resin's critical dose.

    The dose is computed on voxels four times as large; `turns` may be infinite.
    """
    grid = twin.grid
    shape = [max(2, -(-count // 4)) for count in grid.shape]
    coarse = Grid((shape[0], shape[1], shape[2]), 4 * grid.voxel_mm, grid.centre_z_mm)
    a_turn = float(dose_of(patterns, twin.rig, coarse, points_a_voxel=(1, 2, 2)).max())
    gain = twin.settings.faults.projector_gain
    dose = turns * a_turn * gain * dose_a_turn_mj_per_cm2(patterns, twin) if a_turn * gain > 0 else 0.0
    critical = twin.resin.chemistry.critical_dose_mj_per_cm2(twin.resin.absorption_per_mm)
    if not dose > critical or not np.isfinite(critical):
        raise InputError(
            "twin",
            f"the resin cannot gel: it gets {dose:.4g} mJ/cm^2 at most",
            accepted=f"more than its critical dose, {critical:.4g} mJ/cm^2",
            remedy="print more turns, or check irradiance and absorption",
        )


def play(
    twin: Twin,
    patterns: Patterns,
    *,
    turns: float,
    dark_turns: float = 1.0,
    frame_rate_hz: float = FRAME_RATE_HZ,
    is_done: Callable[[Twin], bool] = lambda twin: False,
) -> Iterator[Moment]:
    """Print, and hand over what the camera sees while it happens.

    Patterns are chosen as the printer does: when the projector's next image is due, for the angle at which the stage
    ought to be in the middle of its showing, counted counter-clockwise seen from above whichever way the stage counts.

    Parameters
    ----------
    twin
        Left at the end of the print, for its truth.
    patterns
        What to show.
    turns
        After which the light goes off.
    dark_turns
        For which frames go on after that.
    frame_rate_hz
        Of the camera.
    is_done
        Asked once a second: True turns the light off.

    Yields
    ------
    Moment
        One for every tick of the camera.
    """
    stage, projector = twin.rig.stage, twin.rig.need_projector()
    speed = float(np.radians(stage.speed_deg_s))
    turn_s = 2 * np.pi / speed
    start, off_s = twin.time_s, twin.time_s + turns * turn_s
    corner = (patterns.first_row, patterns.first_column)
    levels = list(patterns.levels)
    image, frame, asked = 0, 0, start
    while True:
        next_image, next_frame = start + image / projector.frame_rate_hz, start + frame / frame_rate_hz
        now = min(next_image, next_frame)
        if now > twin.time_s:
            twin.advance(now - twin.time_s)
        if now >= off_s + dark_turns * turn_s - 1e-9:
            twin.show(None)
            return
        if now - asked >= 1.0 and now < off_s:
            asked = now
            off_s = now if is_done(twin) else off_s
        if next_image <= now:
            due = patterns.index_at(stage.direction * speed * (now + 0.5 / projector.frame_rate_hz))
            twin.show(levels[due] if now < off_s - 1e-9 else None, corner)
            image += 1
        if next_frame <= now:
            yield Moment(twin.frame(), now < off_s - 1e-9)
            frame += 1
