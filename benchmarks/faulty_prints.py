"""One print in all its processes, one of which is killed or stopped while it runs: what became of light and frames.

`faults` goes through all kinds of them, and a test through a few.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import psutil
from fault_scenes import Scene, Watched
from fault_verdicts import Found, judged

from vialight.core.errors import VialightError
from vialight.core.messages import CameraImage, PrintStatus
from vialight.printing.live_link import LiveLink, find_live_print
from vialight.printing.order_channel import send_order
from vialight.store import open_frames, read_json
from vialight.system.mailboxes import Mailbox

Victim = Literal["print", "projector", "guardian", "display", "world", "follower", "analyst", "page"]
Moment = Literal["preflight", "background", "first light", "printing", "last turn", "after", "measuring"]
Order = Literal["", "page", "Ctrl-C", "SIGTERM"]

STARTED_S, ENDED_S = 400.0, 150.0
"""By which a print comes to its moment (kernels are compiled where nothing has run before), and by which it ends."""
_LOOK_S = 0.002
_MEASURED_SHARE = 0.2
"""Of the prints, those that may go on to the end of their measurement."""
_ORPHANS_S = 6.0
"""That processes may outlive their print: the display and the page do, for a while."""
PAGE = "vialight page"
_T = TypeVar("_T")


@dataclass(frozen=True)
class Case:
    """What happens to a print.

    Parameters
    ----------
    victim
        Which of its processes the fault befalls.
    stopped_s
        For how long it is stopped (SIGSTOP); 0 kills it (SIGKILL).
    moment
        When.
    order
        Who stops the print shortly afterwards; empty for nobody.
    on_window
        Whether light comes from a real window.
    """

    victim: Victim
    stopped_s: float
    moment: Moment
    order: Order = ""
    on_window: bool = False

    @property
    def fault(self) -> str:
        """The fault in words."""
        return f"STOP {self.stopped_s:g} s" if self.stopped_s else "KILL"

    def __str__(self) -> str:
        screen = "window" if self.on_window else "simulated"
        return f"{self.victim}, {self.fault}, {self.moment}, {self.order or 'alone'}, {screen}"


class GoneError(Exception):
    """The process, or the print, is there no more when the fault's moment comes."""


