"""A camera by GenICam, whatever carries its frames: settings, time, numbers, buffer, and a lost link found again."""

from __future__ import annotations

import contextlib
import math
import threading
import time
import warnings
from collections import deque

from vialight.core.config import CameraSettings
from vialight.core.errors import VialightError, VialightWarning
from vialight.devices.cameras.features import (
    Rounded,
    apply_settings,
    check_rate,
    enable_chunks,
    exposure_s,
    most_counts,
    set_frame_rate,
    settings_in_force,
)
from vialight.devices.cameras.links import Link, OpenLink, RawFrame
from vialight.devices.cameras.pixels import full_level, unpack
from vialight.devices.cameras.timing import DeviceTime, FrameNumbers
from vialight.devices.protocols import CameraFrame, Clock, DeviceError, DeviceLostError, DeviceTimeoutError

_KEPT_S = 3.0
_LEAST_KEPT = 16
_POLL_S = 0.05
_ASK_S = 1.0
"""Between looks whether a camera that sends nothing is still there."""
_SILENT_S, _SILENT_PERIODS = 2.0, 10
"""After which one that runs freely is taken for lost."""
_AGAIN_S = 1.0
"""Between attempts to reach it again."""
_JOIN_S = 10.0
_COUNTED_DRIFT = 0.02
"""By which the period of a camera without timestamps may differ from what it says."""


