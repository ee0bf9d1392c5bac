"""Where the stage was when a frame was exposed."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from vialight.devices import StagePosition
from vialight.printing.track import StageTrack

pytestmark = pytest.mark.alone

SPEED = float(np.radians(20.0))


def test_angle_of_a_frame_waits_for_the_position_after_it() -> None:
    track = StageTrack()
    for k in range(5):  # told with jitter, so that the speed is known badly
        time_s = 0.025 * k
        track.add(StagePosition(SPEED * time_s, time_s + (0.01 if k == 4 else 0.0)))

    def tell_later() -> None:
        time.sleep(0.02)
        track.add(StagePosition(SPEED * 0.15, 0.15))

    teller = threading.Thread(target=tell_later)
    teller.start()
    angle = track.settled_angle_at(0.14)
    teller.join()
    assert angle == track.angle_at(0.14)
    assert abs(angle - SPEED * 0.14) < SPEED * 0.01


def test_angle_of_a_frame_does_not_wait_for_a_stage_that_has_been_silent_and_is_not_made_up() -> None:
    track = StageTrack()
    assert np.isnan(track.settled_angle_at(1.0))
    for k in range(3):
        track.add(StagePosition(SPEED * 0.1 * k, 0.1 * k))
    time.sleep(0.35)
    begin = time.monotonic()
    for _ in range(100):
        assert np.isnan(track.settled_angle_at(5.0))
    assert time.monotonic() - begin < 0.2


def test_no_angle_is_told_beyond_the_positions_but_for_a_short_span() -> None:
    track = StageTrack()
    for k in range(1000):
        track.add(StagePosition(SPEED * 0.025 * k, 0.025 * k))
    last_s = 0.025 * 999
    assert track.angle_at(last_s + 0.019) == pytest.approx(SPEED * (last_s + 0.019))
    assert np.isnan(track.angle_at(last_s + 0.021))
    assert np.isnan(track.angle_at(1.0))  # its positions are kept no longer
    assert track.turned_rad(last_s - 0.1, last_s + 0.1) == pytest.approx(0.2 * SPEED)


def test_angle_in_a_gap_in_which_the_stage_was_not_heard_is_not_known() -> None:
    """The process that prints was stopped for a while: the stage may have done anything."""
    track = StageTrack(longest_gap_s=0.5)
    for time_s in (0.0, 0.1, 0.2, 1.2, 1.3):
        track.add(StagePosition(2 * time_s, time_s))
    assert track.angle_at(0.15) == pytest.approx(0.3)
    assert track.angle_at(1.25) == pytest.approx(2.5)
    assert np.isnan([track.angle_at(time_s) for time_s in (0.25, 0.7, 1.19)]).all()
    assert track.turned_rad(0.1, 1.3) == pytest.approx(2.4)  # of light, turns are counted all the same
