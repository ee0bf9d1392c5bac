"""A camera's clock against the print's: analytic drift, delay and jitter."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.devices.cameras.timing import DeviceTime, FrameNumbers

RATE_HZ = 10.0
LEAST_DELAY_S = 0.012


def observed(seconds: float, *, drift: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True times, the stamps of a camera whose clock runs otherwise, and arrivals late by a delay that varies."""
    rng = np.random.default_rng(seed)
    true_s = 1000.0 + np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    stamps = 1.7e9 + (true_s - 1000.0) * (1 + drift)
    # A quarter of the frames wait behind others, now and then for long, as on a machine that is busy.
    late = rng.exponential(0.003, len(true_s)) + (rng.uniform(size=len(true_s)) < 0.25) * rng.exponential(
        0.03, len(true_s)
    )
    return true_s, stamps, true_s + LEAST_DELAY_S + late


@pytest.mark.parametrize("drift", [0.0, 1e-4, -1e-4])
def test_jitter_of_transport_does_not_enter_the_time_of_a_frame(drift: float) -> None:
    true_s, stamps, arrivals = observed(300.0, drift=drift)
    clock = DeviceTime()
    told = np.array([clock.to_clock(stamp, arrival) for stamp, arrival in zip(stamps, arrivals, strict=True)])
    error = told - true_s - LEAST_DELAY_S
    # At 20 deg/s a millisecond is 0.02 deg, a fifth of what a tenth of a voxel at the rim is seen under.
    assert np.abs(error[50:]).max() < 1e-3
    assert np.abs(error[600:]).max() < 5e-4
    assert clock.jumps == 0


def test_the_first_frames_are_good_to_the_delay_of_the_quickest_of_them() -> None:
    true_s, stamps, arrivals = observed(2.0, drift=1e-4)
    clock = DeviceTime()
    told = [clock.to_clock(stamp, arrival) for stamp, arrival in zip(stamps, arrivals, strict=True)]
    assert told[0] == arrivals[0]
    assert told[-1] - true_s[-1] == pytest.approx((arrivals - true_s).min(), abs=3e-4)


@pytest.mark.parametrize("jump_s", [-3600.0, -0.4, 0.4, 3600.0])
def test_a_stamp_that_was_set_is_learnt_anew(jump_s: float) -> None:
    true_s, stamps, arrivals = observed(60.0)
    stamps[200:] += jump_s
    clock = DeviceTime()
    told = [clock.to_clock(s, a, 1 / RATE_HZ) for s, a in zip(stamps, arrivals, strict=True)]
    error = np.array(told) - true_s - LEAST_DELAY_S
    assert clock.jumps == 1
    assert error[200] == pytest.approx(arrivals[200] - true_s[200] - LEAST_DELAY_S, abs=1e-6)
    assert np.abs(error[240:]).max() < 3e-3


def test_a_program_that_was_held_up_for_a_second_moves_no_frame() -> None:
    true_s, stamps, arrivals = observed(60.0)
    held = (true_s > 1020.0) & (true_s < 1021.0)
    arrivals[held] = 1021.0 + LEAST_DELAY_S
    clock = DeviceTime()
    told = [clock.to_clock(s, a, 1 / RATE_HZ) for s, a in zip(stamps, arrivals, strict=True)]
    assert clock.jumps == 0
    assert np.abs(np.array(told) - true_s - LEAST_DELAY_S)[50:].max() < 1e-3


def test_lost_frames_and_frames_out_of_order_are_no_jumps() -> None:
    true_s, stamps, arrivals = observed(20.0)
    order = [k for k in range(200) if k % 7]
    order[50], order[51] = order[51], order[50]
    clock, last = DeviceTime(), -1
    for k in order:
        assert clock.to_clock(stamps[k], arrivals[k], (k - last) / RATE_HZ) == pytest.approx(
            true_s[k] + LEAST_DELAY_S, abs=0.02
        )
        last = max(last, k)
    assert clock.jumps == 0


def test_a_stamp_that_stands_still_leaves_the_time_of_arrival() -> None:
    clock = DeviceTime()
    assert [clock.to_clock(5.0, 0.1 * k, 0.1) for k in range(4)] == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_without_stamps_the_count_of_frames_is_the_clock() -> None:
    """The period is a hundredth longer than the camera says."""
    _, _, arrivals = observed(120.0)
    arrivals = 1000.0 + (arrivals - 1000.0) * 1.01
    clock = DeviceTime(largest_drift=0.02)
    told = [clock.to_clock(k / RATE_HZ, arrival) for k, arrival in enumerate(arrivals)]
    true_s = 1000.0 + 1.01 * (np.arange(len(arrivals)) / RATE_HZ + LEAST_DELAY_S)
    assert np.abs(np.array(told) - true_s)[100:].max() < 1.5e-3


def test_numbers_leave_out_what_was_lost_across_the_wrap_of_16_bits() -> None:
    numbers = FrameNumbers()
    ids = [65530, 65531, 65534, 65535, 1, 2, 5]
    assert [numbers.next(frame_id, 1.0) for frame_id in ids] == [0, 1, 4, 5, 6, 7, 10]


def test_ids_of_64_bits_do_not_wrap_at_16() -> None:
    numbers = FrameNumbers()
    assert [numbers.next(frame_id, 1.0) for frame_id in (65535, 65536, 65537, 70000)] == [0, 1, 2, 4465]


def test_frames_out_of_order_keep_their_numbers() -> None:
    numbers = FrameNumbers()
    assert [numbers.next(frame_id, 1.0) for frame_id in (7, 9, 8, 10)] == [0, 2, 1, 3]


def test_a_camera_that_came_back_goes_on_by_the_time_that_has_passed() -> None:
    numbers = FrameNumbers()
    assert [numbers.next(frame_id, 1.0) for frame_id in (700, 701)] == [0, 1]
    numbers.restart()
    assert [numbers.next(1, 34.2), numbers.next(2, 1.0)] == [35, 36]


@pytest.mark.parametrize("ids", [[None] * 4, [0] * 4], ids=["none", "one that stands still"])
def test_without_ids_frames_are_counted_by_time(ids: list[int | None]) -> None:
    numbers = FrameNumbers()
    assert [numbers.next(i, p) for i, p in zip(ids, (0.0, 1.1, 2.9, 0.6), strict=True)] == [0, 1, 4, 5]