@dataclass
class _Print:
    """A print that runs, seen from outside."""

    case: Case
    scene: Scene
    process: subprocess.Popen[str]
    run: Path
    rng: np.random.Generator
    link: LiveLink = field(init=False)
    watched: Watched = field(init=False)
    family: dict[int, psutil.Process] = field(default_factory=dict)

    def find(self) -> None:
        """Wait until it can be reached, and take hold of what tells of its light: its folder goes when it ends."""
        found = self.wait_for(lambda: find_live_print(self.run))
        self.link = found
        self.watched = self.scene.watch(found.mailboxes)
        self.status = Mailbox(found.mailboxes / "status", PrintStatus)
        self.camera = Mailbox(found.mailboxes / "camera", CameraImage)

    def wait_for(self, what: Callable[[], _T | None]) -> _T:
        """Return what comes to pass; `GoneError` where the print ends before."""
        deadline = time.monotonic() + STARTED_S
        while time.monotonic() < deadline:
            if found := what():
                return found
            if self.process.poll() is not None:
                raise GoneError("the print has ended")
            time.sleep(_LOOK_S)
        raise TimeoutError

    def wait_for_moment(self) -> None:
        """Return at a random time within the moment."""
        moment, turn_s = self.case.moment, self.scene.turn_s / self.scene.rate
        if moment == "preflight":
            within_s = 0.15
        elif moment == "background":
            self.wait_for(lambda: self._is_in("background"))
            within_s = 3 * turn_s
        elif moment == "first light":
            self.wait_for(lambda: self._is_in("printing", "dark"))
            within_s = 0.3
        elif moment == "printing":
            self.wait_for(self.watched.is_lit)
            within_s = turn_s
        elif moment == "last turn":
            self.wait_for(self._is_in_last_turn)
            within_s = 0.8 * turn_s
        elif moment == "after":
            self.wait_for(lambda: self._is_in("after"))
            within_s = 0.9 * turn_s
        elif self.case.victim in ("follower", "analyst"):  # they end when they have finished with what is recorded
            self.wait_for(lambda: self._is_in("after"))
            time.sleep(turn_s)
            within_s = 0.3
        elif self.case.victim == "print":
            self.wait_for(lambda: self.run.exists() and read_json(self.run / "run.json")["state"] == "done")
            within_s = 1.0
        else:
            self.wait_for(lambda: self._is_in("finishing"))
            within_s = 0.0
        time.sleep(within_s * self.rng.uniform())

    def is_over(self) -> bool:
        """Whether nothing is left to do but to measure the finished print."""
        with contextlib.suppress(VialightError, OSError):
            return bool(read_json(self.run / "run.json")["state"] in ("done", "failed"))
        return False

    def victim(self) -> psutil.Process:
        """Return the process that the fault is for; where it is still to start, when it has."""
        if self.case.victim == "print":
            return psutil.Process(self.process.pid)
        name = PAGE if self.case.victim == "page" else self.case.victim
        return self.wait_for(lambda: self._children().get(name))

    def stop(self) -> str:
        """Have it stopped by who is to do that; return what went wrong."""
        try:
            if self.case.order == "page":
                answer = send_order(self.link, {"do": "stop", "by": "page"})
                return "" if answer["is_dark"] and answer["is_over"] else f"Stop was answered {answer}"
            if self.case.order == "Ctrl-C":
                os.killpg(self.process.pid, signal.SIGINT)  # a terminal sends it to all processes of the print
            else:
                os.kill(self.process.pid, signal.SIGTERM)
        except ProcessLookupError:
            pass
        except VialightError as error:
            was_running = self.process.poll() is None and find_live_print(self.run) is not None
            return f"Stop was answered: {error}" if was_running else ""
        return ""

    def acknowledged(self) -> CameraImage | None:
        """Return the frame that others have been told last is recorded."""
        newest = self.camera.newest()
        return None if newest is None or newest[1].frame < 0 else newest[1]

    def remember_children(self) -> None:
        """Keep hold of the processes that it has started, to see that all of them end."""
        self._children()

    def left_over(self) -> list[str]:
        """Return, some seconds after its end, which of its processes are still there, and end them."""
        deadline = time.monotonic() + _ORPHANS_S
        while any(one.is_running() for one in self.family.values()) and time.monotonic() < deadline:
            time.sleep(0.1)
        left = [one for one in self.family.values() if one.is_running() and one.status() != psutil.STATUS_ZOMBIE]
        names = [_name(one) for one in left]
        for one in left:
            with contextlib.suppress(psutil.Error):
                one.kill()
        return names

    def _children(self) -> dict[str, psutil.Process]:
        with contextlib.suppress(psutil.NoSuchProcess):
            for one in psutil.Process(self.process.pid).children():
                if "curtain" not in " ".join(_command(one)):  # which is to stay
                    self.family[one.pid] = one
        return {_name(one): one for one in self.family.values() if one.is_running()}

    def _is_in(self, *states: str) -> bool:
        newest = self.status.newest()
        return newest is not None and newest[1].state in states

    def _is_in_last_turn(self) -> bool:
        newest = self.status.newest()
        if newest is None or newest[1].state not in ("printing", "dark") or newest[1].lit_s == 0:
            return False
        left_s = newest[1].remaining_s
        return left_s is not None and left_s <= self.scene.turn_s


def run_case(case: Case, scene: Scene, rng: np.random.Generator) -> Found:
    """Print, let the fault happen, wait for the end, and look.

    Parameters
    ----------
    case
        What happens.
    scene
        The printer.
    rng
        For when within the moment it happens.
    """
    with tempfile.TemporaryDirectory(prefix="vialight-faults-") as name, metronome() as beats:
        folder = Path(name)
        run = folder / "run"
        options = ["--serve"] if case.victim == "page" else []
        with scene.printing(folder, options) as process:
            printed = _Print(case, scene, process, run, rng)
            try:
                return _with_fault(printed, beats)
            finally:
                with contextlib.suppress(psutil.Error):
                    printed.remember_children()
                if process.poll() is None:
                    process.kill()
                process.wait()
                for one in printed.family.values():
                    with contextlib.suppress(psutil.Error):
                        one.kill()


