"""Every frame on disk, with its angle and time, before anyone counts on it."""

from __future__ import annotations

import math
import queue
import shutil
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import InputError
from vialight.core.messages import CameraImage
from vialight.devices import Camera, CameraFrame, Clock, DeviceError, DeviceLostError, DeviceTimeoutError
from vialight.printing.log import EventLog
from vialight.store import FrameWriter
from vialight.system import wait_for

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
_ANGLES_LATE_S = 2.0
"""Of frames that wait for their angles, after which there is no light: positions are kept for several times as long."""
_UNSYNCED_DARK_S = 10.0
"""For which a disk may hold frames without having them for certain."""
_SWITCH_S = 30.0

AngleAt = Callable[[float], float]


@dataclass
class _Order:
    """Something that the disk's thread does between two frames, in their order."""

    writer: FrameWriter | None = None
    is_switch: bool = False
    done: threading.Event = field(default_factory=threading.Event)
    found: FrameWriter | None = None
    frames: int = 0
    error: str | None = None


class Recorder:
    """Takes frames from the camera on one thread, gives them their angles on a second, and writes them on a third.

    A frame's angle is that of its own time, and is fixed as soon as the stage has told a position after it, however
    long the disk takes.  A frame whose angle is not known is refused.  Nothing else happens on these threads: whoever
    shows or computes reads the file, and never holds them up.

    Parameters
    ----------
    camera, clock
        Where frames come from, and time.
    frame_rate_hz
        That the camera should keep.
    angle_at
        Stage angle at a time; it may wait for a moment, and is NaN where it is not known.
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
    refused : int
        Frames that were not recorded since their angle is not known.
    lost : int
        Frames that were not recorded since the disk or their angles were too far behind.
    """

    def __init__(
        self, camera: Camera, clock: Clock, frame_rate_hz: float, angle_at: AngleAt, log: EventLog,
        on_written: Callable[[CameraImage], None],
    ) -> None:  # fmt: skip
        self._camera, self._clock, self._period_s = camera, clock, 1 / frame_rate_hz
        self._angle_at, self._log, self._on_written = angle_at, log, on_written
        self._room = max(2, int(_QUEUE_S * frame_rate_hz))
        self._unstamped: queue.Queue[tuple[CameraFrame, float, float] | _Order | None] = queue.Queue()
        self._queue: queue.Queue[tuple[CameraFrame, float, float, float] | _Order | None] = queue.Queue()
        self._writer: FrameWriter | None = None
        self._recorded: FrameWriter | None = None
        self._refusing_since: int | None = None
        self._is_losing = False
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
        self.written = self.refused = self.lost = 0
        self._threads = [
            threading.Thread(target=self._grab, name="camera", daemon=True),
            threading.Thread(target=self._stamp, name="angles", daemon=True),
            threading.Thread(target=self._write, name="disk", daemon=True),
        ]

    def start(self) -> None:
        """Begin to take frames; until `write_to` they are only looked at."""
        for thread in self._threads:
            thread.start()

    def write_to(self, writer: FrameWriter | None, timeout_s: float = _SWITCH_S) -> int:
        """Write from now on to a file, or to none; the former one is closed when its last frame is in.

        Returns
        -------
        int
            Frames that the former file holds; 0 where there was none.

        Raises
        ------
        DeviceError
            The disk is too far behind, or refuses; the files change all the same once it has caught up.
        """
        order = _Order(writer, is_switch=True)
        if fault := self._carry_out(order, timeout_s) or order.error:
            raise DeviceError("disk", fault)
        return order.frames

    def sync(self, timeout_s: float = _SWITCH_S) -> str | None:
        """Wait until every frame that has come is on the disk for certain; say why it is not.

        Parameters
        ----------
        timeout_s
            After which it is given up; the disk goes on.
        """
        order, deadline = _Order(), time.monotonic() + timeout_s
        if fault := self._carry_out(order, timeout_s):
            return fault
        return None if order.found is None else order.found.sync(max(0.0, deadline - time.monotonic()))

    def _carry_out(self, order: _Order, timeout_s: float) -> str | None:
        if not self._threads[-1].is_alive():
            self._obey(order)
            return None
        self._unstamped.put(order)
        return wait_for(order.done.is_set, self._lag_fault, timeout_s, every_s=0.005)

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
        waiting_s = self._unstamped.qsize() * self._period_s
        if waiting_s > _ANGLES_LATE_S:
            return f"angles are {waiting_s:.0f} s behind its frames"
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
        unsynced_s = 0.0 if self._recorded is None else self._recorded.unsynced_s
        if unsynced_s > _UNSYNCED_DARK_S:
            return f"has had no frame for certain for {unsynced_s:.0f} s"
        return self._lag_fault()

    def _lag_fault(self) -> str | None:
        return f"{self.lag_s:.0f} s behind the camera" if self.lag_s > _LAG_DARK_S else None

    def close(self, timeout_s: float = _QUEUE_S) -> None:
        """Take no more frames, write what waits, and close the file; what a slow disk leaves is told in the log."""
        if self._ending.is_set():
            return
        self._ending.set()
        deadline = time.monotonic() + timeout_s
        if not self._threads[-1].is_alive():
            self._obey(_Order(is_switch=True))
        for thread in self._threads:
            if thread.is_alive():
                thread.join(max(0.0, deadline - time.monotonic()))
        if self._threads[-1].is_alive():
            left = self._unstamped.qsize() + self._queue.qsize()
            self._log.note("fault", f"the disk took nothing more within {timeout_s:g} s: {left} frames are not written")
        self._tell_refused(None)

    def _grab(self) -> None:
        try:
            while not self._ending.is_set() and self._take():
                pass
        finally:
            self._ending.wait()  # orders still come where the camera has failed
            self._unstamped.put(None)

    def _take(self) -> bool:
        """Take one frame from the camera, if there is one; False where there will be none."""
        try:
            frame = self._camera.next_frame(_POLL_S)
        except DeviceTimeoutError as error:
            self._lost = str(error) if isinstance(error, DeviceLostError) else ""
            return True
        except DeviceError as error:
            self._fault = str(error)
            self._log.note("fault", str(error))
            return False
        self._arrived_s, arrived = self._clock.now_s(), time.monotonic()
        if frame.number in self._seen:
            self._log.note("frame", number=frame.number, odd="came twice")
            return True
        self._seen.add(frame.number)
        self._highest = max(self._highest, frame.number)
        time_s = self._believable(frame)
        if self._unstamped.qsize() >= self._room:
            self._lose(frame.number, "their angles are too late")
        else:
            self._unstamped.put((frame, time_s, arrived))
        return True

    def _lose(self, number: int, why: str) -> None:
        self.lost += 1
        if not self._is_losing:
            self._is_losing = True
            self._log.note("fault", f"frames are lost: {why}", number=number)

    def _stamp(self) -> None:
        while (given := self._unstamped.get()) is not None:
            if isinstance(given, _Order):
                self._queue.put(given)
                continue
            frame, time_s, arrived = given
            angle = self._angle_at(time_s)
            if self._queue.qsize() >= self._room:
                self._lose(frame.number, "the disk is too slow")
            else:
                self._queue.put((frame, time_s, arrived, angle))
        self._queue.put(None)

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
        while (given := self._queue.get()) is not None:
            if isinstance(given, _Order):
                self._obey(given)
                continue
            try:
                self._write_one(*given)
            except Exception as error:  # whoever is shown a frame must not end the recording
                self._tell_disk(f"{type(error).__name__}: {error}")
            if self.lag_s > _LAG_WARNING_S and not self._is_slow:
                self._is_slow = True
                self._log.note("disk", f"the disk is {self.lag_s:.1f} s behind the camera; it holds {_QUEUE_S:g} s")
            if self.lag_s < _LAG_WARNING_S / 2 and self._is_losing:
                self._is_losing = False
                self._log.note("disk", f"no more frames are lost; {self.lost} were so far", lost=self.lost)
        self._obey(_Order(is_switch=True))

    def _obey(self, order: _Order) -> None:
        order.found = self._writer
        if order.is_switch:
            if self._writer is not None:
                try:
                    self._writer.close()
                except (OSError, RuntimeError) as error:
                    order.error = f"{self._writer.path}: cannot be closed ({error})"
                    self._log.note("fault", order.error)
                order.frames = self._writer.count
            self._writer = self._recorded = order.writer
            self.written = 0 if order.writer is not None else self.written
        order.done.set()

    def _tell_disk(self, fault: str) -> None:
        if not self._disk_told:
            self._disk_told = fault
            self._log.note("fault", fault)

    def _write_one(self, frame: CameraFrame, time_s: float, arrived: float, angle: float) -> None:
        if self._disk_told:
            return
        number = -1
        if self._writer is not None:
            self._tell_refused(frame.number if math.isnan(angle) else None)
            if math.isnan(angle):
                return
            try:
                self._writer.append(frame.counts, angle, time_s)
            except InputError as error:
                self._tell_disk(str(error))
                return
            number, self.written = self.written, self.written + 1
        self._arrivals_s.append(arrived)
        self._on_written(CameraImage(number, frame.counts, time_s, float(np.rad2deg(angle)), tuple(self._arrivals_s)))

    def _tell_refused(self, number: int | None) -> None:
        """Tell the first frame of a row that is refused, and how many they were when the row is over."""
        if number is not None:
            self.refused += 1
            if self._refusing_since is None:
                self._refusing_since = number
                self._log.note("frame", number=number, odd="refused: the stage told no position for its time")
        elif self._refusing_since is not None:
            since, self._refusing_since = self._refusing_since, None
            self._log.note("frame", number=since, odd=f"refused up to here: {self.refused} frames so far")


def room_for(folder: Path, image: NDArray[np.uint16], frames: int) -> tuple[int, int]:
    """Return bytes that a recording takes at most, and bytes that are free."""
    return int(1.05 * image.nbytes * frames), shutil.disk_usage(folder).free
