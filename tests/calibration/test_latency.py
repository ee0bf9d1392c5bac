"""Delays are found from recordings in which they are known."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.calibration.latency.estimator import Turn, delay_between_camera_and_stage, delay_of_flashes
from vialight.core.arrays import TURN_RAD, FloatArray
from vialight.core.errors import InputError

SPEED = float(np.radians(20.0))


def recorded(speed: float, delay_s: float, seed: int, *, is_round: bool = False) -> Turn:
    """A turn of three blobs of different depth and brightness, in 60 columns, with noise; the angles are late."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, TURN_RAD / abs(speed) + 0.2, 0.1) + rng.uniform(0, 0.1)
    true = speed * times
    columns = np.linspace(-8, 8, 60)
    blobs = [(0.0, 0.0, 3.0)] if is_round else [(5.0, 0.3, 1.5), (3.0, 2.1, 1.0), (6.0, 4.0, 0.7)]
    images = sum(
        (100 + 20 * k) * np.exp(-(((columns - radius * np.sin(true[:, None] + phase)) / width) ** 2))
        * (1 + 0.2 * np.cos(true[:, None] + phase))
        for k, (radius, phase, width) in enumerate(blobs)
    ) if not is_round else np.tile(100 * np.exp(-((columns / 3.0) ** 2)), (len(times), 1))  # fmt: skip
    images = images + rng.normal(0, 2.0, (len(times), len(columns)))
    return Turn(np.asarray(images), true + speed * delay_s, times)


@pytest.mark.parametrize("delay_s", [-0.03, 0.0, 0.05])
@pytest.mark.parametrize("other", [-1.0, 2.0])
def test_delay_is_found_from_turns_both_ways_or_at_two_speeds_to_a_millisecond(delay_s: float, other: float) -> None:
    found = delay_between_camera_and_stage(recorded(SPEED, delay_s, 1), recorded(other * SPEED, delay_s, 2))
    assert found.value == pytest.approx(delay_s, abs=1e-3)
    assert abs(found.value - delay_s) < 4 * found.uncertainty + 2e-4


def test_turns_at_one_speed_and_round_things_say_nothing() -> None:
    with pytest.raises(InputError, match=r"turn at 20\.00 and 20\.00 deg/s; accepted: speeds that differ"):
        delay_between_camera_and_stage(recorded(SPEED, 0.0, 1), recorded(SPEED, 0.0, 2))
    with pytest.raises(InputError, match="look alike from all sides"):
        delay_between_camera_and_stage(recorded(SPEED, 0.0, 1, is_round=True), recorded(-SPEED, 0.0, 2, is_round=True))


def flashes_seen(delay_s: float, noise: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(4)
    begin = 1.0 + 1.1 * np.arange(8) + rng.uniform(0, 0.1, 8)
    flashes = np.stack([begin, begin + 0.5], axis=1)
    times = np.arange(0.0, 11.0, 0.1)
    fine = np.linspace(-0.02, 0.02, 401) + times[:, None]
    lit = ((fine[..., None] >= flashes[:, 0] + delay_s) & (fine[..., None] < flashes[:, 1] + delay_s)).any(axis=-1)
    return times, 40 + 100 * lit.mean(axis=1) + rng.normal(0, noise, len(times)), flashes


@pytest.mark.parametrize("delay_s", [0.0, 0.023, 0.11])
def test_flashes_are_found_late_by_their_delay(delay_s: float) -> None:
    times, brightness, flashes = flashes_seen(delay_s, 1.0)
    found = delay_of_flashes(times, brightness, 0.04, flashes)
    assert found.value == pytest.approx(delay_s, abs=2e-3)
    assert abs(found.value - delay_s) < 4 * found.uncertainty + 2e-4


def test_flashes_that_nobody_sees_are_refused() -> None:
    times, brightness, flashes = flashes_seen(0.0, 1.0)
    with pytest.raises(InputError, match="are not seen in the frames"):
        delay_of_flashes(times, np.random.default_rng(0).normal(40, 1, len(times)), 0.04, flashes)
    with pytest.raises(InputError, match="are 2; accepted: 3 at least"):
        delay_of_flashes(times, brightness, 0.04, flashes[:2])
