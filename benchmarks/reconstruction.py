"""Time vialight and other packages on the same object, in one run, and print what they need as tables.

Usage: ``python benchmarks/reconstruction.py [--short] [--markdown docs/benchmarks.md]``.  Packages that are not
installed get a row that says so; those of the dependency group ``benchmark`` are asked for.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from peers import astra_fbp, finufft_fbp, skimage_fbp
from synthetic import COLUMNS, FRAMES, Problem

from vialight.core.arrays import Float32Array
from vialight.tomography import reconstruct as pipeline
from vialight.tomography import volume
from vialight.tomography.reconstruct import Settings, reconstruct

CORES = 2
SLICES, SHORT_SLICES = 300, 32
ROUNDS, SHORT_ROUNDS = 7, 1
STARTS = 5
REST_S, ROOM_GB = 0.5, 1
"""Before each method.  Threads of the one before (OpenMP) stay awake for a while, and would take a core from it; memory
that has lain idle has to be got back from the host of a virtual machine, which the first to want it would pay for."""
OURS = "vialight, from frames"
OURS_AS_USED = "vialight, from frames, the field alone"
NUFFT_GOAL, SKIMAGE_GOAL, MEMORY_GOAL_MB, HELP_GOAL_S, START_GOAL_S = 1.5, 80.0, 1300.0, 0.5, 3.0


@dataclass(frozen=True)
class Method:
    """A way to make the volume.

    Parameters
    ----------
    name
        As it stands in the table.
    package
        What has to be installed.
    data
        Which array of `make_data` it is fed.
    run
        Data in, volume out.
    on_all_slices
        Otherwise only those that are judged are made, and the time is scaled to all.
    """

    name: str
    package: str
    data: str
    run: Callable[[NDArray[Any]], Float32Array]
    on_all_slices: bool = True

    @property
    def is_installed(self) -> bool:
        """Whether its package is there."""
        return importlib.util.find_spec(self.package) is not None


@dataclass
class Result:
    """What was measured of a method; seconds are scaled to all slices."""

    seconds: list[float] = field(default_factory=list)
    processor_seconds: list[float] = field(default_factory=list)
    picture: Float32Array | None = None
    peak_mb: float = np.nan

    @property
    def best(self) -> float:
        """Shortest time."""
        return min(self.seconds)


def methods(problem: Problem) -> list[Method]:
    """Return all that are compared, vialight first."""
    psi, grid = problem.beam.psi_rad, problem.grid
    half_turn = psi[: FRAMES // 2]

    def as_used(frames: NDArray[Any]) -> Float32Array:
        return reconstruct(problem.scan(frames), Settings(), grid=grid).density

    def ours(frames: NDArray[Any]) -> Float32Array:
        with patch.object(pipeline, "field_radius_mm", lambda *_: np.inf):
            return as_used(frames)

    size: dict[str, Any] = {"count": COLUMNS, "voxel_mm": grid.voxel_mm}
    nufft = partial(finufft_fbp, psi_rad=half_turn, threads=CORES, **size)
    return [
        Method(OURS, "vialight", "frames", ours),
        Method(OURS_AS_USED, "vialight", "frames", as_used),
        Method("finufft, a slice a transform", "finufft", "sinogram", partial(nufft, packed=False)),
        Method("finufft, two slices a transform", "finufft", "sinogram", partial(nufft, packed=True)),
        Method(
            "scikit-image iradon, full turn", "skimage", "shifted", partial(skimage_fbp, psi_rad=psi, **size), False
        ),
        Method(
            "scikit-image iradon, folded", "skimage", "shifted_half",
            partial(skimage_fbp, psi_rad=half_turn, **size), False,
        ),
        Method("ASTRA FBP (CPU), folded", "astra", "judged", partial(astra_fbp, psi_rad=half_turn, **size), False),
    ]  # fmt: skip


def judged_slices(slices: int) -> list[int]:
    """Return the slices whose error is looked at."""
    return [slices // 8, slices // 2, slices - 1 - slices // 8]


def make_data(problem: Problem) -> dict[str, NDArray[Any]]:
    """Return what the methods are fed: frames, or ready sinograms."""
    psi, s, z = problem.beam.psi_rad, problem.beam.virtual_x_mm, problem.grid.z_mm
    half_turn, few = psi[: FRAMES // 2], z[judged_slices(problem.slices)]
    sinogram = problem.sinogram(half_turn, s, z)
    # iradon puts the axis on a sample and on a pixel, where here it is between two: half a step, seen from each angle.
    shifted_s = s - problem.grid.voxel_mm / 2 * (1 - np.cos(psi) + np.sin(psi))[:, None]
    shifted = problem.sinogram(psi, shifted_s, few)
    return {
        "frames": problem.frames(),
        "sinogram": sinogram,
        "judged": sinogram[judged_slices(problem.slices)],
        "shifted": shifted,
        "shifted_half": shifted[:, : FRAMES // 2],
    }


def compare(problem: Problem, rounds: int) -> dict[str, Result | None]:
    """Time all methods in turn, `rounds` times after a first run that does not count; None where not installed."""
    data, few = make_data(problem), judged_slices(problem.slices)
    results = {method.name: Result() if method.is_installed else None for method in methods(problem)}
    for i in range(rounds + 1):
        for method in methods(problem):
            result = results[method.name]
            if result is None:
                continue
            time.sleep(REST_S)
            np.ones(ROOM_GB * 2**28, np.float32)
            start, processor_start = time.perf_counter(), time.process_time()
            made = method.run(data[method.data])
            seconds, processor_seconds = time.perf_counter() - start, time.process_time() - processor_start
            if i:
                result.seconds.append(seconds * problem.slices / len(made))
                result.processor_seconds.append(processor_seconds * problem.slices / len(made))
            result.picture = made[few] if method.on_all_slices else made
            del made
    with tempfile.TemporaryDirectory() as folder:
        for name, array in data.items():
            np.save(Path(folder) / f"{name}.npy", array)
        for method in methods(problem):
            if (result := results[method.name]) is not None:
                result.peak_mb = json.loads(_in_new_process("--peak", method.name, "--data", folder, problem=problem))
    return results


def stage_seconds(problem: Problem, frames: NDArray[Any], rounds: int) -> dict[str, float]:
    """Return what vialight's stages took in the fastest of some runs."""
    scan, best = problem.scan(frames), {"all": np.inf}
    for _ in range(rounds + 1):
        spent: dict[str, float] = {}
        with ExitStack() as timers:
            for module, verb in (
                (pipeline.Scan, "line_integrals"),
                (pipeline, "resample"),
                (pipeline, "reconstruct_slices"),
                (volume, "backproject"),
            ):
                timers.enter_context(patch.object(module, verb, _timed(getattr(module, verb), verb, spent)))
            _timed(reconstruct, "all", spent)(scan, Settings(), grid=problem.grid)
        best = min(best, spent, key=lambda candidate: candidate["all"])
    return {
        "background and conversion to float": best["line_integrals"],
        "remap to parallel beam": best["resample"],
        "fold and filter": best["reconstruct_slices"] - best["backproject"],
        "backproject": best["backproject"],
        "all else": best["all"] - best["line_integrals"] - best["resample"] - best["reconstruct_slices"],
    }


