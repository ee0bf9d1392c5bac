"""Which frames make up the latest turn, and what lies about a new one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vialight.tomography.sliding.turn import LatestTurn

FRAMES = 36
STEP = 2 * np.pi / FRAMES


def fed(*angles: float) -> LatestTurn:
    turn = LatestTurn(FRAMES)
    for angle in angles:
        turn.place(angle)
    return turn


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("turns", [1, 3.4])
def test_no_more_than_a_turn_stays(turns: float, sense: int) -> None:
    turn = fed(*(sense * STEP * np.arange(turns * FRAMES)))
    assert len(turn) == FRAMES
    assert turn.sense == sense
    assert turn.newest_rad == pytest.approx(sense * STEP * (np.ceil(turns * FRAMES) - 1))


def test_neighbours_go_round_the_circle() -> None:
    turn = fed(*(0.1 + STEP * np.arange(FRAMES)))
    placing = turn.place(0.1 + STEP * FRAMES)
    assert placing is not None
    assert placing.angle_rad == pytest.approx(0.1)
    np.testing.assert_allclose(placing.offsets_rad, STEP * np.arange(-3, 4), atol=1e-12)
    assert placing.slots[3] == placing.slot
    assert len(set(placing.slots)) == 7


def test_neighbours_of_few_frames_are_the_same_a_turn_away() -> None:
    turn = fed(1.0)
    placing = turn.place(1.0 + STEP)
    assert placing is not None
    expected = np.array([-2 * np.pi - STEP, -2 * np.pi, -STEP, 0, 2 * np.pi - STEP, 2 * np.pi, 4 * np.pi - STEP])
    np.testing.assert_allclose(placing.offsets_rad, expected, atol=1e-12)


def test_a_late_frame_does_not_move_the_newest() -> None:
    turn = fed(0.0, STEP, 2 * STEP, 4 * STEP)
    assert turn.place(3 * STEP) is not None
    assert turn.newest_rad == pytest.approx(4 * STEP)


def test_after_a_stop_of_the_camera_the_frames_that_were_passed_over_are_gone() -> None:
    angles = STEP * np.arange(FRAMES)
    turn = fed(*angles, 2 * np.pi + 10 * STEP)
    assert len(turn) == FRAMES - 10


def test_a_stage_that_stands_still_keeps_one_frame() -> None:
    rng = np.random.default_rng(0)
    turn = fed(*(STEP * np.arange(5)))
    for _ in range(50):
        assert turn.place(4 * STEP + rng.uniform(-0.009, 0.009) * STEP) is not None
    assert len(turn) == 5


def test_a_stage_that_creeps_leaves_no_gap() -> None:
    """Frames take each other's place only where the first of them was, not all the way along."""
    creeping = STEP * np.arange(0, 4, 0.01)
    turn = LatestTurn(FRAMES)
    kept = [angle for angle in creeping if turn.place(angle) is not None]
    assert np.diff(kept).max() < 0.4 * STEP
    assert 10 <= len(turn) <= 13


def test_angles_that_count_turns_may_leap_more_than_half_a_turn() -> None:
    turn = fed(*(STEP * np.arange(1.5 * FRAMES)))
    turn.place(STEP * (1.5 * FRAMES - 1) + np.radians(250))
    assert turn.newest_rad == pytest.approx(STEP * (1.5 * FRAMES - 1) + np.radians(250))


@given(st.lists(st.floats(-0.9, 1.9), min_size=1, max_size=150))
@settings(max_examples=60, deadline=None)
def test_whatever_comes_neighbours_are_in_order_and_slots_are_not_shared(steps: list[float]) -> None:
    turn = LatestTurn(FRAMES)
    for angle in np.cumsum(steps) * STEP:
        placing = turn.place(float(angle))
        assert len(turn) <= turn.capacity
        if placing is not None:
            assert placing.offsets_rad[3] == 0
            assert (np.diff(placing.offsets_rad) >= 0).all()
            count = min(len(turn), 4)
            assert len(set(placing.slots[3 : 3 + count])) == count
            assert 0 <= placing.angle_rad <= 2 * np.pi
