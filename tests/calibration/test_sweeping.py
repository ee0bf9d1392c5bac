"""A sweep through any devices that keep the contracts; here ones that answer at once, on a clock of their own."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.calibration.projector.sweeping import record_sweep
from vialight.devices import CameraFrame, DeviceError, Devices, DeviceTimeoutError, Lease, Shown, StagePosition

SPEED, LINES = 0.5, 8


class Bench:
    """Clock, camera, stage and projector in one; every frame shows the number of its pattern, or the dark."""

    rate = 1.0
    image_shape = (2, 3)
    full_level = 4095

    def __init__(self, *, silent_after: int = 10**6, late: range = range(0)) -> None:
        self.time_s, self.number, self.silent_after, self.late = 0.0, 0, silent_after, late
        self.lease: Lease | None = None
        self.since_s = 0.0
        self.pattern: int | None = None
        self.is_turning = False

    def now_s(self) -> float:
        return self.time_s

    def start(self, rate: float) -> None:
        self.is_turning = True

    def next_frame(self, timeout_s: float) -> CameraFrame:
        if self.number >= self.silent_after:
            self.time_s += timeout_s
            raise DeviceTimeoutError("camera", "is silent")
        self.time_s += 0.1
        self.number += 1
        shown = 60 if self.pattern is None else 100 + self.pattern
        return CameraFrame(np.full(self.image_shape, shown, np.uint16), self.time_s, self.number - 1)

    def position(self, timeout_s: float) -> StagePosition:
        if self.number in self.late:
            self.time_s += timeout_s
            raise DeviceTimeoutError("stage", "takes long to answer")
        return StagePosition(SPEED * self.time_s, self.time_s)

    def stop(self) -> None:
        self.is_turning = False

    def renew(self, lease: Lease) -> None:
        self.lease = lease
        pattern = int(np.rint(lease.angle_rad / (2 * np.pi / LINES))) % LINES
        if pattern != self.pattern:
            self.pattern, self.since_s = pattern, self.time_s

    def darken(self) -> None:
        self.lease, self.pattern = None, None

    def end(self) -> None:
        self.darken()

    def shown(self) -> Shown:
        return Shown(self.pattern, self.since_s)

    def close(self) -> None:
        self.stop()


def test_every_line_is_seen_alone_and_the_light_goes_off() -> None:
    bench = Bench()
    swept = record_sweep(Devices(bench, bench, bench, bench), direction=1, speed_rad_s=SPEED)
    assert set(swept.pattern) == set(range(LINES))
    np.testing.assert_array_equal(swept.counts[:, 0, 0], 100 + swept.pattern)
    assert (swept.dark == 60).all()
    assert bench.lease is None
    assert not bench.is_turning


def test_a_camera_that_falls_silent_ends_the_sweep_in_the_dark() -> None:
    bench = Bench(silent_after=40)
    with pytest.raises(DeviceTimeoutError):
        record_sweep(Devices(bench, bench, bench, bench), direction=1, speed_rad_s=SPEED)
    assert bench.lease is None
    assert not bench.is_turning


def test_a_stage_that_is_late_for_a_moment_ends_nothing() -> None:
    bench = Bench(late=range(30, 34))
    swept = record_sweep(Devices(bench, bench, bench, bench), direction=1, speed_rad_s=SPEED)
    assert set(swept.pattern) == set(range(LINES))
    np.testing.assert_array_equal(swept.counts[:, 0, 0], 100 + swept.pattern)


def test_a_stage_that_falls_silent_ends_the_sweep_in_the_dark() -> None:
    bench = Bench(late=range(30, 10**6))
    with pytest.raises(DeviceTimeoutError, match="stage"):
        record_sweep(Devices(bench, bench, bench, bench), direction=1, speed_rad_s=SPEED)
    assert bench.lease is None
    assert not bench.is_turning


def test_a_sweep_that_is_interrupted_ends_in_the_dark() -> None:
    bench = Bench()
    with pytest.raises(DeviceError, match="before its time"):
        record_sweep(
            Devices(bench, bench, bench, bench), direction=1, speed_rad_s=SPEED, keep_going=lambda: bench.number < 30
        )
    assert bench.lease is None
