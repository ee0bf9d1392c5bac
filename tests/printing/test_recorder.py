"""What the recorder makes of frames that come late, and of stamps that jump."""

from __future__ import annotations

import queue
import time
from pathlib import Path

import numpy as np
import pytest

from vialight.devices import CameraFrame, DeviceLostError, DeviceTimeoutError
from vialight.links import CameraImage
from vialight.printing import EventLog, Recorder

RATE_HZ = 10.0


class HandClock:
    """A clock that a test turns by hand."""

    rate = 1.0

    def __init__(self) -> None:
        self.time_s = 50.0

    def now_s(self) -> float:
        return self.time_s


class HandCamera:
    """Hands over what a test has put."""

    image_shape = (2, 3)
    full_level = 255

    def __init__(self) -> None:
        self.frames: queue.Queue[CameraFrame] = queue.Queue()
        self.trouble: str | None = None

    def start(self, frame_rate_hz: float) -> None:
        pass

    def next_frame(self, timeout_s: float) -> CameraFrame:
        try:
            return self.frames.get(timeout=timeout_s)
        except queue.Empty:
            if self.trouble:
                raise DeviceLostError("camera", self.trouble) from None
            raise DeviceTimeoutError("camera", "no frame") from None

    def close(self) -> None:
        pass


def recorded_times(folder: Path, arrivals: list[tuple[float, float]]) -> np.ndarray:
    """Let frames with these (stamp, arrival) come, all numbered one after the other; return the times recorded."""
    clock, camera, seen = HandClock(), HandCamera(), list[CameraImage]()
    log = EventLog(folder / "log.jsonl", clock)
    recorder = Recorder(camera, clock, RATE_HZ, lambda time_s: 0.0, log, seen.append)
    recorder.start()
    try:
        for number, (stamp_s, arrival_s) in enumerate(arrivals):
            clock.time_s = arrival_s
            camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), stamp_s, number))
            deadline = time.monotonic() + 5.0
            while len(seen) <= number:
                assert time.monotonic() < deadline
                time.sleep(0.001)
    finally:
        recorder.close()
    return np.array([image.time_s for image in seen])


def test_frames_that_were_held_up_keep_their_own_times(tmp_path: Path) -> None:
    stamps = 50.0 + np.arange(40) / RATE_HZ
    arrivals = stamps + 0.02
    arrivals[20:32] = np.maximum(arrivals[20:32], stamps[32])  # a second in which nothing was handed over
    times = recorded_times(tmp_path, list(zip(stamps.tolist(), arrivals.tolist(), strict=True)))
    np.testing.assert_allclose(times, stamps)
    assert not (tmp_path / "log.jsonl").exists()


@pytest.mark.parametrize("jump_s", [-30.0, 100.0])
def test_a_stamp_that_jumps_is_replaced_by_the_time_of_arrival_less_the_usual_delay(
    tmp_path: Path, jump_s: float
) -> None:
    true = 50.0 + np.arange(40) / RATE_HZ
    stamps = np.where(np.arange(40) < 20, true, true + jump_s)
    times = recorded_times(tmp_path, list(zip(stamps.tolist(), (true + 0.02).tolist(), strict=True)))
    np.testing.assert_allclose(times, true, atol=1e-9)
    assert "its time is off by" in (tmp_path / "log.jsonl").read_text()


def test_the_fault_of_a_camera_that_is_silent_says_why_where_that_is_known(tmp_path: Path) -> None:
    clock, camera = HandClock(), HandCamera()
    log = EventLog(tmp_path / "log.jsonl", clock)
    recorder = Recorder(camera, clock, RATE_HZ, lambda time_s: 0.0, log, lambda image: None)

    def wait_for_fault(told: str | None) -> None:
        deadline = time.monotonic() + 5.0
        while recorder.camera_fault() != told:
            assert time.monotonic() < deadline, recorder.camera_fault()
            time.sleep(0.001)

    recorder.start()
    try:
        wait_for_fault("no frame yet")
        camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), clock.time_s, 0))
        wait_for_fault(None)
        clock.time_s += 0.3
        wait_for_fault("silent")
        clock.time_s += 2.0
        wait_for_fault("silent for 2 s")
        camera.trouble = "the link is lost (it was unplugged); looking for the camera"
        wait_for_fault(f"camera: {camera.trouble}")
        camera.trouble = None
        camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), clock.time_s, 1))
        wait_for_fault(None)
    finally:
        recorder.close()
