"""Compute light patterns by vialight and by other packages, judge all by one scorer, and print tables.

Usage: ``python benchmarks/plans.py [--short] [--markdown docs/benchmarks-planning.md] [--peers FOLDER]
[--peer-python PYTHON] [--only-peers | --stored-only]``.  The other packages may live in an environment of their own
(see `planning_peers`), whose interpreter is PYTHON; one that is not there gets rows that say so.  They take an hour, so
what they made is kept in FOLDER, and read from there the next time.  `--only-peers` fills FOLDER and judges nothing;
`--stored-only` runs none of them.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from judge import dose_in_ideal_printer
from numpy.typing import NDArray
from planning_peers import DRTVAM_STEPS, PACKAGES, VAM_ITERATIONS

from vialight.commands import PlanSettings
from vialight.core.arrays import Float32Array, Grid
from vialight.core.mesh import Mesh
from vialight.planning.projections import VOID_LIMIT, Goal, MethodName, State, full_turn, light_for, method_named
from vialight.planning.projections.methods import Method
from vialight.planning.scoring import Score, score_dose
from vialight.planning.shapes import bracket, gyroid, thin_wall_box
from vialight.planning.target import voxelise
from vialight.store.foreign.meshes import load_mesh

CORES = 2
ACROSS, ANGLES, VOID_VOXELS = 128, 360, 4
SHORT_ACROSS, SHORT_ANGLES = 32, 60
ROUNDS, SHORT_ROUNDS = 2, 1
PEER_LIMIT_S = 3600
BOAT = Path(os.environ.get("VIALIGHT_CASES", "../shared/cases")) / "boat" / "boat.stl"
BEST, DRTVAM = "vialight object-space, 30 passes, void limit 0.87", "Dr.TVAM threshold loss"
HELD = PlanSettings().held
"""As `vialight plan` has it."""
SPEED_GOAL, LARGE_GOAL_S = 20.0, 10.0
LARGE_VOXELS = "200 x 256 x 256"
SAME_METHOD = {
    "VAMToolbox FBP": "vialight FBP",
    "VAMToolbox OSMO": f"vialight osmo, {VAM_ITERATIONS} passes",
    "VAMToolbox PM": f"vialight gradient, {VAM_ITERATIONS} steps",
}
QUOTED = {  # of the boat, each in its own terms: Jaccard, in-part range where known, seconds
    "VAMToolbox FBP": (0.936, None, 3.4),
    "VAMToolbox OSMO": (0.963, None, 71.0),
    "VAMToolbox CAL": (0.964, None, 41.0),
    "VAMToolbox PM": (0.970, None, 77.0),
    DRTVAM: (1.000, 0.055, 127.0),
}


@dataclass(frozen=True)
class Part:
    """What all methods are given."""

    name: str
    mesh: Mesh
    grid: Grid
    inside: Float32Array
    angles: int

    @property
    def digest(self) -> str:
        """Tells parts, voxels and angles apart."""
        return hashlib.sha256(self.inside.tobytes() + f"{self.grid.voxel_mm:.9g} {self.angles}".encode()).hexdigest()[
            :12
        ]


@dataclass
class Result:
    """What was measured of a method on a part."""

    score: Score
    seconds: list[float] = field(default_factory=list)
    processor_seconds: list[float] = field(default_factory=list)
    circumstances: str = ""


@dataclass(frozen=True)
class Peers:
    """Where other packages are, and where what they make is kept."""

    python: str
    folder: Path
    stored_only: bool = False

    @cached_property
    def _here(self) -> dict[str, Any]:
        told = subprocess.run([self.python, _PEERS_PROGRAM], check=True, capture_output=True, text=True).stdout
        return dict(json.loads(told))

    @property
    def bunny(self) -> Path | None:
        """The mesh that pymeshlab brings."""
        return Path(self._here["bunny"]) if self._here["bunny"] else None

    def can_run(self, name: str) -> bool:
        """Whether a method's package is there."""
        return name in self._here["methods"]

    def made(self, part: Part, name: str) -> Path | None:
        """Return what a method made of a part, now or an earlier time; None where it does not run."""
        made = self.folder / f"{part.name}.{part.digest}.{name}.npz"
        if made.exists():
            return made
        if self.stored_only or not self.can_run(name):
            return None
        case = self.folder / f"{part.name}.{part.digest}.case.npz"
        np.savez(
            case, inside=part.inside, voxel_mm=part.grid.voxel_mm, vertices_mm=part.mesh.vertices_mm,
            faces=part.mesh.faces, angles=part.angles,
        )  # fmt: skip
        try:
            subprocess.run([self.python, _PEERS_PROGRAM, name, case, made], check=True, timeout=PEER_LIMIT_S,
                           stderr=subprocess.PIPE)  # fmt: skip
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
            print(f"{name} on {part.name}: {error} {(error.stderr or b'')[-2000:].decode()}", file=sys.stderr)
            return None
        return made


