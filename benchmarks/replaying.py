"""Replay a print as if it were live, and measure how late its snapshots are.

Usage: ``python benchmarks/replaying.py [--turns 20] [--binning 1] [--frames-per-s 10]``.

300 x 480 frames of an object that grows brighter, 480 x 480 x 300 voxels, or both smaller by the binning; through
`vialight.commands.watching`, with all that a print has: recording, live volume with each frame, surface once a second.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil  # type: ignore[import-untyped]
from reconstruction import machine
from synthetic import DARK_COUNTS, FRAMES

from live import CASES, _pool
from vialight.commands.watching import watch_run
from vialight.config import Stage
from vialight.store import FrameWriter, rig_to_toml


def main() -> None:
    """Replay and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--binning", type=int, default=1, choices=(1, 2))
    parser.add_argument("--frames-per-s", type=float, default=10.0)
    options = parser.parse_args()
    case = next(case for case in CASES if case.binning == options.binning and case.is_filled)
    with tempfile.TemporaryDirectory(prefix="vialight-replaying-") as name:
        run = Path(name)
        _record(run, options.binning, options.turns, options.frames_per_s, case)
        peak = _PeakMemory()
        with peak:
            told = watch_run(run, voxel_mm=case.grid.voxel_mm)
    shape = "x".join(str(count) for count in case.grid.shape)
    print(machine()[0])
    print(f"{told['frames']} frames at {options.frames_per_s:g}/s, about {shape} voxels:")
    median_ms, most_ms = 1000 * told["latency_p50_s"], 1000 * told["latency_p95_s"]
    print(f"  latency from arrival: median {median_ms:.0f} ms, 95 % within {most_ms:.0f} ms")
    print(f"  frames without a snapshot of their own: {told['frames_without_snapshot']}")
    print(f"  the live processes' memory at most: {peak.mb:.0f} MB")


def _record(run: Path, binning: int, turns: int, rate_hz: float, case: object) -> None:
    pool = _pool(binning)
    speed = 360 / FRAMES * rate_hz
    rig = CASES[0].rig.model_copy(update={"camera": CASES[0].rig.need_camera().binned(binning)})
    resin = rig.resin.model_copy(update={"threshold": 500.0 * binning**2})
    rig = rig.model_copy(update={"stage": Stage(speed_deg_s=speed), "resin": resin})
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
