"""The projector's own process: the pattern that is due while the lease holds, black whenever anything is wrong.

The rules are in `leasing`, for every kind of screen.  The process watches by itself: the lease, which runs out by the
system's clock; the stop switch; and the process that gives leases, whose end it sees at once.  A guardian watches it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import time
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.errors import VialightError
from vialight.devices.guarding import CLOSING, CoverMaker, Ward, guard
from vialight.devices.leasing import HUNG_S, judge
from vialight.devices.panel import LightPanel
from vialight.devices.protocols import Clock, DeviceError, DeviceGoneError, Lease, LightPhase, Shown
from vialight.system import LineWriter, deaf_to_interrupts, leave_interrupts_to_the_print
from vialight.system.mailboxes import Mailbox

_START_TIMEOUT_S = 60.0
_END_TIMEOUT_S = 3.0
_SILENT_S = 0.1
"""Without a sign of life after which projector or guardian are taken for hung, and the light is held."""


class Screen(Protocol):
    """A surface that light comes from; black when its process ends, however that happens."""

    @property
    def refresh_hz(self) -> float:
        """Of the print's clock."""
        ...

    def show(self, pattern: int | None) -> None:
        """Show a pattern, or black, from the next refresh on; returns when it is on the screen."""
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


@dataclass(frozen=True)
class ProjectorParts:
    """What a projector is made of.

    Parameters
    ----------
    make_screen
        Called in the projector's process.
    make_cover
        Called in the guardian's.
    pattern_angles_rad
        (angle,) at which patterns are due, ascending, evenly spaced over a turn.
    log
        CSV file, made anew, of what was due and what was shown.
    latency_s
        From the refresh from which on a pattern is shown to its light.
    """

    make_screen: ScreenMaker
    make_cover: CoverMaker
    pattern_angles_rad: FloatArray
    log: Path
    latency_s: float = 0.0


class ProjectorProcess:
    """A projector whose screen lives in a process of its own, with a guardian in another.

    One thread gives leases; any may look at what is shown.

    Parameters
    ----------
    parts
        What it is made of.
    clock
        The print's; must be picklable.
    folder
        The print's shared folder.

    Attributes
    ----------
    processes : dict
        Name to process.

    Raises
    ------
    DeviceError
        The screen or its cover cannot be made.
    """

    def __init__(self, parts: ProjectorParts, clock: Clock, folder: Path) -> None:
        self._panel = LightPanel(folder, is_new=True)
        self._leases = Mailbox(folder / "lease", Lease, 1000)
        context = multiprocessing.get_context("spawn")
        self._faults, theirs = context.Pipe()
        alive, life = context.Pipe(duplex=False)
        due = _Due(parts.pattern_angles_rad, parts.latency_s)
        projector = context.Process(
            target=_run, args=(parts, clock, due, folder, theirs, life), name="projector", daemon=True
        )
        with deaf_to_interrupts():
            projector.start()
        theirs.close()
        life.close()
        self.processes: dict[str, Any] = {"projector": projector}
        self._fault, self._alarm = "", ""
        try:
            _begun(self._faults, "projector")
            self._shown = Mailbox(folder / "shown", Shown)
            self._guard, theirs = context.Pipe()
            ward = Ward(parts.make_cover, folder, self.pid)
            guardian = context.Process(target=guard, args=(ward, theirs, alive), name="guardian", daemon=True)
            with deaf_to_interrupts():
                guardian.start()
            self.processes["guardian"] = guardian
            theirs.close()
            alive.close()
            _begun(self._guard, "projector's guardian")
        except BaseException:
            for process in self.processes.values():
                process.kill()
                process.join(_END_TIMEOUT_S)
            raise

    @property
    def pid(self) -> int:
        """Of the process that holds the screen."""
        pid: int = self.processes["projector"].pid
        return pid

    def renew(self, lease: Lease) -> None:
        """Replace the lease."""
        self._leases.put(lease)

    def darken(self) -> None:
        """Withdraw the lease."""
        self._leases.put(Lease.none(LightPhase.DARK, time.monotonic()))

    def end(self) -> None:
        """Withdraw the lease for good."""
        self._leases.put(Lease.none(LightPhase.OVER, time.monotonic()))

    def shown(self) -> Shown:
        """Return what is on the screen now."""
        is_unguarded = not self.processes["guardian"].is_alive() or self._panel.age_s("guardian") > _SILENT_S
        if is_unguarded and self._panel.age_s("projector") > HUNG_S:
            self.processes["projector"].kill()  # both hang: nobody else is left to do it
        for name, process in self.processes.items():
            if not process.is_alive():
                if name == "projector":
                    self._panel.tell_ended()
                raise DeviceGoneError("projector", self._why_ended(name))
        if (silent_s := self._panel.age_s("guardian")) > _SILENT_S:
            raise DeviceError("projector", f"its guardian has given no sign of life for {silent_s:.2f} s")
        if (silent_s := self._panel.age_s("projector")) > _SILENT_S:
            raise DeviceError("projector", f"has given no sign of life for {silent_s:.2f} s")
        found = self._shown.newest()
        assert found is not None  # put before the process says that it is ready
        return found[1]

    def close(self) -> None:
        """Black, and end the processes."""
        projector, guardian = (self.processes[name] for name in ("projector", "guardian"))
        with contextlib.suppress(OSError):
            self._guard.send_bytes(CLOSING)
        self._leases.put(Lease.none(LightPhase.CLOSED, time.monotonic()))
        for process in (projector, guardian):
            process.join(_END_TIMEOUT_S)
            if process.is_alive():
                process.kill()
                process.join()
        self._panel.tell_ended()

    def _why_ended(self, name: str) -> str:
        with contextlib.suppress(EOFError, OSError):
            while self._guard.poll():
                self._alarm = self._alarm or self._guard.recv_bytes().decode()
        with contextlib.suppress(EOFError, OSError):
            self._fault = self._fault or (self._faults.recv_bytes().decode() if self._faults.poll() else "")
        if self._alarm and self._alarm != "has ended":
            return f"its process {self._alarm}, was covered and ended"
        whose = "its process" if name == "projector" else "its guardian"
        return self._fault or f"{whose} has ended (exit code {self.processes[name].exitcode})"