_PEERS_PROGRAM = Path(__file__).with_name("planning_peers.py")


def parts(short: bool, bunny: Path | None) -> Iterator[Part]:
    """Yield the parts that there are, centred, as large as the grid allows."""
    across, angles = (SHORT_ACROSS, SHORT_ANGLES) if short else (ACROSS, ANGLES)
    if short:
        yield _part("gyroid", gyroid(wall_mm=1.5, pitch_mm=0.25), across, angles)
        yield _part("thin wall box", thin_wall_box(wall_mm=1.2), across, angles)
        return
    if BOAT.exists():
        yield _part("boat", load_mesh(BOAT), across, angles, slices=72)
    yield _part("gyroid", gyroid(), across, angles)
    yield _part("bracket", bracket(), across, angles)
    yield _part("thin wall box", thin_wall_box(), across, angles)
    if bunny:
        yield _part("bunny", load_mesh(bunny), across, angles, size_mm=12.0)


def _part(
    name: str, mesh: Mesh, across: int, angles: int, slices: int | None = None, size_mm: float | None = None
) -> Part:
    points = mesh.vertices_mm - mesh.bounds_mm.mean(axis=0)
    if size_mm is not None:
        points = points * (size_mm / float(mesh.extents_mm.max()))
    centred = Mesh(points, mesh.faces)
    voxel = float(np.hypot(points[:, 0], points[:, 1]).max()) / (across / 2 - VOID_VOXELS)
    slices = slices or int(np.ceil(np.ptp(points[:, 2]) / voxel)) + 2 * VOID_VOXELS
    grid = Grid((slices, across, across), voxel)
    return Part(name, centred, grid, voxelise(centred, grid), angles)


class Way(NamedTuple):
    """Of making patterns, by vialight."""

    method: Method
    passes: int
    """Ten steps each of gradient."""
    void_limit: float = VOID_LIMIT
    held: int = 1
    """Flashes, unless said otherwise: what other packages take patterns for."""


