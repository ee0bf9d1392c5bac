"""Kill prints at random moments, and look what became of frames and light.

Usage: ``python benchmarks/killing.py [--prints 10] [--seed 0]``.

Each print runs on the simulated printer in all its processes, as ``vialight print`` does.  Some seconds after the light
went on, one process is killed (SIGKILL): that of the print, the projector's, or the one that renews the live volume.
Frames that others had been told are on disk must be readable afterwards, with the same counts, and the display must be
black 0.25 s later.  After the live volume's process the light comes back once it follows again.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from vialight.commands import PlanSettings, plan_part
from vialight.devices.simulated.display import BLACK, Flip, read_flips
from vialight.links import CameraImage, LiveLink, Mailbox, find_live_print
from vialight.store import open_frames

VICTIMS = {"print": "", "projector": "/lease", "live volume": "/snapshot"}
"""Process to a file that it has mapped."""
DARK_WITHIN_S = 0.25
_PATIENCE_S = 300.0


@dataclass(frozen=True)
class Killed:
    """What became of a print."""

    victim: str
    after_s: float
    acknowledged: int
    readable: int
    dark_after_s: float


def main() -> None:
    """Kill prints and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prints", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    sample = Path(str(files("vialight") / "sample"))
    with tempfile.TemporaryDirectory(prefix="vialight-killing-") as name:
        folder = Path(name)
        settings = PlanSettings(voxel_mm=0.4, angles=90, passes=2)
        plan_part(sample / "part.stl", sample / "printer.toml", folder / "plan.h5", settings=settings, page=False)
        print("| killed | after light for, s | frames acknowledged | readable | dark after, s |")
        print("| --- | ---: | ---: | ---: | ---: |")
        found = []
        for number in range(options.prints):
            victim = list(VICTIMS)[number % len(VICTIMS)]
            one = kill_a_print(folder, sample / "printer.toml", folder / f"run{number}", victim, rng.uniform(0.3, 6))
            found.append(one)
            print(
                f"| {one.victim} | {one.after_s:.2f} | {one.acknowledged} | {one.readable} | {one.dark_after_s:.3f} |",
                flush=True,
            )
    lost = sum(max(0, one.acknowledged - one.readable) for one in found)
    latest = max(one.dark_after_s for one in found)
    print(f"\n{lost} frames lost; dark after {latest:.3f} s at the latest ({DARK_WITHIN_S} allowed)")
    sys.exit(lost > 0 or latest > DARK_WITHIN_S)


def kill_a_print(folder: Path, rig: Path, run: Path, victim: str, after_s: float) -> Killed:
    """Start a print, kill one of its processes so long after the light went on, and look."""
    command = [
        str(Path(sys.executable).with_name("vialight")), "print", str(folder / "plan.h5"), "--rig", str(rig),
        "--out", str(run), "--stop", "turns=30", "--rate", "4", "--resin-voxel", "0.5", "--bin", "2",
    ]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        link = _wait_for(lambda: find_live_print(run))
        assert isinstance(link, LiveLink)
        shared = link.mailboxes
        _wait_for(lambda: any(flip.pattern != BLACK for flip in read_flips(shared)))
        time.sleep(after_s)
        camera = Mailbox(shared / "camera", CameraImage)
        doomed = psutil.Process(process.pid) if not VICTIMS[victim] else _child(process.pid, VICTIMS[victim])
        newest = camera.newest()
        killed_s = time.monotonic()
        os.kill(doomed.pid, signal.SIGKILL)
        time.sleep(2 * DARK_WITHIN_S)
        flips = read_flips(shared)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
    assert newest is not None
    image: CameraImage = newest[1]
    return Killed(victim, after_s, image.frame + 1, _readable(run, image), _dark_after_s(flips, killed_s))


def _readable(run: Path, newest: CameraImage) -> int:
    """Return how many frames can be read; -1 where the one acknowledged last is another now."""
    with open_frames(run / "frames.h5") as frames:
        count = sum(len(frames.read(slice(at, at + 64))) for at in range(0, frames.shape[0], 64))
        same = count > newest.frame and bool(
            (frames.read(slice(newest.frame, newest.frame + 1))[0] == newest.counts).all()
        )
        return count if same else -1


def _dark_after_s(flips: list[Flip], killed_s: float) -> float:
    """Return how long after the kill the display was first black; 0 where it was then."""
    before = [flip for flip in flips if flip.monotonic_s <= killed_s]
    if not before or before[-1].pattern == BLACK:
        return 0.0
    later = [flip for flip in flips if flip.monotonic_s > killed_s and flip.pattern == BLACK]
    return later[0].monotonic_s - killed_s if later else float("inf")


def _child(pid: int, word: str) -> psutil.Process:
    """Return the child process that has a file of the shared folder mapped by a name."""
    for one in psutil.Process(pid).children(recursive=True):
        if any(word in mapped.path for mapped in one.memory_maps()):
            return one
    raise LookupError(word)


def _wait_for(what: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline:
        if found := what():
            return found
        time.sleep(0.01)
    raise TimeoutError


if __name__ == "__main__":
    main()