def _begun(connection: Connection[Any, Any], who: str) -> None:
    """Wait for a new process to say that it has begun.

    Raises
    ------
    DeviceError
        It says that it cannot, ends, or says nothing.
    """
    if not connection.poll(_START_TIMEOUT_S):
        raise DeviceError(who, f"has not started within {_START_TIMEOUT_S:g} s")
    try:
        fault = connection.recv_bytes().decode()
    except EOFError:
        fault = "its process has ended"
    if fault:
        raise DeviceError(who, fault.removeprefix(f"{who}: "))


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


def _run(
    parts: ProjectorParts, clock: Clock, due: _Due, folder: Path, parent: Connection[Any, Any],
    life: Connection[Any, Any],
) -> None:  # fmt: skip
    """Project until the print is over; `life` is held open as long as this process lives."""
    leave_interrupts_to_the_print()
    with contextlib.suppress(OSError, AttributeError):
        os.nice(-10)  # as far as the system lets: light must be right before anything else
    with (
        life,
        Mailbox(folder / "shown", Shown, 1000) as shown,
        parts.log.open("w", newline="", encoding="utf-8") as file,
    ):
        log = LineWriter(partial(_write_through, file))
        try:
            screen = parts.make_screen()
        except Exception as error:
            parent.send_bytes(str(error).encode())
            return
        shown.put(Shown(None, clock.now_s()))
        try:
            projecting = _Projecting(
                screen, clock, due, LightPanel(folder), Mailbox(folder / "lease", Lease), shown, log
            )
            parent.send_bytes(b"")
            projecting.go_on()
        except VialightError as error:
            parent.send_bytes(str(error).removeprefix("projector: ").encode())
        finally:
            screen.close()
            shown.put(Shown(None, clock.now_s()))
            log.close()


def _write_through(file: TextIO, text: str) -> None:
    """Write at once: others follow the file."""
    file.write(text)
    file.flush()


@dataclass
class _Projecting:
    """What is on the screen, and why."""

    screen: Screen
    clock: Clock
    due: _Due
    panel: LightPanel
    leases: Mailbox[Lease]
    shown: Mailbox[Shown]
    log: LineWriter
    is_over: bool = False
    on_screen: int | None = field(default=None)

    def go_on(self) -> None:
        giver = multiprocessing.parent_process()
        assert giver is not None
        self.log.put("refresh_s,shown_s,due,shown\n")
        period_s = 1 / self.screen.refresh_hz
        refresh = int(self.clock.now_s() / period_s)
        while not wait([giver.sentinel], timeout=0):
            self.panel.beat("projector")
            self.screen.tend()
            lease = (self.leases.newest() or (0, None))[1]
            if lease is not None and lease.phase == LightPhase.CLOSED:
                return
            coming = int(self.clock.now_s() / period_s)
            before, wanted = self.on_screen, self._wanted(lease, (coming + 0.5) * period_s, is_new=coming > refresh)
            if wanted != before:
                self._show(wanted)
            if self.is_over and self.on_screen is None:
                self.panel.tell_ended()
            if before is not None or wanted is not None:
                for missed in range(refresh + 1, coming):
                    assert lease is not None  # without one nothing has been lit
                    wanting = self.due.at(lease, (missed + 0.5) * period_s)
                    self.log.put(f"{missed * period_s:.4f},,{wanting},{_code(before)}\n")
                if coming > refresh or wanted != before:
                    code = _code(wanted)
                    self.log.put(f"{coming * period_s:.4f},{self.clock.now_s():.4f},{code},{code}\n")
            refresh = coming
            # Never longer than a fraction of the lease, even where the print's clock stands still.
            left_s = ((refresh + 1) * period_s - self.clock.now_s()) / self.clock.rate
            time.sleep(min(max(left_s, 0.0005), 0.02))

    def _wanted(self, lease: Lease | None, middle_s: float, *, is_new: bool) -> int | None:
        """Return the pattern that is to be shown; a pattern changes with a new refresh only, black comes at once."""
        self.is_over, may_light = judge(
            self.is_over, self.panel.is_stopped, lease, time.monotonic(), self.clock.now_s()
        )
        if not may_light or lease is None:
            return None
        return self.due.at(lease, middle_s) if is_new else self.on_screen

    def _show(self, pattern: int | None) -> None:
        self.screen.show(pattern)
        self.on_screen = pattern
        self.shown.put(Shown(pattern, self.clock.now_s()))


def _code(pattern: int | None) -> int:
    return -1 if pattern is None else pattern