def own_ways() -> dict[str, Way]:
    """Return vialight's rows of the tables."""
    return {
        # What the first pass shows is the part, filtered and clipped at 0.
        "vialight FBP": Way(method_named("object-space", ceiling=1), 1),
        "vialight normalised, the paper's": Way(method_named("normalised"), 2),
        f"vialight osmo, {VAM_ITERATIONS} passes": Way(method_named("osmo"), VAM_ITERATIONS),
        f"vialight gradient, {VAM_ITERATIONS} steps": Way(method_named("gradient", steps=10), VAM_ITERATIONS // 10),
        "vialight object-space, 10 passes": Way(method_named("object-space"), 10, held=HELD),
        "vialight object-space, 20 passes, flashes": Way(method_named("object-space"), 20),
        "vialight object-space, 20 passes, its defaults": Way(method_named("object-space"), 20, held=HELD),
        BEST: Way(method_named("object-space"), 30, 0.87, HELD),
    }


def optimise(part: Part, way: Way) -> Float32Array:
    """Return projections (psi, s, z) of half a turn after some passes: the last, which is what an iteration costs."""
    light = light_for(part.grid, part.angles, held=way.held)
    goal = Goal(np.ascontiguousarray(part.inside.transpose(1, 2, 0)), light.reach, way.void_limit)
    state: State | None = None
    for state in way.method(goal, light, None):
        if state.passes == way.passes:
            break
    assert state is not None
    return state.projections


def judge(patterns: NDArray[np.floating], part: Part) -> Score:
    """Round patterns (angle, row, column) of a full turn to 8 bits, and judge the dose that they make."""
    levels = np.rint(np.maximum(patterns, 0) * (255 / patterns.max())).astype(np.uint8)
    dose = dose_in_ideal_printer(np.ascontiguousarray(levels), part.grid.shape[2])
    reached = np.hypot(part.grid.x_mm, part.grid.y_mm[:, None]) <= part.grid.shape[2] / 2 * part.grid.voxel_mm
    score = score_dose(dose, part.inside, np.asarray(reached)[None])
    return replace(score, light_efficiency=float(levels.mean(dtype=np.float64) / 255))


def patterns_of(projections: Float32Array) -> Float32Array:
    """Return patterns (angle, row, column), rows from the top, of projections of half a turn."""
    return full_turn(projections).transpose(0, 2, 1)[:, ::-1]


def own_results(part: Part, rounds: int) -> dict[str, Result]:
    """Time all of vialight's methods in turn, some rounds, after a start that does not count."""
    ways = own_ways()
    for way in ways.values():
        optimise(part, way._replace(passes=1))
    results: dict[str, Result] = {}
    for _ in range(rounds):
        for name, way in ways.items():
            start, processor_start = time.perf_counter(), time.process_time()
            projections = optimise(part, way)
            seconds, processor_seconds = time.perf_counter() - start, time.process_time() - processor_start
            if name not in results:
                results[name] = Result(judge(patterns_of(projections), part))
            results[name].seconds.append(seconds)
            results[name].processor_seconds.append(processor_seconds)
    return results


def peer_result(part: Part, name: str, peers: Peers) -> Result | None:
    """Judge what a method of another package makes; None where it does not run."""
    made = peers.made(part, name)
    if made is None:
        return None
    with np.load(made) as held:
        spent = ([float(held["seconds"])], [float(held["processor_seconds"])])
        return Result(judge(held["patterns"], part), *spent, str(held["circumstances"]))


def part_table(part: Part, results: dict[str, Result | None]) -> list[str]:
    """Return what was measured on a part as lines of Markdown."""
    lines = [
        "| method | seconds | processor, s | Jaccard | in-part range | voxel error rate | process window | light |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, result in results.items():
        if result is None:
            lines.append(f"| {name} | not run | | | | | | |")
            if part.name == "boat" and name in QUOTED:
                jaccard, dose_range, seconds = QUOTED[name]
                told = "" if dose_range is None else f"{dose_range:.3f}"
                lines.append(f"| {name}, quoted, in its own terms | {seconds:g} | | {jaccard:.3f} | {told} | | | |")
            continue
        score = result.score
        lines.append(
            f"| {name} | {min(result.seconds):.2f} | {min(result.processor_seconds):.2f} | {score.jaccard:.4f} "
            f"| {score.in_part_dose_range:.3f} | {score.voxel_error_rate:.1e} | {score.process_window:+.3f} "
            f"| {score.light_efficiency:.1%} |"
        )
    return lines


def is_at_least_as_good(ours: Score, theirs: Score) -> bool:
    """Whether a method is as good as another or better in all four figures."""
    return (
        ours.jaccard >= theirs.jaccard
        and ours.in_part_dose_range <= theirs.in_part_dose_range
        and ours.voxel_error_rate <= theirs.voxel_error_rate
        and ours.process_window >= theirs.process_window
    )


def goals_table(found: dict[str, dict[str, Result | None]], large_s: float | None) -> list[str]:
    """Return what is aimed for and what was found."""
    lines = ["| goal | part | found | met |", "| --- | --- | ---: | --- |"]
    for part, results in found.items():
        ours = results[BEST]
        assert ours is not None
        for name in PACKAGES:
            theirs = results[name]
            if theirs is None:
                continue
            good = is_at_least_as_good(ours.score, theirs.score)
            lines.append(f"| {BEST}: as good as {name} in all four | {part} | | {'yes' if good else 'no'} |")
            if name == DRTVAM:
                reached = _quickest_as_good(results, theirs.score)
                if reached is not None:
                    lines.append(_speed_line(f"{reached}: {SPEED_GOAL:g} times as fast as {name} at its quality", part,
                                             theirs, results[reached]))  # fmt: skip
            elif name in SAME_METHOD:
                lines.append(_speed_line(f"{SAME_METHOD[name]}: {SPEED_GOAL:g} times as fast as {name}", part, theirs,
                                         results[SAME_METHOD[name]]))  # fmt: skip
    if large_s is not None:
        met = "yes" if large_s <= LARGE_GOAL_S else "no"
        lines.append(
            f"| the paper's method, {LARGE_VOXELS}, 360 angles, within {LARGE_GOAL_S:g} s | | {large_s:.1f} s | {met} |"
        )
    return lines


def _quickest_as_good(results: dict[str, Result | None], theirs: Score) -> str | None:
    ours = {name: result for name, result in results.items() if result and name.startswith("vialight")}
    good = {name: min(result.seconds) for name, result in ours.items() if is_at_least_as_good(result.score, theirs)}
    return min(good, key=lambda name: good[name], default=None)


def _speed_line(goal: str, part: str, theirs: Result, ours: Result | None) -> str:
    assert ours is not None
    wall = min(theirs.seconds) / min(ours.seconds)
    processor = min(theirs.processor_seconds) / min(ours.processor_seconds)
    # Other work may have slowed one more than the other: both have to say so.
    met = "yes" if min(wall, processor) >= SPEED_GOAL else "no"
    return f"| {goal} | {part} | {wall:.0f}, processor {processor:.0f} | {met} |"


def seconds_for_large(rounds: int) -> float:
    """Return the shortest time that the paper's method takes for a 12 mm part in voxels of 0.065 mm."""
    grid = Grid((200, 256, 256), 0.065)
    z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij", sparse=True)
    inside = (np.maximum(np.hypot(x, y) - 6, np.abs(z) - 6) < 0) & (np.hypot(x - 2, y + 1) > 1.5)
    part = Part("large", Mesh(np.eye(3), np.array([[0, 1, 2]])), grid, inside.astype(np.float32), 360)
    way = Way(method_named("normalised"), 2, held=HELD)
    return min(_timed(partial(optimise, part, way)) for _ in range(rounds))


def quality_by_passes(part: Part) -> list[str]:
    """Return quality against time, pass by pass, of the methods that go on."""
    lines = ["| method | after | seconds | in-part range | process window |", "| --- | ---: | ---: | ---: | ---: |"]
    methods: dict[MethodName, tuple[str, tuple[int, ...]]] = {
        "object-space": ("passes", (1, 2, 5, 10, 20, 40)),
        "osmo": ("passes", (1, 2, 5, 10, 20, 40)),
        "gradient": ("times ten steps", (1, 2, 4)),
    }
    for name, (told, shown) in methods.items():
        light = light_for(part.grid, part.angles, held=HELD)
        goal = Goal(np.ascontiguousarray(part.inside.transpose(1, 2, 0)), light.reach)
        start = time.perf_counter()
        judging = 0.0
        for state in method_named(name)(goal, light, None):
            if state.passes in shown:
                seconds, stop = time.perf_counter() - start - judging, time.perf_counter()
                score = judge(patterns_of(state.projections), part)
                judging += time.perf_counter() - stop
                lines.append(
                    f"| {name} | {state.passes} {told} | {seconds:.2f} | {score.in_part_dose_range:.3f} "
                    f"| {score.process_window:+.3f} |"
                )
            if state.passes == shown[-1]:
                break
    return lines


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def machine() -> str:
    """Say what the figures were measured on."""
    model = platform.processor() or platform.machine()
    if (cpuinfo := Path("/proc/cpuinfo")).exists():
        model = next(iter(re.findall(r"model name\s*: (.*)", cpuinfo.read_text())), model)
    return (
        f"{model}, {len(os.sched_getaffinity(0))} of {os.cpu_count()} cores, load of the last minute "
        f"{os.getloadavg()[0]:.1f} before the run. {platform.system()}, Python {platform.python_version()}, "
        + ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "scipy"))
        + "."
    )