def _with_fault(printed: _Print, beats: list[tuple[float, float]]) -> Found:
    case, rng = printed.case, printed.rng
    found = Found(str(case), case.victim, case.fault)
    try:
        printed.find()
        printed.wait_for_moment()
        victim = printed.victim()
        printed.remember_children()
        before = printed.acknowledged()
        fault_s = time.monotonic()
        victim.send_signal(signal.SIGSTOP if case.stopped_s else signal.SIGKILL)
    except (GoneError, psutil.NoSuchProcess) as gone:
        printed.process.wait(ENDED_S)
        found.was_gone = str(gone)
        if case.moment != "measuring" or printed.process.poll():
            told = printed.scene.told(printed.run.parent).strip()
            log = printed.run / "log.jsonl"
            entries = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
            faults = [entry for entry in entries if '"fault"' in entry or '"stop"' in entry][-4:]
            found.odd.append(f"ended ({printed.process.returncode}) before its moment: {told[-300:]} {faults}")
        return found
    order_s = None
    if case.order:
        time.sleep(rng.uniform(0.0, 0.4))
        order_s = time.monotonic()
        if told := printed.stop():
            found.odd.append(told)
    go_on_s = None
    if case.stopped_s:
        time.sleep(max(0.0, fault_s + case.stopped_s - time.monotonic()))
        go_on_s = time.monotonic()
        with contextlib.suppress(psutil.NoSuchProcess):
            victim.resume()
    deadline = time.monotonic() + ENDED_S
    is_measured = case.moment == "measuring" or rng.uniform() < _MEASURED_SHARE
    while printed.process.poll() is None and time.monotonic() < deadline:
        printed.remember_children()
        if not is_measured and printed.is_over():
            printed.process.kill()  # what follows is done in the dark, by nobody but the process itself
        time.sleep(0.05)
    if printed.process.poll() is None:
        found.odd.append(f"hangs: has not ended {ENDED_S:g} s after the fault")
        printed.process.kill()
    elif left := printed.left_over():
        found.odd.append(f"left behind: {', '.join(left)}")
    changes = printed.watched.changes()
    judged(found, case.victim, case.moment in ("after", "measuring"), changes, fault_s, go_on_s, order_s)
    found.late_s = max((late for at, late in beats if fault_s - 0.1 < at < (order_s or fault_s) + 1.0), default=0.0)
    _look_at_frames(found, printed, [before, printed.acknowledged()])
    told_all = printed.scene.told(printed.run.parent)
    if "Traceback" in told_all:
        lines = told_all[told_all.index("Traceback") :].strip().splitlines()
        found.odd.append("traceback: " + " / ".join(line.strip() for line in lines[-40:])[-800:])
    found.exit_code = printed.process.poll()
    printed.watched.close()
    return found


def _look_at_frames(found: Found, printed: _Print, acknowledged: list[CameraImage | None]) -> None:
    """See that what was acknowledged can be read, the same as it was, and that all angles are true."""
    files = [path for path in (printed.run / "frames.h5", printed.run / "background.h5") if path.exists()]
    counts = []
    for path in files:
        with open_frames(path) as frames:
            number = frames.shape[0]
            counts.append(frames.read(slice(None)) if number else np.empty((0, 0, 0), np.uint16))
            if number and frames.time_s is not None:
                true_rad = np.array([printed.watched.angle_at(float(at)) for at in frames.time_s])
                off_deg = np.abs(np.rad2deg(frames.angles_rad - true_rad))
                found.wrong_angles += int(np.count_nonzero(~(off_deg < printed.scene.angle_bound_deg)))
                found.largest_angle_deg = float(np.nanmax(np.append(off_deg, found.largest_angle_deg)))
            found.readable += number
    for image in acknowledged:
        if image is None:
            continue
        found.acknowledged = max(found.acknowledged, image.frame + 1)
        is_there = any(len(read) > image.frame and bool((read[image.frame] == image.counts).all()) for read in counts)
        if not is_there:
            most = max((len(read) for read in counts), default=0)
            found.lost = max(found.lost, image.frame + 1 - most, 1)


@contextlib.contextmanager
def metronome(every_s: float = 0.005) -> Iterator[list[tuple[float, float]]]:
    """Yield a list of when this process woke up and how much later than it asked for: what the machine itself adds."""
    beats: list[tuple[float, float]] = []
    ending = threading.Event()

    def beat() -> None:
        while not ending.is_set():
            asked = time.monotonic() + every_s
            time.sleep(every_s)
            beats.append((now := time.monotonic(), now - asked))

    thread = threading.Thread(target=beat, name="metronome", daemon=True)
    thread.start()
    try:
        yield beats
    finally:
        ending.set()
        thread.join()


def _name(one: psutil.Process) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{one.pid}/comm").read_text(encoding="utf-8").strip()
    return ""


def _command(one: psutil.Process) -> list[str]:
    try:
        return one.cmdline()
    except psutil.Error:
        return []
