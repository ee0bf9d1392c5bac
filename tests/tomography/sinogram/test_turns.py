"""Which frames make a turn, whatever the stage's habits of counting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError
from vialight.tomography.sinogram.turns import check_gaps, nominal_step, select_turn, sorted_turn


def degrees(first: float, step: float, count: int) -> FloatArray:
    return np.radians(first + step * np.arange(count, dtype=np.float64))


@given(
    turns=st.integers(1, 5),
    per_turn=st.integers(12, 60),
    extra=st.floats(0, 0.9),
    first=st.floats(-720, 720),
    sense=st.sampled_from([1, -1]),
    wrapped=st.booleans(),
)
def test_every_turn_is_found_rising_or_falling_cumulative_or_wrapped(
    turns: int, per_turn: int, extra: float, first: float, sense: int, wrapped: bool
) -> None:
    # Up to 15 deg short of its end a turn counts as full, see below: `extra` stays clear of that.
    count = turns * per_turn + int(extra * (per_turn - max(1, per_turn / 24 + 1)))
    angles = degrees(first, sense * 360 / per_turn, count)
    if wrapped:
        angles = np.mod(angles, 2 * np.pi)
    np.testing.assert_array_equal(select_turn(angles), np.arange(count - per_turn, count))
    last = np.arange((turns - 1) * per_turn, turns * per_turn)
    for turn in range(1, turns + 1):
        np.testing.assert_array_equal(select_turn(angles, turn), last - (turns - turn) * per_turn)


def test_less_than_a_turn_is_taken_whole() -> None:
    np.testing.assert_array_equal(select_turn(degrees(10, 2, 91)), np.arange(91))
    np.testing.assert_array_equal(select_turn(degrees(10, -2, 91), 1), np.arange(91))


def test_half_a_turn_with_both_ends_is_kept_whole() -> None:
    assert len(select_turn(degrees(0, 1, 181))) == 181


def test_a_frame_at_360_deg_begins_the_next_turn() -> None:
    np.testing.assert_array_equal(select_turn(degrees(0, 2, 181), 1), np.arange(180))
    np.testing.assert_array_equal(select_turn(degrees(0, 2, 181)), np.arange(1, 181))


@pytest.mark.parametrize("turn", [0, -1, 3])
def test_a_turn_that_is_not_there_is_refused_with_those_that_are(turn: int) -> None:
    with pytest.raises(InputError, match=r"--turn: is -?\d, the frames span 718.0 deg; accepted: 1 to 2"):
        select_turn(degrees(0, 2, 360), turn)


def test_the_last_turn_ends_with_the_last_frame_wherever_in_a_turn_that_is() -> None:
    np.testing.assert_array_equal(select_turn(degrees(0, 2, 500)), np.arange(320, 500))


def test_a_turn_is_full_though_its_last_frames_are_missing_or_early() -> None:
    angles = degrees(0, 2, 540)
    np.testing.assert_array_equal(select_turn(angles[:-2], 3), np.arange(360, 538))
    angles[-1] -= np.radians(0.4)
    np.testing.assert_array_equal(select_turn(angles), np.arange(360, 540))


def test_jitter_at_the_seam_moves_no_frame_into_another_turn() -> None:
    rng = np.random.default_rng(0)
    angles = degrees(0, 2, 540) + np.radians(rng.uniform(-0.45, 0.45, 540))
    angles[0] = 0
    for turn in (1, 2, 3):
        np.testing.assert_array_equal(select_turn(angles, turn), np.arange((turn - 1) * 180, turn * 180))


def test_frames_that_came_in_the_wrong_order_are_in_their_turn() -> None:
    angles = degrees(0, 2, 360)
    angles[[100, 101]] = angles[[101, 100]]
    angles[[200, 203]] = angles[[203, 200]]
    np.testing.assert_array_equal(select_turn(angles), np.arange(180, 360))


@pytest.mark.parametrize("sense", [1, -1])
def test_frames_of_several_turns_in_any_order_are_told_apart_by_angles_that_count_on(sense: int) -> None:
    angles = degrees(10, 2 * sense, 540)
    # Slices, so that the way the stage turns still shows.
    order = np.concatenate([np.random.default_rng(0).permutation(270), 270 + np.random.default_rng(1).permutation(270)])
    for turn in (1, 2, 3):
        chosen = order[select_turn(angles[order], turn)]
        np.testing.assert_array_equal(np.sort(chosen), np.arange((turn - 1) * 180, turn * 180))


def test_shuffled_angles_that_begin_anew_with_each_turn_are_refused() -> None:
    angles = np.random.default_rng(0).permutation(np.mod(degrees(10, 2, 540), 2 * np.pi))
    with pytest.raises(InputError, match=r"/exchange/theta: angles go back and forth .* accepted: frames in order"):
        select_turn(angles)


def test_angles_that_never_change_are_refused() -> None:
    with pytest.raises(InputError, match="/exchange/theta: all angles are the same"):
        select_turn(np.ones(5))


def test_the_nominal_step_is_that_between_neighbours_whatever_is_missing_or_double() -> None:
    angles = np.repeat(degrees(0, 2, 180), 2)[np.r_[0:100, 120:360]]
    assert nominal_step(angles) == pytest.approx(np.radians(2))


@given(st.permutations(range(12)), st.floats(-100, 100))
def test_sorting_brings_any_order_and_any_count_of_turns_into_one(order: list[int], first: float) -> None:
    angles = (degrees(first, 30, 12) + 2 * np.pi * np.arange(12))[order]
    indices, found = sorted_turn(angles)
    assert (np.diff(found) > 0).all()
    assert found[0] >= 0
    assert found[-1] < 2 * np.pi
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * angles[indices]), rtol=0, atol=2e-6)
    assert sorted(indices) == list(range(12))


def test_of_frames_at_one_angle_the_last_stays() -> None:
    indices, _ = sorted_turn(np.radians([0, 90, 180, 90, 270, 360]))
    np.testing.assert_array_equal(indices, [5, 3, 2, 4])
    # Rounding may leave an angle just short of a turn.
    indices, angles = sorted_turn(np.array([0.0, 2.0, 4.0, 2 * np.pi - 1e-9, -1e-26]))
    np.testing.assert_array_equal(indices, [4, 1, 2])
    np.testing.assert_array_equal(angles, [0, 2, 4])


@pytest.mark.parametrize("first", [0.0, 100.0, 350.0])
@pytest.mark.parametrize(("missing", "fits"), [(14, True), (15, False)])
def test_gaps_of_up_to_30_deg_are_allowed_wherever_they_are(first: float, missing: int, fits: bool) -> None:
    _, angles = sorted_turn(degrees(first, 2, 180 - missing))
    if fits:
        check_gaps(angles, half_turn_suffices=False)
        return
    with pytest.raises(InputError, match=r"no frames for 32.0 deg after .*gaps of up to 30 deg"):
        check_gaps(angles, half_turn_suffices=False)


def test_half_a_turn_suffices_for_parallel_rays_only() -> None:
    _, angles = sorted_turn(degrees(0, 1, 180))
    check_gaps(angles, half_turn_suffices=True)
    with pytest.raises(InputError, match=r"no frames for 181.0 deg after 179.0 deg"):
        check_gaps(angles, half_turn_suffices=False)
    with pytest.raises(InputError, match=r"accepted: half a turn or more"):
        check_gaps(angles[:-5], half_turn_suffices=True)
