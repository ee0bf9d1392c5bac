"""The simulated display: what lies under the projector's window is black, and shows as soon as the window is gone.

It stands for graphics driver and curtain in one.  The window's process is connected to it; the system closes the
connection when that process ends, in whatever way, and the display then shows black without being told.
"""

from __future__ import annotations

import multiprocessing
import os
import struct
import threading
import time
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any, NamedTuple

from vialight.devices.clocks import SimulatedClock
from vialight.devices.protocols import DeviceError
from vialight.links import leave_interrupts_to_the_print

FLIP = struct.Struct("<ddi")
"""Time on the print's clock, `time.monotonic`, and index of the pattern; -1 is black."""
BLACK = -1
_LINGER_S = 2.0


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
    clock = SimulatedClock(folder / "clock")
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()
    with Listener(str(folder / "display"), family="AF_UNIX") as listener, (folder / "flips").open("ab", 0) as flips:
        ready.send(True)
        while True:
            with listener.accept() as window:
                try:
                    while True:
                        flips.write(_flip(clock, window.recv()))
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
            self._connection: Connection[Any, Any] = Client(str(folder / "display"), family="AF_UNIX")
        except OSError as error:
            raise DeviceError("projector", f"no display ({error.strerror})") from error

    @property
    def refresh_hz(self) -> float:
        """Of the print's clock."""
        return self._refresh_hz

    def show(self, pattern: int | None) -> None:
        """Show a pattern, or black."""
        self._connection.send(BLACK if pattern is None else pattern)

    def tend(self) -> None:
        """Do nothing: the connection tells of its end when it is written to."""

    def close(self) -> None:
        """Take the window away."""
        self._connection.close()


def read_flips(folder: Path, skip: int = 0) -> list[Flip]:
    """Return every change of light after the first `skip`."""
    with (folder / "flips").open("rb") as file:
        file.seek(skip * FLIP.size)
        content = file.read()
    whole = len(content) // FLIP.size * FLIP.size
    return [Flip(*values) for values in FLIP.iter_unpack(content[:whole])]