def seconds_by_slices(counts: list[int], rounds: int) -> dict[int, float]:
    """Return vialight's shortest time for volumes of different height, measured in turn."""
    problems = [Problem(count) for count in counts]
    scans = [problem.scan(problem.frames()) for problem in problems]
    times: dict[int, list[float]] = {count: [] for count in counts}
    for _ in range(rounds + 1):
        for problem, scan in zip(problems, scans, strict=True):
            start = time.perf_counter()
            reconstruct(scan, Settings(), grid=problem.grid)
            times[problem.slices].append(time.perf_counter() - start)
    return {count: min(seconds[1:]) for count, seconds in times.items()}


def start_seconds(starts: int) -> dict[str, float]:
    """Return how long new processes take to answer and to have computed a first block, with compiled kernels cached."""
    found = {"first block of slices computed in a new process": ["--start"]}
    commands = {name: [sys.executable, __file__, *arguments] for name, arguments in found.items()}
    if importlib.util.find_spec("vialight.cli"):
        commands["`vialight --help`"] = [str(Path(sys.executable).with_name("vialight")), "--help"]
    seconds = {}
    for name, command in commands.items():
        times = []
        for _ in range(starts + 1):
            start = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            times.append(time.perf_counter() - start)
        seconds[name] = min(times[1:])
    return seconds