REMARKS = f"""\
How to read it:

- All methods are given the same voxels and angles. The judge (`benchmarks/judge.py`) shares nothing with any of them:
  it rounds patterns to 8 bits, shows them as square pixels for as long as they are held, by parallel light in a resin
  that absorbs nothing, and averages 3 x 3 points in each voxel. Dose range, window and error rate are as in the
  reference: over the largest in-part dose. "Light" is the mean level of all pixels of the patterns, over 255: a print
  takes that much less time, and has that many more grey levels, the higher it is.
- Seconds are the best of {ROUNDS} rounds for vialight, after a start that does not count, and of one run for others,
  made before and under the circumstances told below their table: a priority of 19 gives way to all other work, which
  seconds then include. Processor seconds, of all threads together, are the measure to compare; a speed is met where
  both say so. VAMToolbox computes on one core. Dr.TVAM's include that it makes voxels of the mesh and saves pictures.
- VAMToolbox and vialight compute half a turn (opposite patterns are mirror images); Dr.TVAM optimises a full one.
  VAMToolbox: its projector for processors (ASTRA), default thresholds, {VAM_ITERATIONS} iterations of each method.
  Dr.TVAM: its defaults, {DRTVAM_STEPS} steps of L-BFGS, 4 rays a pixel.
- vialight's FBP is the first pass of object-space: the part, filtered and clipped at 0. Its gradient method stands
  against PM: both are quasi-Newton methods on threshold losses.
- By default vialight lets a void get 0.85 of the part's dose, for the widest process window; at 0.87 the part's dose is
  more even, and the window still wider than any other package's.
- By default vialight knows that patterns are held while the vial turns (`--held 2`): in the rows of object-space but
  the one that says flashes, in the time of the large part and in quality against time. The other methods take patterns
  for flashes here, as other packages do.
"""


