"""The simulated display: what lies under the projector's window is black, and shows as soon as the window is gone.

It stands for graphics driver and curtain in one.  The window's process is connected to it; the system closes the
connection when that process ends, in whatever way, and the display then shows black without being told.
"""

from __future__ import annotations

import struct
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any

from vialight.devices.clocks import SimulatedClock
from vialight.devices.protocols import DeviceError

FLIP = struct.Struct("<di")
"""Time, and index of the pattern; -1 is black."""
BLACK = -1


def run_display(folder: Path, ready: Any) -> None:
    """Serve one window after another until the process is ended; every change of light goes into ``flips``."""
    clock = SimulatedClock(folder / "clock")
    with Listener(str(folder / "display"), family="AF_UNIX") as listener, (folder / "flips").open("ab", 0) as flips:
        ready.send(True)
        while True:
            with listener.accept() as window:
                try:
                    while True:
                        flips.write(FLIP.pack(clock.now_s(), window.recv()))
                except (EOFError, OSError):
                    flips.write(FLIP.pack(clock.now_s(), BLACK))


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

    def close(self) -> None:
        """Take the window away."""
        self._connection.close()


def read_flips(folder: Path, skip: int = 0) -> list[tuple[float, int]]:
    """Return time and pattern of every change of light after the first `skip`."""
    with (folder / "flips").open("rb") as file:
        file.seek(skip * FLIP.size)
        content = file.read()
    whole = len(content) // FLIP.size * FLIP.size
    return [(time_s, index) for time_s, index in FLIP.iter_unpack(content[:whole])]
