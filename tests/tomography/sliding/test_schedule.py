"""When virtual angles are brought into the volume."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.core.arrays import FloatArray
from vialight.tomography.sliding.schedule import Schedule

ANGLES, RAYS = 72, 101
STEP = 2 * np.pi / ANGLES
PSI = np.arange(ANGLES, dtype=np.float64) * STEP
SKEW = np.radians(40.0)
GAMMA: FloatArray = np.asarray(SKEW * np.linspace(-1, 1, RAYS) ** 3, dtype=np.float64)


def run(schedule: Schedule, frames: int, sense: int = 1, gamma: FloatArray = GAMMA) -> list[tuple[int, int]]:
    """Turn the stage; return (frame, angle of the first half turn) of all that is brought in."""
    taken = []
    for number in range(frames):
        newest = sense * number * STEP
        # The columns that this frame sees of each angle.
        for angle in range(ANGLES):
            off = (PSI[angle] - gamma - newest + np.pi) % (2 * np.pi) - np.pi
            schedule.touched[angle] |= (np.abs(off) <= STEP / 2).any()
        taken += [(number, int(row)) for row in schedule.take_due(newest, sense, 1)]
    return taken


@pytest.mark.parametrize("sense", [1, -1])
def test_each_angle_comes_in_on_the_axis_at_half_the_field_and_when_it_is_complete(sense: int) -> None:
    taken = run(Schedule(PSI, GAMMA, STEP), 3 * ANGLES, sense)
    row = 20
    came = np.array([frame for frame, angle in taken if angle == row and frame > ANGLES])
    passed = np.concatenate([sense * row + ANGLES * np.arange(5), sense * row + ANGLES * (np.arange(5) + 0.5)])
    lags = np.sort((came[:, None] - passed) * STEP, axis=1)
    behind = np.array([of_frame[of_frame >= -1e-9].min() for of_frame in lags])
    expected = np.array([0, SKEW / 8, SKEW + 1.5 * STEP])
    assert (np.abs(behind[:, None] - expected).min(axis=1) < STEP + 1e-5).all()
    assert len(came) in {11, 12, 13}


def test_a_frame_costs_three_angles_once_the_stage_turns_evenly() -> None:
    taken = run(Schedule(PSI, GAMMA, STEP), 3 * ANGLES)
    counts = np.bincount([frame for frame, _ in taken], minlength=3 * ANGLES)[ANGLES:]
    assert counts.max() == 3
    assert counts.mean() == pytest.approx(3)


def test_without_a_vial_an_angle_comes_in_twice() -> None:
    """At once, and when its neighbours make interpolation cubic."""
    still = np.zeros(RAYS)
    schedule = Schedule(PSI, still, STEP)
    np.testing.assert_allclose(schedule.lags_rad, [0, 1.5 * STEP])


def test_what_comes_too_late_comes_in_one_at_a_time_the_oldest_first() -> None:
    schedule = Schedule(PSI, GAMMA, STEP)
    run(schedule, ANGLES)
    newest = (ANGLES - 1) * STEP
    schedule.take_all()
    schedule.touched[[40, 45, 50]] = 1
    half = ANGLES // 2
    assert [int(schedule.take_due(newest, 1, 1)[0]) for _ in range(3)] == [40 - half, 45 - half, 50 - half]
    assert len(schedule.take_due(newest, 1, 1)) == 0


def test_an_angle_and_its_opposite_are_taken_as_one() -> None:
    schedule = Schedule(PSI, GAMMA, STEP)
    schedule.touched[[3, 3 + ANGLES // 2]] = 1
    assert schedule.take_all().tolist() == [3]
    assert not schedule.touched.any()


def test_angles_within_the_skew_are_incomplete_and_those_changed_since() -> None:
    schedule = Schedule(PSI, GAMMA, STEP)
    newest = np.pi
    found = schedule.incomplete(newest, 1)
    behind = newest - PSI
    np.testing.assert_array_equal(found, (behind > -SKEW) & (behind < SKEW + 1.5 * STEP))
    schedule.touched[0] = 1
    assert schedule.incomplete(newest, 1)[0]