def report(short: bool, peers: Peers) -> str:
    """Measure everything and return it as Markdown."""
    host, rounds = machine(), SHORT_ROUNDS if short else ROUNDS
    found: dict[str, dict[str, Result | None]] = {}
    sections: list[str] = []
    first: Part | None = None
    for part in parts(short, peers.bunny):
        first = first or part
        others = {name: peer_result(part, name, peers) for name in PACKAGES}
        found[part.name] = {**own_results(part, rounds), **others}
        shape = " x ".join(str(count) for count in part.grid.shape)
        sections += [
            f"## {part.name}",
            f"{shape} voxels of {part.grid.voxel_mm:.3f} mm, {int((part.inside >= 0.5).sum())} of them in the part, "
            f"{part.angles} angles.",
            "\n".join(part_table(part, found[part.name])),
            "\n".join(told_of_peers(others)),
        ]
        print("\n\n".join(sections[-4:]), file=sys.stderr, flush=True)
    assert first is not None
    large_s = None if short else seconds_for_large(rounds)
    # Where things lie on this machine is of no use elsewhere.
    command = shlex.join(["python", "benchmarks/plans.py", *(_shown(word) for word in sys.argv[1:])])
    sections = [
        "# Benchmarks of planning",
        f"Made by `{command}` on {time.strftime('%Y-%m-%d', time.gmtime())}. {host}",
        *sections,
        "## Goals",
        "\n".join(goals_table(found, large_s)),
        f"## Quality against time: {first.name}",
        "\n".join(quality_by_passes(first)),
        REMARKS.rstrip(),
    ]
    return "\n\n".join(sections) + "\n"


def _shown(word: str) -> str:
    path = Path(word)
    return path.name if path.is_absolute() else word


def told_of_peers(others: dict[str, Result | None]) -> list[str]:
    """Return under what circumstances other packages ran, methods of like circumstances together."""
    alike: dict[str, list[str]] = {}
    for name, result in others.items():
        alike.setdefault("not run" if result is None else result.circumstances, []).append(name)
    return [f"{', '.join(names)}: {told}.  " for told, names in alike.items()]


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="two small parts and one round, for a quick look")
    parser.add_argument("--markdown", type=Path, help="also write the tables to this file")
    parser.add_argument("--peers", type=Path, help="where to keep what other packages made")
    parser.add_argument("--peer-python", default=sys.executable, help="interpreter that has the other packages")
    parser.add_argument("--only-peers", action="store_true", help="let the other packages run, and judge nothing")
    parser.add_argument("--stored-only", action="store_true", help="judge what the other packages have made before")
    options = parser.parse_args()
    _keep_to_cores()
    with tempfile.TemporaryDirectory() as scratch:
        peers = Peers(options.peer_python, options.peers or Path(scratch), options.stored_only)
        peers.folder.mkdir(parents=True, exist_ok=True)
        if options.only_peers:
            for part, name in itertools.product(list(parts(options.short, peers.bunny)), PACKAGES):
                peers.made(part, name)
            return
        text = report(options.short, peers)
    print(text)
    if options.markdown:
        options.markdown.write_text(text, encoding="utf-8")


def _keep_to_cores() -> None:
    """Start anew on as many cores as are compared; the libraries count them when they are loaded."""
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) > CORES:
        os.sched_setaffinity(0, cores[:CORES])
        os.execv(sys.executable, [sys.executable, *sys.argv])


if __name__ == "__main__":
    main()
