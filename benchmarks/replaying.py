"""Replay prints as if they were live, and measure how late their snapshots are.

Usage: ``python benchmarks/replaying.py [--turns 20] [--cases 0 1 2] [--markdown docs/benchmarks-replaying.md]``.

Frames of an object that grows brighter, at the rate of a real print; through `vialight.commands.watch`, with all
that a print has: recording, live volume with each frame, surface once a second.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from live import CASES, Case, _pool
from reconstruction import machine
from synthetic import DARK_COUNTS, FRAMES

from vialight.commands.watch import watch_run
from vialight.core.config import Stage
from vialight.store import FrameWriter, rig_to_toml


@dataclass(frozen=True)
class Found:
    """What was measured of a replay."""

    frames: int
    median_ms: float
    p95_ms: float
    skipped: int
    surfaces: int
    peak_mb: float
    delays_s: tuple[float, float]


def main() -> None:
    """Replay each case and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--cases", type=int, nargs="+", default=[0, 1, 2], choices=range(len(CASES)))
    parser.add_argument("--markdown", type=Path, help="also write the report here")
    options = parser.parse_args()
    host = machine()[0]
    results = [(CASES[number], replay(CASES[number], options.turns)) for number in options.cases]
    text = report(results, host, " ".join(["python", "benchmarks/replaying.py", *sys.argv[1:]]))
    print(text)
    if options.markdown:
        options.markdown.write_text(text, encoding="utf-8")


def replay(case: Case, turns: int) -> Found:
    """Record a print of a case, and watch it."""
    with tempfile.TemporaryDirectory(prefix="vialight-replaying-") as name:
        run = Path(name)
        _record(run, case, turns)
        peak = _PeakMemory()
        with peak:
            told = watch_run(run, voxel_mm=case.grid.voxel_mm)
    return Found(
        told["frames"], 1000 * told["latency_p50_s"], 1000 * told["latency_p95_s"], told["frames_without_snapshot"],
        told["surfaces"], peak.mb, (told["refraction_delay_half_field_s"], told["refraction_delay_edge_s"]),
    )  # fmt: skip


def report(results: list[tuple[Case, Found]], host: str, command: str) -> str:
    """Return what was found as Markdown."""
    lines = [
        "# Benchmark of watching",
        "",
        f"Made by `{command}`. {host}",
        "",
        "| frames, voxels | frames | a second | latency, ms: median | 95 % | frames without a snapshot of their own |"
        " surfaces a second | memory, MB | refraction adds, s: half of the field | edge |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    lines += [
        f"| {case.name} | {found.frames} | {case.frames_per_s:g} | {found.median_ms:.0f} | {found.p95_ms:.0f} "
        f"| {found.skipped} | {found.surfaces * case.frames_per_s / found.frames:.2f} | {found.peak_mb:.0f} "
        f"| {found.delays_s[0]:.2f} | {found.delays_s[1]:.2f} |"
        for case, found in results
    ]
    lines += [
        "",
        "Latency: from the moment that the newest frame used came from the camera to that at which another process "
        "has the snapshot; the goal is 100 ms for 95 % of snapshots. Frames are recorded as in a print, and a surface "
        "is measured once a second beside it. Memory: of both live processes at most, what they share counted once; "
        "the goal is 3000 MB. What refraction adds is physics: rays through the sides of the vial pass later.",
        "",
    ]
    return "\n".join(lines)


def _record(run: Path, case: Case, turns: int) -> None:
    pool, binning, rate_hz = _pool(case.binning), case.binning, case.frames_per_s
    speed = 360 / FRAMES * rate_hz
    resin = case.rig.resin.model_copy(update={"threshold": 500.0 * binning**2})
    rig = case.rig.model_copy(update={"stage": Stage(speed_deg_s=speed), "resin": resin})
    (run / "rig.toml").write_text(rig_to_toml(rig), encoding="utf-8")
    dark = np.full(pool.shape[1:], DARK_COUNTS * binning**2, np.uint16)
    count = turns * FRAMES
    with FrameWriter(run / "frames.h5", (pool.shape[1], pool.shape[2]), dark=dark) as writer:
        for number in range(count):
            shown = (pool[number % FRAMES].astype(np.float32) - dark) * np.float32(0.2 + 0.8 * number / count) + dark
            writer.append(shown.astype(np.uint16), np.radians(number * 360 / FRAMES), number / rate_hz)


class _PeakMemory:
    """Looks, four times a second, at the memory that all child processes have between them."""

    def __init__(self) -> None:
        self.mb = 0.0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *ended: object) -> None:
        self._ending.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._ending.is_set():
            total = 0.0
            for child in psutil.Process().children(recursive=True):
                try:
                    total += child.memory_full_info().pss / 1e6
                except (psutil.Error, AttributeError):
                    continue
            self.mb = max(self.mb, total)
            time.sleep(0.25)


if __name__ == "__main__":
    main()
