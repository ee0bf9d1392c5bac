"""The guardian: a process that watches the projector's, and covers its light where that hangs or does not obey.

A projector's process goes black by itself when its leave ends; one that hangs does nothing by itself.  So another
process, which does nothing else, looks at its signs of life a hundred times a second.  Where they stop it draws a cover
over the light and ends the projector's process.  The session watches the guardian in turn.
"""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol

import psutil

from vialight.core.errors import VialightError
from vialight.devices.leasing import LOOK_S, Sight, Vigil
from vialight.devices.panel import LightPanel
from vialight.devices.protocols import Lease, LightPhase, Shown
from vialight.system import leave_interrupts_to_the_print, state_of, wait_for
from vialight.system.mailboxes import Mailbox

CLOSING = b"closing"
_CLOSING_S = 3.0
"""That the projector may take to end when it was told to."""
_ENDS_WITHIN_S = 0.2
"""That a process which is killed takes to end."""
_ORPHANED_S = 0.2
"""That the projector may take to end by itself when the process that prints has ended."""


class Cover(Protocol):
    """Something black that can be drawn over the projector's light."""

    def cover(self) -> None:
        """Draw it; returns when no light comes through."""
        ...

    def tend(self) -> None:
        """Do what is to be done between looks."""
        ...

    def close(self) -> None:
        """Take it away, where it was drawn."""
        ...


class CoverMaker(Protocol):
    """Makes the cover, in the guardian's process; must be picklable."""

    def __call__(self) -> Cover:
        """Return a cover that is not drawn."""
        ...


@dataclass(frozen=True)
class Ward:
    """Who is guarded.

    Parameters
    ----------
    make_cover
        Called in the guardian's process.
    folder
        The print's shared folder.
    pid
        Of the projector's process.
    """

    make_cover: CoverMaker
    folder: Path
    pid: int


def guard(ward: Ward, session: Connection[Any, Any], alive: Connection[Any, Any]) -> None:
    """Watch until the projector has ended.

    Parameters
    ----------
    ward
        Who is guarded.
    session
        Told an empty message when the watch begins, or what keeps it from that, and the reason of every alarm.  What
        comes from it is the wish to close; its end is that of the process that prints.
    alive
        Ends with the projector's process.
    """
    leave_interrupts_to_the_print()
    with contextlib.suppress(OSError, AttributeError):
        os.nice(-10)
    try:
        watch = _Watch(ward)
    except (VialightError, psutil.Error) as error:
        session.send_bytes(str(error).encode())
        return
    session.send_bytes(b"")
    try:
        watch.keep(session, alive)
    finally:
        watch.close()


@dataclass
class _Watch:
    ward: Ward
    vigil: Vigil = field(default_factory=Vigil)

    def __post_init__(self) -> None:
        self._panel = LightPanel(self.ward.folder)
        self._shown = Mailbox(self.ward.folder / "shown", Shown)
        self._leases = Mailbox(self.ward.folder / "lease", Lease)
        self._projector = psutil.Process(self.ward.pid)
        self._cover = self.ward.make_cover()
        self._panel.beat("guardian")

    def close(self) -> None:
        self._cover.close()

    def keep(self, session: Connection[Any, Any], alive: Connection[Any, Any]) -> None:
        must_end_s = float("inf")
        is_closing = False
        watched: list[Connection[Any, Any]] = [session, alive]
        while True:
            self._panel.beat("guardian")
            ready = wait(watched, timeout=LOOK_S)
            if alive in ready:  # it says nothing: this is its end
                if not is_closing:
                    self._panel.tell_covered()  # its light went with it
                    self._draw()
                    _tell(session, "has ended")
                    _wait_for_end(session, self._panel, self._cover)
                return
            if session in ready:
                is_closing = _is_told_to_close(session)
                watched.remove(session)
                must_end_s = time.monotonic() + (_CLOSING_S if is_closing else _ORPHANED_S)
            self._cover.tend()
            why = self.vigil.alarm(self._look())
            if why is None and time.monotonic() > must_end_s:
                why = "has not ended"
            if why is not None:
                self._kill()
                self._draw()
                _tell(session, why)
                if not is_closing:
                    _wait_for_end(session, self._panel, self._cover)
                return

    def _look(self) -> Sight:
        now = time.monotonic()  # before what is looked at: time that passes in between must not count against it
        beat_s = self._panel.last_beat_s("projector")
        lease, shown = self._leases.newest(), self._shown.newest()
        return Sight(
            now,
            beat_s,
            shown is not None and shown[1].pattern is not None,
            lease[1].until_monotonic_s if lease is not None else 0.0,
            lease is not None and lease[1].phase == LightPhase.LIT,
            self._panel.is_stopped,
        )

    def _kill(self) -> None:
        """End the projector's process first: that waits for no graphics driver, as the cover may have to."""
        with contextlib.suppress(psutil.Error, OSError):
            self._projector.kill()

    def _draw(self) -> None:
        """Draw the cover; say that it is dark only when that is known."""
        try:
            self._cover.cover()
        except Exception:  # whatever a window system says: where the process has ended, its window is gone, too
            if wait_for(lambda: state_of(self.ward.pid) == "gone", timeout_s=_ENDS_WITHIN_S) is None:
                self._panel.tell_covered()
        else:
            self._panel.tell_covered()


def _tell(session: Connection[Any, Any], why: str) -> None:
    with contextlib.suppress(OSError):
        session.send_bytes(why.encode())


def _is_told_to_close(session: Connection[Any, Any]) -> bool:
    try:
        return session.recv_bytes(64) == CLOSING
    except (EOFError, OSError):
        return False


def _wait_for_end(session: Connection[Any, Any], panel: LightPanel, cover: Cover) -> None:
    """Keep the cover drawn until the print is over."""
    while not wait([session], timeout=LOOK_S):
        panel.beat("guardian")
        cover.tend()
