"""Where prints are watched: the simulated printer, and instruments at real transports with a window under Xvfb."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from fault_verdicts import Change

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # its printers are the tests'

from devices.cameras.fake import fake_camera
from devices.gcs2 import Controller, served_over_tcp
from devices.test_whole_print import STAGE_LATENCY_DEG, plan_for, rig_at
from devices.xvfb import Xvfb
from printing.prints import BINNING, TURN_S, write_quick_plan
from vialight.devices.simulated.display import BLACK, read_flips
from vialight.devices.simulated.motion import Segments, angle_at
from vialight.store import rig_to_toml, write_plan
from vialight.system.mailboxes import Mailbox

TURNS = 3
_STDERR = "told.txt"


class Watched(Protocol):
    """The light and the stage of one print, as they truly are."""

    def is_lit(self) -> bool:
        """Whether there has been light."""
        ...

    def changes(self) -> list[Change]:
        """Return every change of light so far."""
        ...

    def angle_at(self, time_s: float) -> float:
        """Return the stage's true angle at a time of the print's clock, rad."""
        ...

    def close(self) -> None:
        """Let go."""
        ...


class Scene(Protocol):
    """A printer to print with, again and again."""

    rate: float
    """Seconds of the print in one of the wall clock."""
    turn_s: float
    """Of the print's clock."""
    angle_bound_deg: float
    """By which a recorded angle may be off."""

    def printing(
        self, folder: Path, options: Sequence[str]
    ) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
        """Begin to print into ``run`` in a folder; the instruments are let go at the end."""
        ...

    def watch(self, shared: Path) -> Watched:
        """Watch a print from now on, also when its shared folder has gone."""
        ...

    def told(self, folder: Path) -> str:
        """Return what the print has told on the terminal."""
        ...


class SimulatedScene:
    """`vialight print` on the simulated printer, coarse and quick."""

    rate, turn_s = 4.0, TURN_S
    angle_bound_deg = 0.5

    @contextlib.contextmanager
    def printing(self, folder: Path, options: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
        """Begin to print."""
        write_quick_plan(folder)
        yield _started(folder, ["--resin-voxel", "0.5", "--bin", str(BINNING), "--rate", f"{self.rate:g}", *options])

    def watch(self, shared: Path) -> _WatchedFlips:
        """Watch it."""
        return _WatchedFlips(shared)

    def told(self, folder: Path) -> str:
        """Return what it has told."""
        return (folder / _STDERR).read_text(encoding="utf-8", errors="replace")


class _WatchedFlips:
    """The simulated display's own record of its light, and the simulated stage's motion.

    Both are linked from a folder beside the print's: they stay when that one goes.
    """

    def __init__(self, shared: Path) -> None:
        self._kept = Path(tempfile.mkdtemp(prefix="kept-by-faults-", dir=shared.parent))
        os.link(shared / "flips", self._kept / "flips")
        self._motion = Mailbox(shared / "motion", Segments)

    def is_lit(self) -> bool:
        return any(change.is_lit for change in self.changes())

    def changes(self) -> list[Change]:
        return [Change(flip.monotonic_s, flip.pattern != BLACK) for flip in read_flips(self._kept)]

    def angle_at(self, time_s: float) -> float:
        return angle_at((self._motion.newest() or (0, ()))[1], time_s)

    def close(self) -> None:
        self._motion.close()
        shutil.rmtree(self._kept, ignore_errors=True)


class WindowScene:
    """`vialight print` with a GigE Vision camera, a stage over TCP and a window, in real time.

    Parameters
    ----------
    screen
        On which the window is.
    environment
        Variables of the print's, such as where its curtain keeps its state.
    """

    rate, turn_s = 1.0, TURN_S
    angle_bound_deg = STAGE_LATENCY_DEG

    def __init__(self, screen: Xvfb, environment: Mapping[str, str]) -> None:
        self._screen = screen
        self._environment = {"DISPLAY": screen.display, "LIBGL_ALWAYS_SOFTWARE": "1", **environment}

    @contextlib.contextmanager
    def printing(self, folder: Path, options: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
        """Begin to print."""
        self._controller = Controller()
        with fake_camera(), served_over_tcp(self._controller) as address:
            rig = rig_at(address)
            write_plan(folder / "plan.h5", plan_for(rig))
            (folder / "rig.toml").write_text(rig_to_toml(rig), encoding="utf-8")
            yield _started(folder, options, self._environment)

    def watch(self, shared: Path) -> _WatchedScreen:
        """Watch it."""
        return _WatchedScreen(self._screen, self._controller)

    def told(self, folder: Path) -> str:
        """Return what it has told."""
        return (folder / _STDERR).read_text(encoding="utf-8", errors="replace")


class _WatchedScreen:
    """The pixels of the screen, looked at every two milliseconds, and the controller's own motion."""

    def __init__(self, screen: Xvfb, controller: Controller) -> None:
        self._screen, self._controller = screen, controller
        self._changes: list[Change] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._look, name="screen", daemon=True)
        self._thread.start()

    def is_lit(self) -> bool:
        return any(change.is_lit for change in list(self._changes))

    def changes(self) -> list[Change]:
        return list(self._changes)

    def angle_at(self, time_s: float) -> float:
        return self._controller.angle_at(time_s) * np.pi / 180

    def close(self) -> None:
        self._ending.set()
        self._thread.join()

    def _look(self) -> None:
        was_lit = False
        while not self._ending.wait(0.002):
            is_lit = not self._screen.is_black()
            if is_lit != was_lit:
                self._changes.append(Change(time.monotonic(), is_lit))
            was_lit = is_lit


@contextlib.contextmanager
def window_scene() -> Iterator[WindowScene]:
    """Run a screen with a white desktop, for prints to be shown on."""
    with tempfile.TemporaryDirectory(prefix="vialight-faults-screen-") as name:
        screen = Xvfb(Path(name))
        screen.light_the_desktop()
        try:
            yield WindowScene(screen, {"XDG_RUNTIME_DIR": name})
        finally:
            screen.close()


def _started(
    folder: Path, options: Sequence[str], environment: Mapping[str, str] | None = None
) -> subprocess.Popen[str]:
    command = [
        str(Path(sys.executable).with_name("vialight")), "print", "plan.h5", "--rig", "rig.toml", "--out", "run",
        "--resin", "DUDMA", "--voxel", "1.0", "--stop", f"turns={TURNS}", *options,
    ]  # fmt: skip
    with (folder / _STDERR).open("wb") as told:
        # In a group of its own, as a terminal starts it.
        return subprocess.Popen(
            command,
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=told,
            text=True,
            start_new_session=True,
            env={**os.environ, **(environment or {})},
        )