def comparison_table(problem: Problem, results: dict[str, Result | None]) -> list[str]:
    """Return the table of methods as lines of Markdown."""
    few = judged_slices(problem.slices)
    truth, judged = problem.density(problem.grid.z_mm[few])
    lines = [
        "| method | seconds | median | times vialight | processor, s | error, % | against vialight, % | peak, MB |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    reference = results[OURS]
    assert reference is not None
    assert reference.picture is not None
    for method in methods(problem):
        result = results[method.name]
        if result is None or result.picture is None:
            lines.append(f"| {method.name} | not installed | | | | | | |")
            continue
        scaled = "" if method.on_all_slices else "*"
        error, distance = (
            100 * _rms((result.picture - other)[judged]) / float(truth.max()) for other in (truth, reference.picture)
        )
        lines.append(
            f"| {method.name} | {result.best:.2f}{scaled} | {np.median(result.seconds):.2f}{scaled} "
            f"| {result.best / reference.best:.2f} | {min(result.processor_seconds):.2f}{scaled} "
            f"| {error:.1f} | {distance:.1f} | {result.peak_mb:.0f}{scaled} |"
        )
    return lines


def goals_table(results: dict[str, Result | None], starts: dict[str, float]) -> list[str]:
    """Return what is aimed for and what was found."""
    reference, as_used = results[OURS], results[OURS_AS_USED]
    assert reference is not None
    assert as_used is not None
    lines = ["| goal | found | met |", "| --- | ---: | --- |"]

    def add(goal: str, found: float, limit: float, form: str, *, at_least: bool = False) -> None:
        met = found >= limit if at_least else found <= limit
        lines.append(f"| {goal} | {form.format(found)} | {'yes' if met else 'no'} |")

    for ours, told in ((as_used, "in the field"), (reference, "corners of the square too")):
        for name, result in results.items():
            if result is not None and name.startswith(("finufft", "scikit-image")):
                limit = NUFFT_GOAL if name.startswith("finufft") else SKIMAGE_GOAL
                add(f"{told}: at least {limit:g} times as fast as {name}", result.best / ours.best, limit, "{:.2f}",
                    at_least=True)  # fmt: skip
    add(f"peak memory at most {MEMORY_GOAL_MB:.0f} MB", reference.peak_mb, MEMORY_GOAL_MB, "{:.0f} MB")
    for name, seconds in starts.items():
        limit = HELP_GOAL_S if "--help" in name else START_GOAL_S
        add(f"{name} within {limit:g} s", seconds, limit, "{:.2f} s")
    return lines


def machine() -> list[str]:
    """Say what the figures were measured on."""
    model = platform.processor() or platform.machine()
    if (cpuinfo := Path("/proc/cpuinfo")).exists():
        model = next(iter(re.findall(r"model name\s*: (.*)", cpuinfo.read_text())), model)
    packages = ["numpy", "numba", "scipy", "finufft", "scikit-image", "astra-toolbox"]
    modules = {"scikit-image": "skimage", "astra-toolbox": "astra"}
    present = [name for name in packages if importlib.util.find_spec(modules.get(name, name))]
    return [
        f"{model}, {len(os.sched_getaffinity(0))} of {os.cpu_count()} cores, load of the last minute "
        f"{os.getloadavg()[0]:.1f} before the run. {platform.system()}, Python {platform.python_version()}, "
        + ", ".join(f"{name} {version(name)}" for name in present)
        + "."
    ]


REMARKS = """\
How to read it:

- All methods fill the same {slices} x {columns} x {columns} voxels, with the same filter (cosine) in single precision,
  on {cores} cores: in the first row corners of the square included. The row "the field alone" is what users run: voxels
  beyond the field, which fills 90 % of the columns, are 0, as not every ray sees them, and most of them are not
  computed; the others would gain nothing by leaving them out. Goals are judged both ways. vialight begins with {frames}
  frames of {slices} x {columns} uint16 counts in memory; its time includes background removal, the remap for the vial,
  filter and backprojection. The others begin with the ready parallel-beam sinogram, exact, already folded to half a
  turn except where the name says otherwise.
- *: scaled. Three slices were made and the time multiplied; iradon and ASTRA's FBP work slice by slice on one core, so
  two processes would halve their times. Their memory is that of three slices.
- finufft runs twice: with one slice a transform, and with two slices packed into one complex transform, which is the
  fastest form that we know. Both use tolerance 1e-3, the smaller oversampling (1.25), which is the faster, a plan set
  up once, and batches of six transforms on {cores} threads; both include their own ramp filter by FFT.
- Seconds are the best of {rounds} rounds, all methods in turn within a round, after a rest of {rest:g} s, in which the
  threads of the one before fall asleep, and after {room} GB of memory have been written to, which a virtual machine may
  have to get back. The first round does not count, so that compiling (numba) and planning (FFTs) stay out. Other work
  on the machine shows as a median above the best. Processor seconds, of all threads together, depend on it less; they
  include threads that wait in a loop.
- Error is the root mean square against the true density of ellipsoids, in % of the highest, 6 voxels and more from any
  surface, in three slices, up to 0.97 of the field's radius. Streaks from 180 angles make up most of it in every row.
- Peak memory is VmHWM of a new process that loads its input and makes the volume once, interpreter and libraries
  included.
"""


def report(problem: Problem, rounds: int, short: bool) -> str:
    """Measure everything and return it as Markdown."""
    host = machine()
    results = compare(problem, rounds)
    starts = start_seconds(1 if short else STARTS)
    stages = stage_seconds(problem, problem.frames(), rounds)
    heights = seconds_by_slices([problem.slices // 2, problem.slices] + ([] if short else [2 * problem.slices]), rounds)
    command = "python benchmarks/reconstruction.py" + (" --short" if short else " --markdown docs/benchmarks.md")
    total = sum(stages.values())
    sections = [
        "# Benchmarks",
        f"Made by `{command}` (`make benchmark` installs the other packages first). {host[0]}",
        "\n".join(comparison_table(problem, results)),
        "Goals of the project, against each of these:",
        "\n".join(goals_table(results, starts)),
        "What vialight spends its time on, in its fastest run:",
        "\n".join(
            ["| stage | seconds | share, % |", "| --- | ---: | ---: |"]
            + [f"| {stage} | {seconds:.3f} | {100 * seconds / total:.0f} |" for stage, seconds in stages.items()]
        ),
        "Cost by slices; frames grow with them:",
        "\n".join(
            ["| slices | seconds | ms a slice |", "| ---: | ---: | ---: |"]
            + [f"| {count} | {seconds:.2f} | {1000 * seconds / count:.2f} |" for count, seconds in heights.items()]
        ),
        REMARKS.format(
            slices=problem.slices, columns=COLUMNS, cores=CORES, frames=FRAMES, rounds=rounds, rest=REST_S, room=ROOM_GB
        ).rstrip(),
    ]
    return "\n\n".join(sections) + "\n"


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="fewer slices and rounds, for a quick look")
    parser.add_argument("--markdown", type=Path, help="also write the tables to this file")
    parser.add_argument("--slices", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--peak", help=argparse.SUPPRESS)
    parser.add_argument("--data", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--start", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    _keep_to_cores()
    problem = Problem(options.slices or (SHORT_SLICES if options.short else SLICES))
    if options.peak:
        method = next(method for method in methods(problem) if method.name == options.peak)
        method.run(np.load(options.data / f"{method.data}.npy"))
        print(_peak_mb())
    elif options.start:
        small = Problem(8)
        reconstruct(small.scan(np.zeros((FRAMES, 8, COLUMNS), np.uint16)), Settings(), grid=small.grid)
    else:
        text = report(problem, SHORT_ROUNDS if options.short else ROUNDS, options.short)
        print(text)
        if options.markdown:
            options.markdown.write_text(text, encoding="utf-8")


def _keep_to_cores() -> None:
    """Start anew on as many cores as are compared; the libraries count them when they are loaded."""
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) > CORES:
        os.sched_setaffinity(0, cores[:CORES])
        os.execv(sys.executable, [sys.executable, *sys.argv])


def _in_new_process(*arguments: str, problem: Problem) -> str:
    command = [sys.executable, __file__, "--slices", str(problem.slices), *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def _peak_mb() -> float:
    # Not ru_maxrss, which a new process inherits from the one that started it.
    status = Path("/proc/self/status").read_text()
    return int(re.findall(r"VmHWM:\s*(\d+) kB", status)[0]) / 1000


def _timed(verb: Callable[..., Any], name: str, spent: dict[str, float]) -> Callable[..., Any]:
    def timed(*arguments: Any, **options: Any) -> Any:
        start = time.perf_counter()
        try:
            return verb(*arguments, **options)
        finally:
            spent[name] = spent.get(name, 0.0) + time.perf_counter() - start

    return timed


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    main()
