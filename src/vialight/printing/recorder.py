"""Every frame on disk, with its angle and time, before anyone counts on it."""

from __future__ import annotations

import queue
import shutil
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vialight.devices import Camera, CameraFrame, Clock, DeviceError, DeviceLostError, DeviceTimeoutError
from vialight.errors import InputError
from vialight.links import CameraImage
from vialight.printing.log import EventLog
from vialight.store import FrameWriter

_POLL_S = 0.05
_QUEUE_S = 30.0
"""Of frames that may wait for the disk."""
_LAG_WARNING_S = 1.0
_LAG_DARK_S = 10.0
_LATE_S = 0.12
"""On the print's clock, after a frame was due: one lost frame is no fault, two in a row are."""
_JUMP_S = 0.5
"""A timestamp that is off by more than this is not believed."""
_NEWEST = 50

AngleAt = Callable[[float], float]


class Recorder:
    """Takes frames from the camera on one thread and writes them on another.

    Nothing else happens on these threads: whoever shows or computes reads the file, and never holds them up.

    Parameters
    ----------
    camera, clock
        Where frames come from, and time.
    frame_rate_hz
        That the camera should keep.
    angle_at
        Stage angle at a time.
    log
        Takes what is odd.
    on_written
        Called with each frame once it is in the file; also, with the number -1, while there is no file.

    Attributes
    ----------
    written : int
        Frames that are safely in the file.
    missed : int
        Frames whose numbers were left out.
    """

    def __init__(
        self, camera: Camera, clock: Clock, frame_rate_hz: float, angle_at: AngleAt, log: EventLog,
        on_written: Callable[[CameraImage], None],
    ) -> None:  # fmt: skip
        self._camera, self._clock, self._period_s = camera, clock, 1 / frame_rate_hz
        self._angle_at, self._log, self._on_written = angle_at, log, on_written
        self._queue: queue.Queue[tuple[CameraFrame, float, float]] = queue.Queue(int(_QUEUE_S * frame_rate_hz))
        self._writer: FrameWriter | None = None
        self._writer_lock = threading.Lock()
        self._delays: deque[float] = deque(maxlen=_NEWEST)
        self._arrivals_s: deque[float] = deque(maxlen=_NEWEST)
        self._believed: tuple[int, float] | None = None
        self._seen: set[int] = set()
        self._highest = -1
        self._ending = threading.Event()
        self._arrived_s: float | None = None
        self._lost = ""
        self._fault: str | None = None
        self._disk_told: str | None = None
        self._is_slow = False
        self.written = 0
        self._threads = [
            threading.Thread(target=self._grab, name="camera", daemon=True),
            threading.Thread(target=self._write, name="disk", daemon=True),
        ]

    def start(self) -> None:
        """Begin to take frames; until `write_to` they are only looked at."""
        for thread in self._threads:
            thread.start()

    def write_to(self, writer: FrameWriter | None) -> None:
        """Write from now on to a file, or to none; the former one is closed when its last frame is in."""
        self._queue.join()
        with self._writer_lock:
            if self._writer is not None:
                self._writer.close()
            self._writer = writer
            self.written = 0

    @property
    def missed(self) -> int:
        """Frames that have not come."""
        return self._highest + 1 - len(self._seen)

    @property
    def lag_s(self) -> float:
        """By how much the disk is behind the camera."""
        return self._queue.qsize() * self._period_s

    def camera_fault(self) -> str | None:
        """Say what is wrong with the camera."""
        if self._fault:
            return self._fault
        if self._arrived_s is None:
            return self._lost or "no frame yet"
        silent_s = self._clock.now_s() - self._arrived_s
        if silent_s - self._period_s <= _LATE_S:
            return None
        return self._lost or ("silent" if silent_s < 1 else f"silent for {silent_s:.0f} s")

    def disk_fault(self) -> str | None:
        """Say what is wrong with the disk."""
        if self._disk_told:
            return self._disk_told
        return f"{self.lag_s:.0f} s behind the camera" if self.lag_s > _LAG_DARK_S else None

    def close(self) -> None:
        """Take no more frames, write what waits, and close the file."""
        self._ending.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(_QUEUE_S)
        with self._writer_lock:
            if self._writer is not None:
                self._writer.close()
                self._writer = None

    def _grab(self) -> None:
        while not self._ending.is_set():
            try:
                frame = self._camera.next_frame(_POLL_S)
            except DeviceTimeoutError as error:
                self._lost = str(error) if isinstance(error, DeviceLostError) else ""
                continue
            except DeviceError as error:
                self._fault = str(error)
                self._log.note("fault", str(error))
                return
            self._arrived_s, arrived = self._clock.now_s(), time.monotonic()
            if frame.number in self._seen:
                self._log.note("frame", number=frame.number, odd="came twice")
                continue
            self._seen.add(frame.number)
            self._highest = max(self._highest, frame.number)
            try:
                self._queue.put_nowait((frame, self._believable(frame), arrived))
            except queue.Full:
                self._log.note("fault", "frames are lost: the disk is too slow", number=frame.number)

    def _believable(self, frame: CameraFrame) -> float:
        """Return the time of a frame; where its stamp has jumped, that of its arrival less the usual delay.

        A frame that was held up comes late, but its time still fits its number.
        """
        assert self._arrived_s is not None
        delay = self._arrived_s - frame.time_s
        usual = statistics.median(self._delays) if self._delays else delay
        time_s = frame.time_s
        if abs(delay - usual) > _JUMP_S and not self._fits_its_number(frame):
            self._log.note("frame", number=frame.number, odd=f"its time is off by {usual - delay:.3f} s")
            time_s = self._arrived_s - usual
        else:
            self._delays.append(delay)
        self._believed = (frame.number, time_s)
        return time_s

    def _fits_its_number(self, frame: CameraFrame) -> bool:
        if self._believed is None:
            return True
        number, time_s = self._believed
        return abs(time_s + (frame.number - number) * self._period_s - frame.time_s) <= _JUMP_S

    def _write(self) -> None:
        while not (self._ending.is_set() and self._queue.empty()):
            try:
                frame, time_s, arrived = self._queue.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            try:
                self._write_one(frame, time_s, arrived)
            finally:
                self._queue.task_done()
            if self.lag_s > _LAG_WARNING_S and not self._is_slow:
                self._is_slow = True
                self._log.note("disk", f"the disk is {self.lag_s:.1f} s behind the camera; it holds {_QUEUE_S:g} s")

    def _write_one(self, frame: CameraFrame, time_s: float, arrived: float) -> None:
        angle = self._angle_at(time_s)
        with self._writer_lock:
            if self._disk_told:
                return
            if self._writer is not None:
                try:
                    self._writer.append(frame.counts, angle, time_s)
                except InputError as error:
                    self._disk_told = str(error)
                    self._log.note("fault", str(error))
                    return
                self.written += 1
        number = self.written - 1 if self._writer is not None else -1
        self._arrivals_s.append(arrived)
        self._on_written(CameraImage(number, frame.counts, time_s, float(np.rad2deg(angle)), tuple(self._arrivals_s)))


def room_for(folder: Path, image: NDArray[np.uint16], frames: int) -> tuple[int, int]:
    """Return bytes that a recording takes at most, and bytes that are free."""
    return int(1.05 * image.nbytes * frames), shutil.disk_usage(folder).free
