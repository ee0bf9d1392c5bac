"""What it costs that a recording is on the disk for certain: frames as fast as they can be written, with and without.

    python benchmarks/durability.py [FOLDER]

The folder should be on the disk that will hold the runs; by default it is the current one.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vialight.store import FrameWriter

SHAPE, FRAMES = (300, 480), 600
"""As the sample print's; a minute of it."""


def measure(folder: Path, sync_every_s: float | None) -> tuple[float, NDArray[np.float64], float]:
    """Return frames/s, the time of each append in ms, and the time that closing takes in ms."""
    random = np.random.default_rng(0)
    pool = random.poisson(80.0, (16, *SHAPE)).astype(np.uint16)
    times_ms = np.empty(FRAMES)
    writer = FrameWriter(folder / f"{sync_every_s}.h5", SHAPE, sync_every_s=sync_every_s)
    begun = time.perf_counter()
    for index in range(FRAMES):
        before = time.perf_counter()
        writer.append(pool[index % len(pool)], 0.03 * index, 0.1 * index)
        times_ms[index] = 1e3 * (time.perf_counter() - before)
    lasted_s = time.perf_counter() - begun
    before = time.perf_counter()
    writer.close()
    return FRAMES / lasted_s, times_ms, 1e3 * (time.perf_counter() - before)


def main() -> None:
    """Print a table."""
    where = sys.argv[1] if len(sys.argv) > 1 else "."
    print(f"{FRAMES} frames of {SHAPE[0]} x {SHAPE[1]}")
    print("synced        frames/s   ms a frame (median, 99 %, longest)   close ms")
    for name, every_s in (("never", None), ("every 1 s", 1.0), ("every 0.1 s", 0.1)):
        with tempfile.TemporaryDirectory(dir=where) as folder:
            rate, times_ms, close_ms = measure(Path(folder), every_s)
        middle, late = np.percentile(times_ms, [50, 99])
        print(f"{name:12s} {rate:9.0f}   {middle:8.2f} {late:8.2f} {times_ms.max():8.2f} {close_ms:19.1f}")


if __name__ == "__main__":
    main()
