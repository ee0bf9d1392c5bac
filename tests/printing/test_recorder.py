"""What the recorder makes of frames that come late, and of stamps that jump."""

from __future__ import annotations

import itertools
import queue
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vialight.core.messages import CameraImage
from vialight.devices import CameraFrame, DeviceError, DeviceLostError, DeviceTimeoutError, StagePosition
from vialight.printing.log import EventLog
from vialight.printing.recorder import Recorder
from vialight.printing.track import StageTrack
from vialight.store import FrameWriter, open_frames
from vialight.system import wait_for

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
        log.close(5.0)
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


class SlowWriter(FrameWriter):
    """A disk that takes its time: as long as the next of the delays, or until it is let go."""

    def __init__(self, *given: Any, delays_s: list[float], gate: threading.Event | None = None, **named: Any) -> None:
        super().__init__(*given, **named)
        self._delays_s, self._gate = itertools.cycle(delays_s), gate

    def append(self, *given: Any) -> None:
        if self._gate is not None:
            assert self._gate.wait(30)
        time.sleep(next(self._delays_s))
        super().append(*given)


def motion(time_s: Any) -> Any:
    """A stage that does not turn evenly; its acceleration is at most 4 rad/s2."""
    return 0.5 * np.asarray(time_s) + 0.01 * np.sin(20 * np.asarray(time_s))


@settings(max_examples=15, deadline=None)
@given(
    delays_s=st.lists(st.sampled_from([0.0, 0.001, 0.004, 0.03]), min_size=1, max_size=4),
    silent=st.lists(st.integers(5, 75), max_size=2),
)
def test_whatever_the_disk_delays_an_angle_is_that_of_its_frame_or_the_frame_is_refused(
    delays_s: list[float], silent: list[int]
) -> None:
    # Every position is told once, and forgotten a quarter of a second of the print's clock later.
    clock, camera, track = HandClock(), HandCamera(), StageTrack()
    track._positions = type(track._positions)(maxlen=12)
    with tempfile.TemporaryDirectory() as folder:
        log = EventLog(Path(folder) / "log.jsonl", clock)
        recorder = Recorder(camera, clock, 50.0, track.settled_angle_at, log, lambda image: None)
        path = Path(folder) / "frames.h5"
        writer = SlowWriter(path, (2, 3), delays_s=delays_s, sync_every_s=None)
        recorder.write_to(writer)
        recorder.start()
        for number in range(80):
            clock.time_s = 50.0 + 0.02 * number
            if not any(begin <= number < begin + 8 for begin in silent):
                track.add(StagePosition(float(motion(clock.time_s + 0.001)), clock.time_s + 0.001))
            camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), clock.time_s, number))
            time.sleep(0.002)
        clock.time_s += 0.02
        track.add(StagePosition(float(motion(clock.time_s)), clock.time_s))
        assert wait_for(camera.frames.empty, timeout_s=10) is None
        recorder.close()
        log.close(5.0)
        with open_frames(path) as frames:
            assert frames.time_s is not None
            assert len(frames.angles_rad) + recorder.refused == 80
            # A straight line is off by an eighth of the acceleration and the square of the step, here 0.18 s at most.
            error = np.abs(frames.angles_rad - motion(frames.time_s))
        assert error.max(initial=0.0) < 4 * 0.18**2 / 8 + 0.001
        if recorder.refused:
            assert "refused" in (Path(folder) / "log.jsonl").read_text()


def test_frames_that_wait_for_the_disk_longer_than_positions_are_kept_have_their_own_angles(tmp_path: Path) -> None:
    clock, camera, track, gate = HandClock(), HandCamera(), StageTrack(), threading.Event()
    log = EventLog(tmp_path / "log.jsonl", clock)
    recorder = Recorder(camera, clock, RATE_HZ, track.settled_angle_at, log, lambda image: None)
    path = tmp_path / "frames.h5"
    recorder.write_to(SlowWriter(path, (2, 3), delays_s=[0.0], gate=gate))
    recorder.start()
    told = []
    for number in range(800):
        clock.time_s = 50.0 + 0.025 * number
        track.add(StagePosition(float(motion(clock.time_s)), clock.time_s))
        if number % 4 == 2:
            camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), clock.time_s - 0.01, number // 4))
            time.sleep(0.002)
            told.append(recorder.disk_fault())
    assert wait_for(camera.frames.empty, timeout_s=10) is None
    assert told[0] is None
    assert "behind the camera" in str(told[-1])  # which the light goes by
    gate.set()
    recorder.close()
    log.close(5.0)
    with open_frames(path) as frames:
        assert frames.time_s is not None
        assert len(frames.angles_rad) == 200 - recorder.refused >= 199
        assert np.abs(frames.angles_rad - motion(frames.time_s)).max() < 1e-3


def test_to_change_files_has_an_end_and_what_waits_goes_into_the_old_one(tmp_path: Path) -> None:
    clock, camera, gate = HandClock(), HandCamera(), threading.Event()
    log = EventLog(tmp_path / "log.jsonl", clock)
    recorder = Recorder(camera, clock, RATE_HZ, lambda time_s: 0.5, log, lambda image: None)
    old, new = tmp_path / "old.h5", tmp_path / "new.h5"
    recorder.write_to(SlowWriter(old, (2, 3), delays_s=[0.0], gate=gate))
    recorder.start()
    for number in range(20):
        camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), clock.time_s, number))
    assert wait_for(lambda: recorder.lag_s >= 1.8, timeout_s=10) is None
    with pytest.raises(DeviceError, match=r"not within 0\.2 s"):
        recorder.write_to(FrameWriter(new, (2, 3)), timeout_s=0.2)
    assert recorder.sync(0.1) == "not within 0.1 s"
    gate.set()
    assert recorder.sync(10.0) is None
    camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), clock.time_s, 20))
    assert wait_for(lambda: recorder.written == 1, timeout_s=10) is None
    assert recorder.write_to(None) == 1
    recorder.close()
    with open_frames(old) as frames:
        assert frames.shape[0] == 20


def test_to_close_has_an_end_and_tells_what_is_not_written(tmp_path: Path) -> None:
    clock, camera, gate = HandClock(), HandCamera(), threading.Event()
    log = EventLog(tmp_path / "log.jsonl", clock)
    recorder = Recorder(camera, clock, RATE_HZ, lambda time_s: 0.5, log, lambda image: None)
    recorder.write_to(SlowWriter(tmp_path / "f.h5", (2, 3), delays_s=[0.0], gate=gate))
    recorder.start()
    for number in range(5):
        camera.frames.put(CameraFrame(np.zeros((2, 3), np.uint16), clock.time_s, number))
    assert wait_for(camera.frames.empty, timeout_s=10) is None
    begun = time.monotonic()
    recorder.close(0.3)
    assert time.monotonic() - begun < 2.0
    log.close(5.0)
    assert "frames are not written" in (tmp_path / "log.jsonl").read_text()
    gate.set()