class GenicamCamera:
    """A camera that grabs on a thread of its own; `Camera` is the contract.

    Parameters
    ----------
    open_link
        Reaches it.
    settings
        Of the rig.
    clock
        The print's.

    Attributes
    ----------
    name : str
        Vendor, model and serial number.
    image_shape, full_level
        As in `Camera`.
    frame_rate_hz : float
        That the camera keeps, by itself or as it is triggered; 0 before `start`.
    rounded : list of Rounded
        Settings that it has otherwise than asked.
    exposure_s : float or None
        As last told by the camera.
    incomplete, overrun, links_lost : int
        Frames of which a part was lost on the way, frames that nobody asked for in time, and how often the link was
        lost.

    Raises
    ------
    DeviceError
        It cannot be reached, or does not take the settings.
    """

    def __init__(self, open_link: OpenLink, settings: CameraSettings, clock: Clock) -> None:
        self._open_link, self._settings, self._clock = open_link, settings, clock
        self._link: Link | None = open_link()
        self.frame_rate_hz = 0.0
        self.incomplete = self.overrun = self.links_lost = 0
        self._arrived: deque[CameraFrame] = deque()
        self._news = threading.Condition()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._trouble = ""
        self._is_free = settings.trigger == "free-running"
        try:
            self.name = self._link.name
            self.rounded: list[Rounded] = apply_settings(self._link.features, settings)
            features = self._link.features
            self._format = str(features.get("PixelFormat"))
            self.full_level = most_counts(features, full_level(self._format))
            self.image_shape = int(features.get("Height")), int(features.get("Width"))
            self.exposure_s = exposure_s(features)
            self._in_force = settings_in_force(features, settings)
        except BaseException:
            self._link.close()
            raise
        for one in self.rounded:
            warnings.warn(f"{self.name}: {one}", VialightWarning, stacklevel=2)

    def start(self, frame_rate_hz: float) -> None:
        """Begin to grab; numbers begin at 0, also where it was grabbing."""
        self._end_thread()
        self._ending.clear()
        if self._link is None:
            self._link = self._open_again()
        if not (math.isfinite(frame_rate_hz) and frame_rate_hz > 0):
            raise DeviceError(self.name, f"cannot grab {frame_rate_hz} frames/s")
        self.frame_rate_hz = frame_rate_hz
        self._arrived = deque(maxlen=max(_LEAST_KEPT, math.ceil(_KEPT_S * frame_rate_hz)))
        self._numbers = FrameNumbers()
        self._last_number, self._last_arrival_s = -1, self._clock.now_s()
        self._begin()
        self._thread = threading.Thread(target=self._run, name="genicam", daemon=True)
        self._thread.start()

    def next_frame(self, timeout_s: float) -> CameraFrame:
        """Return the oldest frame not yet handed over."""
        with self._news:
            if not self._news.wait_for(lambda: self._arrived, timeout_s):
                thread = self._thread
                if thread is None:  # who takes the frames may be there before the camera is started
                    raise DeviceTimeoutError(self.name, "is not grabbing")
                if not thread.is_alive():
                    raise DeviceError(self.name, self._trouble)
                if self._trouble:
                    raise DeviceLostError(self.name, self._trouble)
                raise DeviceTimeoutError(self.name, f"no frame within {timeout_s:g} s")
            return self._arrived.popleft()

    def close(self) -> None:
        """Stop and let go of the camera."""
        self._end_thread()
        self._drop_link()

    def _begin(self) -> None:
        """Start the camera, which is open and set."""
        assert self._link is not None
        features = self._link.features
        if self._is_free:
            self.frame_rate_hz = set_frame_rate(features, self.frame_rate_hz)
        else:
            check_rate(features, math.inf, self.frame_rate_hz)
        self._period_s = 1 / self.frame_rate_hz
        self._stamps, self._count_time = DeviceTime(), DeviceTime(_COUNTED_DRIFT)
        enable_chunks(features)
        self._link.start(max(_LEAST_KEPT, math.ceil(self.frame_rate_hz)))
        self._next_trigger_s = self._heard_s = self._asked_s = time.monotonic()

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                if self._link is None and not self._reach_again():
                    continue
                try:
                    self._listen()
                except DeviceError as error:
                    self._lose(str(error))
        except Exception as error:
            self._trouble = f"its thread has failed: {error}"
            raise

    def _listen(self) -> None:
        """Take the next buffer, or find out why there is none."""
        assert self._link is not None
        raw = self._link.next_frame(self._trigger_when_due())
        if raw is not None:
            self._heard_s = time.monotonic()
            self._take(raw)
            return
        silent_s = time.monotonic() - self._heard_s
        if self._link.is_lost():
            raise DeviceError(self.name, "is not there any more")
        if self._settings.trigger != "line" and silent_s > max(_SILENT_S, _SILENT_PERIODS * self._period_s):
            raise DeviceError(self.name, f"has sent nothing for {silent_s:.1f} s")
        if time.monotonic() - max(self._heard_s, self._asked_s) > _ASK_S:
            self._asked_s = time.monotonic()
            self._link.features.get("Width")

    def _trigger_when_due(self) -> float:
        """Fire where the driver triggers; return for how long to wait."""
        if self._settings.trigger != "software":
            return _POLL_S
        assert self._link is not None
        now = time.monotonic()
        if now >= self._next_trigger_s:
            self._link.features.execute("TriggerSoftware")
            # Triggers that could not be fired in time are left out.
            self._next_trigger_s += self._period_s * math.ceil((now - self._next_trigger_s) / self._period_s + 1e-9)
        return min(_POLL_S, max(self._next_trigger_s - time.monotonic(), 0.001))

    def _take(self, raw: RawFrame) -> None:
        arrival_s = self._clock.now_s()
        if not raw.is_complete:
            self.incomplete += 1  # its number will be left out
            return
        if (raw.rows, raw.columns, raw.pixel_format) != (*self.image_shape, self._format):
            raise DeviceError(
                self.name, f"sends {raw.columns} x {raw.rows} pixels of {raw.pixel_format} all of a sudden"
            )
        number = self._numbers.next(raw.frame_id, (arrival_s - self._last_arrival_s) / self._period_s)
        steps = number - self._last_number
        counts = unpack(raw.data, raw.pixel_format, raw.columns, raw.rows, raw.padding)
        time_s = self._time_of(raw, number, steps, arrival_s) - self._settings.latency_s
        self.exposure_s = raw.exposure_s or self.exposure_s
        if steps > 0:
            self._last_number, self._last_arrival_s = number, arrival_s
        with self._news:
            self._trouble = ""
            self.overrun += len(self._arrived) == self._arrived.maxlen
            self._arrived.append(CameraFrame(counts, time_s, number))
            self._news.notify()

    def _time_of(self, raw: RawFrame, number: int, steps: int, arrival_s: float) -> float:
        """Return when a frame was taken, up to the latency."""
        if raw.stamp_s:
            return self._stamps.to_clock(raw.stamp_s, arrival_s, steps * self._period_s if self._is_free else None)
        if self._is_free:  # then the number itself is a clock
            return self._count_time.to_clock(number * self._period_s, arrival_s)
        return arrival_s

    def _lose(self, why: str) -> None:
        self.links_lost += 1
        self._trouble = f"the link is lost ({why.removeprefix(f'{self.name}: ')}); looking for the camera"
        self._drop_link()

    def _reach_again(self) -> bool:
        """Try to find the camera, set it and start it; False where that is to be tried again."""
        try:
            self._link = self._open_again()
            self._numbers.restart()
            self._begin()
        except VialightError as error:
            self._trouble = f"the link is lost ({error}); looking for the camera"
            self._drop_link()
            self._ending.wait(_AGAIN_S)
            return False
        return True

    def _open_again(self) -> Link:
        link = self._open_link()
        if link.name != self.name:
            link.close()
            raise DeviceError(self.name, f"is not there, but {link.name} is")
        try:
            apply_settings(link.features, self._in_force)
        except BaseException:
            link.close()
            raise
        return link

    def _drop_link(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            with contextlib.suppress(DeviceError):
                link.close()

    def _end_thread(self) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            if self._thread.is_alive():
                raise DeviceError(self.name, f"has not stopped within {_JOIN_S:g} s", "unplug it")
            self._thread = None
