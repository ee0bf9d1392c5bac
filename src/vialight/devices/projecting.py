"""The projector's own process: the pattern that is due while the lease holds, black whenever anything is wrong.

The rules are here once, for every kind of screen.  The process watches by itself: the lease, which runs out by the
system's clock; and the process that gives leases, whose end it sees at once.
"""

from __future__ import annotations

import contextlib
import csv
import multiprocessing
import os
import time
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np

from vialight.arrays import FloatArray
from vialight.devices.protocols import Clock, DeviceError, Lease, Shown
from vialight.links import Mailbox, leave_interrupts_to_the_print

LEASE_S = 0.15
"""For which a lease holds, by the wall clock: with a refresh it is over well within a quarter of a second."""
_START_TIMEOUT_S = 60.0
_END_TIMEOUT_S = 3.0


class Screen(Protocol):
    """A surface that light comes from; black when its process ends, however that happens."""

    @property
    def refresh_hz(self) -> float:
        """Of the print's clock."""
        ...

    def show(self, pattern: int | None) -> None:
        """Show a pattern, or black, from the next refresh on."""
        ...

    def tend(self) -> None:
        """Do what is to be done between refreshes; `DeviceError` where no light can be shown any more."""
        ...

    def close(self) -> None:
        """Black, and let go."""
        ...


class ScreenMaker(Protocol):
    """Makes the screen, in the process in which it lives; must be picklable."""

    def __call__(self) -> Screen:
        """Return a screen that is black."""
        ...


class ProjectorProcess:
    """A projector whose screen lives in a process of its own.

    Parameters
    ----------
    make_screen
        Called in that process.
    clock
        The print's; must be picklable.
    pattern_angles_rad
        (angle,) at which patterns are due, ascending, evenly spaced over a turn.
    folder
        For its mailboxes.
    log
        CSV file, made anew, of what was due and what was shown.
    latency_s
        From the refresh from which on a pattern is shown to its light.

    Raises
    ------
    DeviceError
        The screen cannot be made.
    """

    def __init__(
        self, make_screen: ScreenMaker, clock: Clock, pattern_angles_rad: FloatArray, folder: Path, log: Path,
        latency_s: float = 0.0,
    ) -> None:  # fmt: skip
        self._leases = Mailbox(folder / "lease", 1000)
        self._shown_path = folder / "shown"
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_run,
            args=(make_screen, clock, _Due(pattern_angles_rad, latency_s), folder, log, theirs),
            name="projector",
            daemon=True,
        )
        self._process.start()
        theirs.close()
        if not ours.poll(_START_TIMEOUT_S):
            self._process.kill()
            raise DeviceError("projector", f"has not started within {_START_TIMEOUT_S:g} s")
        try:
            fault = ours.recv()
        except EOFError:
            fault = "its process has ended"
        if fault:
            self._process.join(_END_TIMEOUT_S)
            raise DeviceError("projector", fault)
        self._shown = Mailbox(self._shown_path)
        self._faults, self._fault = ours, ""

    @property
    def pid(self) -> int:
        """Of the process that holds the screen."""
        assert self._process.pid is not None
        return self._process.pid

    def renew(self, lease: Lease) -> None:
        """Replace the lease."""
        self._leases.put(lease)

    def darken(self) -> None:
        """Withdraw the lease."""
        self._leases.put(None)

    def shown(self) -> Shown:
        """Return what is on the screen now."""
        if not self._process.is_alive():
            with contextlib.suppress(EOFError, OSError):
                self._fault = self._fault or (self._faults.recv() if self._faults.poll() else "")
            raise DeviceError("projector", self._fault or f"its process has ended (exit code {self._process.exitcode})")
        found = self._shown.newest()
        assert found is not None  # put before the process says that it is ready
        shown: Shown = found[1]
        return shown

    def close(self) -> None:
        """Black, and end the process."""
        self.darken()
        self._leases.put("end")
        self._process.join(_END_TIMEOUT_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


@dataclass(frozen=True)
class _Due:
    """Which pattern is due."""

    angles_rad: FloatArray
    latency_s: float

    def at(self, lease: Lease, time_s: float) -> int:
        """Return the pattern for the angle at which the object will be when the light of a refresh comes."""
        angle = lease.angle_rad + lease.speed_rad_s * (time_s + self.latency_s - lease.time_s)
        step = 2 * np.pi / len(self.angles_rad)
        return int(np.rint((angle - self.angles_rad[0]) / step)) % len(self.angles_rad)


def _run(make_screen: ScreenMaker, clock: Clock, due: _Due, folder: Path, log: Path, parent: Any) -> None:
    leave_interrupts_to_the_print()
    with contextlib.suppress(OSError):
        os.nice(-10)  # as far as the system lets: light must be right before anything else
    leases = Mailbox(folder / "lease")
    with Mailbox(folder / "shown", 1000) as shown, log.open("w", newline="", encoding="utf-8") as file:
        try:
            screen = make_screen()
        except Exception as error:
            parent.send(str(error))
            return
        try:
            shown.put(Shown(None, clock.now_s()))
            parent.send("")
            _project(screen, clock, due, leases, shown, file)
        except DeviceError as error:
            parent.send(str(error).removeprefix("projector: "))
        finally:
            screen.close()
            shown.put(Shown(None, clock.now_s()))


def _project(screen: Screen, clock: Clock, due: _Due, leases: Mailbox, shown: Mailbox, file: TextIO) -> None:
    writer = csv.writer(file)
    writer.writerow(["refresh_s", "shown_s", "due", "shown"])
    giver = multiprocessing.parent_process()
    assert giver is not None
    period_s = 1 / screen.refresh_hz
    on_screen: int | None = None
    refresh = int(clock.now_s() / period_s)
    while not wait([giver.sentinel], timeout=0):
        screen.tend()
        lease: Any = (leases.newest() or (0, None))[1]
        if lease == "end":
            return
        now = clock.now_s()
        coming = int(now / period_s)
        wanted = on_screen
        if lease is None or time.monotonic() >= lease.until_monotonic_s or now >= lease.off_at_s:
            wanted = None
        elif coming > refresh:
            wanted = due.at(lease, (coming + 0.5) * period_s)
        if wanted != on_screen:
            screen.show(wanted)
            shown.put(Shown(wanted, clock.now_s()))
        if on_screen is not None or wanted is not None:
            for missed in range(refresh + 1, coming) if lease is not None else ():
                wanting = due.at(lease, (missed + 0.5) * period_s)
                writer.writerow([f"{missed * period_s:.4f}", "", wanting, _code(on_screen)])
            if coming > refresh or wanted != on_screen:
                code = _code(wanted)
                writer.writerow([f"{coming * period_s:.4f}", f"{clock.now_s():.4f}", code, code])
                file.flush()
        on_screen, refresh = wanted, coming
        # Never longer than a fraction of the lease, even where the print's clock stands still.
        time.sleep(min(max(((refresh + 1) * period_s - clock.now_s()) / clock.rate, 0.0005), 0.02))


def _code(pattern: int | None) -> int:
    return -1 if pattern is None else pattern
