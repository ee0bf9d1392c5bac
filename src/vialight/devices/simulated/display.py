"""The simulated display: what lies under the projector's window is black, and shows as soon as the window is gone.

It stands for graphics driver and monitor in one.  The window's process is connected to it; the system closes the
connection when that process ends, in whatever way, and the display then shows black without being told.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import struct
import threading
import time
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vialight.devices.clocks import SimulatedClock
from vialight.devices.protocols import DeviceError, DeviceGoneError
from vialight.system import leave_interrupts_to_the_print

FLIP = struct.Struct("<ddi")
"""Time on the print's clock, `time.monotonic`, and index of the pattern; -1 is black."""
_RECORD = np.dtype([("time_s", "<f8"), ("monotonic_s", "<f8"), ("pattern", "<i4")])
BLACK, COVERED = -1, -2
_PATTERN = struct.Struct("<i")
_LINGER_S = 2.0
_ANSWER_S = 2.0
"""After which the display is given up; long before, the guardian has covered it."""


class Flip(NamedTuple):
    """A change of what is on the screen."""

    time_s: float
    """On the print's clock."""
    monotonic_s: float
    """By `time.monotonic`."""
    pattern: int
    """-1 is black."""


def run_display(folder: Path, ready: Any) -> None:
    """Serve one window after another until the process is ended; every change of light goes into ``flips``."""
    leave_interrupts_to_the_print()
    with contextlib.suppress(OSError, AttributeError):
        os.nice(-10)  # it stands for what has no other work to do
    clock = SimulatedClock(folder / "clock")
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()
    with Listener(str(folder / "display")) as listener, (folder / "flips").open("ab", 0) as flips:
        ready.send_bytes(b"")
        while True:
            with listener.accept() as window:
                try:
                    while True:
                        (pattern,) = _PATTERN.unpack(window.recv_bytes(_PATTERN.size))
                        flips.write(_flip(clock, pattern))
                        window.send_bytes(b"")
                except (EOFError, OSError):
                    flips.write(_flip(clock, BLACK))


def _flip(clock: SimulatedClock, pattern: int) -> bytes:
    return FLIP.pack(clock.now_s(), time.monotonic(), pattern)


def _leave_with(parent: Any) -> None:
    """End this process a while after the one that prints: until then it shows what became of the light."""
    parent.join()
    time.sleep(_LINGER_S)
    os._exit(0)


class DisplayWindow:
    """A `Screen` on the simulated display."""

    def __init__(self, folder: Path, refresh_hz: float) -> None:
        self._refresh_hz = refresh_hz
        try:
            self._connection: Connection[Any, Any] = Client(str(folder / "display"))
        except OSError as error:
            raise DeviceError("projector", f"no display ({error.strerror})") from error

    @property
    def refresh_hz(self) -> float:
        """Of the print's clock."""
        return self._refresh_hz

    def show(self, pattern: int | None) -> None:
        """Show a pattern, or black; returns when the display has it."""
        try:
            self._connection.send_bytes(_PATTERN.pack(BLACK if pattern is None else pattern))
            if self._connection.poll(_ANSWER_S):
                self._connection.recv_bytes(0)
                return
        except (EOFError, OSError) as error:
            raise DeviceGoneError("projector", "the display has ended") from error
        raise DeviceError("projector", f"the display has not answered within {_ANSWER_S:g} s")

    def tend(self) -> None:
        """Do nothing: the connection tells of its end when it is written to."""

    def close(self) -> None:
        """Take the window away."""
        self._connection.close()


class DisplayCover:
    """The guardian's cover: a shutter of its own before the simulated display, which needs nothing of that."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._clock = folder, SimulatedClock(folder / "clock")
        self._is_drawn = False

    def cover(self) -> None:
        """Close the shutter: whatever the display shows from now on is not seen."""
        if not self._is_drawn:
            with (self._folder / "flips").open("ab", 0) as flips:
                flips.write(_flip(self._clock, COVERED))
            self._is_drawn = True

    def tend(self) -> None:
        """Do nothing: it stays as it is."""

    def close(self) -> None:
        """Leave it: it ends with the display."""


def read_flips(folder: Path, skip: int = 0) -> list[Flip]:
    """Return every change of light after the first `skip`; once it is covered, all is black."""
    content = (folder / "flips").read_bytes()
    patterns = np.frombuffer(content, _RECORD, len(content) // FLIP.size)["pattern"]
    covered = np.flatnonzero(patterns == COVERED)
    first_covered = int(covered[0]) if len(covered) else len(patterns)
    flips = [Flip(*values) for values in FLIP.iter_unpack(content[skip * FLIP.size : len(patterns) * FLIP.size])]
    return [
        flip if place < first_covered else flip._replace(pattern=BLACK) for place, flip in enumerate(flips, start=skip)
    ]
