"""A recording as devices: its frames and its stage come again, at the times at which they came."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from vialight.core.errors import InputError
from vialight.devices.protocols import CameraFrame, Clock, DeviceError, DeviceTimeoutError, StagePosition
from vialight.store import open_frames

_POLL_S = 0.02
DEFAULT_RATE_HZ = 10.0
"""Of recordings without times."""


class ReplayCamera:
    """A camera that hands out the frames of a recording, each when its time has come.

    Parameters
    ----------
    path
        The recording.
    clock
        The print's.

    Attributes
    ----------
    count : int
        Frames that there are.

    Raises
    ------
    InputError
        It cannot be read, holds no integers, or its times do not rise.
    """

    def __init__(self, path: str | Path, clock: Clock) -> None:
        self._frames, self._clock = open_frames(path), clock
        if self._frames.dtype.kind != "u" or self._frames.dtype.itemsize > 2:
            raise InputError(path, f"holds {self._frames.dtype}", accepted="a camera's counts of up to 16 bits")
        self.count, *shape = self._frames.shape
        self.image_shape = (shape[0], shape[1])
        times = self._frames.time_s
        self.times_s = np.arange(self.count) / DEFAULT_RATE_HZ if times is None else times - times[0]
        if not np.isfinite(self.times_s).all():
            raise InputError(f"{path} /exchange/time", "holds values that are not finite", accepted="seconds")
        self.angles_rad = self._frames.angles_rad
        self.full_level = int(np.iinfo(self._frames.dtype).max)
        self._next = 0
        self.started_s = float("inf")

    def start(self, frame_rate_hz: float) -> None:
        """Begin; the recording's own times count, not the rate."""
        self.started_s, self._next = self._clock.now_s(), 0

    def next_frame(self, timeout_s: float) -> CameraFrame:
        """Return the next frame when its time has come."""
        deadline = time.monotonic() + timeout_s
        if self._next >= self.count:
            time.sleep(timeout_s)
            raise DeviceTimeoutError("camera", "the recording is over")
        due = self.started_s + float(self.times_s[self._next])
        while (left := (due - self._clock.now_s()) / self._clock.rate) > 0:
            if time.monotonic() + min(left, _POLL_S) > deadline:
                raise DeviceTimeoutError("camera", f"no frame within {timeout_s:g} s")
            time.sleep(min(left, _POLL_S))
        try:
            counts = self._frames.read(slice(self._next, self._next + 1))[0].astype(np.uint16, copy=False)
        except InputError as error:
            raise DeviceError("camera", str(error)) from error
        self._next += 1
        return CameraFrame(counts, due, self._next - 1)

    @property
    def is_over(self) -> bool:
        """Whether all frames have been handed out."""
        return self._next >= self.count

    def close(self) -> None:
        """Close the recording."""
        self._frames.close()


class ReplayStage:
    """A stage that stands where it stood when the frames were taken.

    Parameters
    ----------
    camera
        Of the same recording.
    clock
        The print's.
    """

    def __init__(self, camera: ReplayCamera, clock: Clock) -> None:
        self._camera, self._clock = camera, clock
        order = np.argsort(camera.times_s, kind="stable")
        # Angles may begin anew with each turn; between frames they must not jump.
        self._times, self._angles = camera.times_s[order], np.unwrap(camera.angles_rad[order])

    def start(self, speed_rad_s: float) -> None:
        """Turn as it turned; the speed is the recording's."""

    def angle_at(self, time_s: float) -> float:
        """Return the angle at a time of the print's clock, rad."""
        return float(np.interp(time_s - self._camera.started_s, self._times, self._angles))

    def position(self, timeout_s: float) -> StagePosition:
        """Return where the stage is."""
        now = self._clock.now_s()
        return StagePosition(self.angle_at(now), now)

    def stop(self) -> None:
        """Do nothing: what is recorded has happened."""

    def close(self) -> None:
        """Do nothing."""
