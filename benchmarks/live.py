"""Time what each arriving frame costs the live volume, and measure how far it drifts from a fresh reconstruction.

Usage: ``python benchmarks/live.py [--short] [--markdown docs/benchmarks-replaying.md]``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from reconstruction import CORES, machine
from synthetic import COLUMNS, DARK_COUNTS, FRAMES, Problem, rig

from vialight.core.arrays import Grid
from vialight.core.config import Rig
from vialight.tomography.sliding import window as window_module
from vialight.tomography.sliding.window import SlidingWindow
from vialight.tomography.volume import reconstruct_slices

ROWS = 300
TURNS, SHORT_TURNS = 20, 2
LATEST, DROPPED, LATE = 4, 0.05, 0.05
STEP_RAD = 2 * np.pi / FRAMES
STAGES = {
    "read_view": "read the frame along rays",
    "renew_rays": "interpolate rays in angle",
    "fold_changes": "fold opposite angles",
    "filter_few": "filter",
    "add_projections": "backproject and sum up",
}


@dataclass(frozen=True)
class Case:
    """A size that is measured.

    Parameters
    ----------
    name
        As it stands in the table.
    binning
        Of the 300 x 480 frames, before they are fed.
    voxels
        Across the grid; the field fills it, or leaves a margin as in the benchmark of reconstruction.
    is_filled
        Which of the two.
    frames_per_s
        Rate to keep up with.
    """

    name: str
    binning: int
    voxels: int
    is_filled: bool
    frames_per_s: float

    @property
    def rig(self) -> Rig:
        """Of the frames."""
        whole = rig(ROWS)
        return whole.model_copy(update={"camera": whole.need_camera().binned(self.binning)})

    @property
    def grid(self) -> Grid:
        """The voxels: as many slices as the frames have rows."""
        optics = self.rig.imaging_optics()
        assert optics is not None
        across = self.voxels if self.is_filled else 0.9 * self.voxels
        return Grid((ROWS // self.binning, self.voxels, self.voxels), 2 * optics.field_radius_mm / across)


CASES = [
    Case("300 x 480, field fills 480 x 480 x 300 voxels", 1, 480, True, 10),
    Case("300 x 480, field fills 90 % of 480 x 480 x 300 voxels", 1, 480, False, 10),
    Case("150 x 240, field fills 240 x 240 x 150 voxels", 2, 240, True, 30),
]


@dataclass(frozen=True)
class Found:
    """What was measured of a case; times in ms a frame, one after another."""

    frames: int
    add_ms: float
    renew_ms: float
    median_ms: float
    p95_ms: float
    slowest_ms: float
    processor_ms: float
    catching_up_ms: float
    stages_ms: dict[str, float]
    peak_mb: float
    error: float


def arrivals(turns: int, seed: int = 0) -> Iterator[tuple[int, float, float]]:
    """Yield pool frame, stage angle and brightness: jittered, never at the same angle, some lost, some late."""
    rng = np.random.default_rng(seed)
    number = np.arange(turns * FRAMES)
    angles = number * STEP_RAD * 1.0013 + rng.uniform(-0.25, 0.25, len(number)) * STEP_RAD
    late = np.where(rng.random(len(number)) < LATE, rng.integers(1, LATEST + 1, len(number)) + 0.5, 0)
    order = np.argsort(number + late)
    for i in order[rng.random(len(order)) > DROPPED]:
        yield int(i) % FRAMES, float(angles[i]), 0.2 + 0.8 * i / len(number)


def measure(case: Case, turns: int) -> Found:
    """Stream frames as fast as they are taken and measure."""
    pool = _pool(case.binning)
    made = _window(case, pool)
    spent: dict[str, float] = {}
    adds, renewals = [], []
    for frame, angle, brightness in arrivals(1, seed=1):  # compiles, and fills the first turn
        made.add(_dimmed(pool[frame], brightness, case), angle - 2 * np.pi)
        made.renew()
    processor_start = time.process_time()
    preparing = 0.0
    with _timers(spent):
        for frame, angle, brightness in arrivals(turns):
            begin = time.process_time()
            counts = _dimmed(pool[frame], brightness, case)
            preparing += time.process_time() - begin
            start = time.perf_counter()
            made.add(counts, angle)
            added = time.perf_counter()
            made.renew()
            adds.append(added - start)
            renewals.append(time.perf_counter() - added)
    processor = time.process_time() - processor_start - preparing
    peak = _peak_mb() - pool.nbytes / 1e6
    totals = 1000 * (np.array(adds) + np.array(renewals))
    return Found(
        frames=len(totals),
        add_ms=float(1000 * np.median(adds)),
        renew_ms=float(1000 * np.median(renewals)),
        median_ms=float(np.median(totals)),
        p95_ms=float(np.quantile(totals, 0.95)),
        slowest_ms=float(totals.max()),
        processor_ms=1000 * processor / len(totals),
        catching_up_ms=_catching_up(made, pool, case, turns),
        stages_ms={name: 1000 * seconds / len(totals) for name, seconds in spent.items()},
        peak_mb=peak,
        error=drift(made),
    )


def drift(made: SlidingWindow) -> float:
    """Return the largest difference to a fresh reconstruction of the same rows, in parts of the largest density."""
    made.renew(everything=True)
    rows, live, grid = made.sinogram, made.volume, made.grid
    fresh_largest = largest = 0.0
    inside = live.any(axis=0)
    for start in range(0, grid.shape[0], 50):
        block = slice(start, start + 50)
        fresh = reconstruct_slices(rows[:, :, block], made.beam, grid.x_mm, grid.y_mm)
        largest = max(largest, float(np.abs(live[block] - fresh)[:, inside].max()))
        fresh_largest = max(fresh_largest, float(fresh[:, inside].max()))
    return largest / fresh_largest


def _catching_up(made: SlidingWindow, pool: NDArray[np.uint16], case: Case, turns: int) -> float:
    """Return ms a frame where ten wait and are taken into one renewal."""
    angle = turns * FRAMES * STEP_RAD * 1.0013
    times = []
    for group in range(3):
        start = time.perf_counter()
        for i in range(10):
            made.add(pool[10 * group + i], angle + (10 * group + i) * STEP_RAD)
        made.renew()
        times.append((time.perf_counter() - start) / 10)
    del case
    return float(1000 * np.median(times))


def _window(case: Case, pool: NDArray[np.uint16]) -> SlidingWindow:
    shape = (pool.shape[1], pool.shape[2])
    dark = np.full(shape, DARK_COUNTS * float(case.binning**2))
    # Half of the brightest body: what is above it is about what a print has cured.
    threshold = 500.0 * case.binning**2
    return SlidingWindow(case.rig, shape, FRAMES, dark=dark, threshold=threshold, grid=case.grid)


def _pool(binning: int) -> NDArray[np.uint16]:
    frames = Problem(ROWS).frames()
    blocks = frames.reshape(FRAMES, ROWS // binning, binning, COLUMNS // binning, binning)
    return np.asarray(blocks.sum(axis=(2, 4)), dtype=np.uint16)


def _dimmed(counts: NDArray[np.uint16], brightness: float, case: Case) -> NDArray[np.uint16]:
    dark = DARK_COUNTS * case.binning**2
    return np.asarray((counts.astype(np.float32) - dark) * np.float32(brightness) + dark, dtype=np.uint16)


def _timers(spent: dict[str, float]) -> ExitStack:
    timers = ExitStack()
    for verb in STAGES:
        timers.enter_context(patch.object(window_module, verb, _timed(getattr(window_module, verb), verb, spent)))
    return timers


def _timed(verb: Callable[..., Any], name: str, spent: dict[str, float]) -> Callable[..., Any]:
    def timed(*arguments: Any, **options: Any) -> Any:
        start = time.perf_counter()
        try:
            return verb(*arguments, **options)
        finally:
            spent[name] = spent.get(name, 0.0) + time.perf_counter() - start

    return timed


def _peak_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1000


def report(results: list[tuple[Case, Found]], host: str, command: str) -> str:
    """Return what was found as Markdown."""
    lines = [
        "# Benchmark of the live volume",
        "",
        f"Made by `{command}`. {host}",
        "",
        "| frames, voxels | add, ms | renew, ms | both, median | 95 % | slowest | processor | ten at once, a frame |"
        " goal, ms | peak, MB | drift |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    lines += [
        f"| {case.name} | {found.add_ms:.1f} | {found.renew_ms:.1f} | {found.median_ms:.1f} | {found.p95_ms:.1f} "
        f"| {found.slowest_ms:.1f} | {found.processor_ms:.1f} | {found.catching_up_ms:.1f} "
        f"| {1000 / case.frames_per_s:.0f} | {found.peak_mb:.0f} | {found.error:.1e} |"
        for case, found in results
    ]
    case, found = results[0]
    lines += ["", f"Mean ms a frame of {case.name}:", "", "| stage | ms |", "| --- | ---: |"]
    lines += [f"| {text} | {found.stages_ms[verb]:.1f} |" for verb, text in STAGES.items()]
    lines += [
        "",
        f"{found.frames} frames a case, after a turn that does not count, fed as fast as they are taken; each is added "
        f"and the volume renewed. Their angles never repeat and jitter by a quarter of a step; {DROPPED:.0%} are lost, "
        f"{LATE:.0%} come up to {LATEST} frames late, and the object grows brighter fivefold. Processor: of all "
        "threads. Peak: of the process, without the frames that are fed. Drift: largest difference, after all of them, "
        "to the reconstruction of the same rows at once, in parts of the largest density; the goal is 1e-4.",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure each case in a process of its own and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help=f"{SHORT_TURNS} turns instead of {TURNS}")
    parser.add_argument("--markdown", type=Path, help="also write the report here")
    parser.add_argument("--case", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    turns = SHORT_TURNS if options.short else TURNS
    if options.case is not None:
        print(json.dumps(asdict(measure(CASES[options.case], turns))))
        return
    _keep_to_cores()
    host = machine()[0]
    results = []
    for number, case in enumerate(CASES):
        arguments = [sys.executable, __file__, "--case", str(number)] + (["--short"] if options.short else [])
        told = subprocess.run(arguments, check=True, stdout=subprocess.PIPE, text=True).stdout
        results.append((case, Found(**json.loads(told))))
    command = "python benchmarks/live.py" + (
        " --short" if options.short else " --markdown docs/benchmarks-replaying.md"
    )
    text = report(results, host, command)
    print(text)
    if options.markdown:
        options.markdown.write_text(text, encoding="utf-8")


def _keep_to_cores() -> None:
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) > CORES:
        os.sched_setaffinity(0, cores[:CORES])
        os.execv(sys.executable, [sys.executable, *sys.argv])


if __name__ == "__main__":
    main()
