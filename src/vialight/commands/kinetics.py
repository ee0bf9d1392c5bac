"""What happened at a place of a print over time, and where and when the print began to fail."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from vialight.control.lateness import lateness
from vialight.control.looking_back import Place, SeenAgain, see_again, times_of
from vialight.control.prediction import predict
from vialight.control.stop_model import REHEARSAL, StopModel
from vialight.core.arrays import BoolArray, FloatArray, Grid
from vialight.core.config import Rig
from vialight.core.mesh import Mesh
from vialight.metrology import signed_distance
from vialight.metrology.kinetics import Failure, dose_over_time, mj_per_cm2, outside_failures, stalled_failures
from vialight.metrology.kinetics.shown_light import ShownLight, light_of
from vialight.report import GelPlanes, gel_times_png, kinetics_png
from vialight.store import open_frames, read_json, read_plan, staged_folder, write_json
from vialight.store.foreign.meshes import load_mesh
from vialight.store.provenance import inputs_json, versions
from vialight.store.rig_files import load_rig
from vialight.system import file_in

_LEAST_MM3, _LEAST_VOXELS = 0.1, 27
"""What is smaller is noise."""
_MOST_POINTS = 200


def kinetics_of(
    run: str | Path,
    place: Place,
    *,
    out: str | Path | None = None,
    plan: str | Path | None = None,
    reference: str | Path | None = None,
    tolerance_mm: float | None = None,
    threshold: float | None = None,
    voxel_mm: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Read a recording again, as the live measurement did, and tell density and dose over time and what failed.

    Parameters
    ----------
    run
        A run's folder with ``frames.h5`` and ``rig.toml``: of a print, finished or dead, a watched or a simulated one.
    place
        Where to look.
    out
        Folder for ``kinetics.csv``, ``kinetics.json``, ``kinetics.png``, ``gel_time.png``; by default ``kinetics`` in
        the run.
    plan, reference
        By default the run's; without a plan there is no dose, without a reference failures are not looked for.
    tolerance_mm
        How far beyond the reference matter may gel; by default two voxels.
    threshold
        I_p, counts per mm; by default the rig's.
    voxel_mm
        By default a pixel: half as fine as a reconstruction, and eight times as fast.
    progress
        Called with frames done and to do.

    Returns
    -------
    dict
        What ``kinetics.json`` holds.

    Raises
    ------
    InputError
        The run cannot be read, or the place lies outside what the camera sees.
    """
    run = Path(run)
    out = file_in(run, "kinetics") if out is None else out
    rig = load_rig(file_in(run, "rig.toml"))
    threshold = rig.need_threshold() if threshold is None else threshold
    plan_path = _given_or_there(plan, run, "plan.h5")
    part_path = _given_or_there(reference, run, "reference.stl")
    part = None if part_path is None else load_mesh(part_path)
    rehearsal = file_in(run, REHEARSAL)
    model = StopModel.from_json(read_json(rehearsal)) if rehearsal.exists() else None
    with open_frames(file_in(run, "frames.h5")) as frames:
        light = light_of(run, rig, frames, None if plan_path is None else read_plan(plan_path).patterns)
        seen = see_again(
            frames, rig, place, light.lit_at(times_of(frames, rig)), threshold, voxel_mm=voxel_mm, part=part,
            model=model, progress=progress,
        )  # fmt: skip
    dose, unit = _dose(light, rig, seen)
    tolerance_mm = 2 * seen.grid.voxel_mm if tolerance_mm is None else tolerance_mm
    failures = [] if part is None else _failures(seen, part, threshold, tolerance_mm, model, light)
    turn_s = 360 / rig.stage.speed_deg_s
    table = {
        "time_s": seen.time_s, "lit_s": seen.lit_s, "turn": seen.lit_s / turn_s,
        "density_counts_per_mm": seen.density, **({} if dose is None else {"dose": dose}),
    }  # fmt: skip
    result = {
        "inputs": inputs_json(frames=run / "frames.h5", **({} if plan_path is None else {"plan": plan_path})),
        "settings": {
            "at_mm": list(place.at_mm), "radius_mm": place.radius_mm, "threshold_counts_per_mm": threshold,
            "voxel_mm": seen.grid.voxel_mm, "tolerance_mm": None if part is None else tolerance_mm,
        },
        "light": light.source,
        "dose_unit": unit,
        "gelled_at_lit_s": _first_above(seen.density, threshold, seen.lit_s),
        "failures": None if part is None else [_failure_json(one, light, turn_s) for one in failures],
        "table": {name: column.tolist() for name, column in table.items()},
        "versions": versions(),
    }  # fmt: skip
    with staged_folder(out) as folder:
        write_json(folder / "kinetics.json", result)
        _write_csv(folder / "kinetics.csv", table, unit)
        marks = [(one.what, float(light.turns_at(np.array([one.time_s]), turn_s)[0])) for one in failures]
        off = None if light.off_at_lit_s is None else light.off_at_lit_s / turn_s
        turns = light.turns_at(seen.time_s, turn_s)
        (folder / "kinetics.png").write_bytes(kinetics_png(turns, seen.density, threshold, dose, unit, marks, off))
        gel_turns = light.turns_at(np.nan_to_num(seen.gel_time_s), turn_s) + 0 * seen.gel_time_s  # NaN stays NaN
        planes = GelPlanes(gel_turns.astype(np.float32), seen.grid, place.at_mm, part, [one.at_mm for one in failures])
        (folder / "gel_time.png").write_bytes(gel_times_png(planes))
    return result


def _failures(
    seen: SeenAgain, part: Mesh, threshold: float, tolerance_mm: float, model: StopModel | None, light: ShownLight
) -> list[Failure]:
    """Compare what was seen with what was meant, and rehearsed."""
    least = max(_LEAST_MM3, _LEAST_VOXELS * seen.grid.voxel_mm**3)
    outside = _beyond(part, seen.grid, np.isfinite(seen.gel_time_s), tolerance_mm)
    found = outside_failures(seen.gel_time_s, seen.grid, outside, least)
    if seen.inside is not None:
        found += stalled_failures(seen.inside, threshold, least)
    if model is not None and seen.history is not None and np.isfinite(seen.history.crossing_s).any():
        late = lateness(model, seen.history, predict(model, seen.history).sensitivity)
        if late is not None:
            at = (float(late.at_mm[0]), float(late.at_mm[1]), float(late.at_mm[2]))
            found.append(Failure("gelled later than rehearsed", light.time_at(late.due_lit_s), at, float(late.blocks)))
    return sorted(found, key=lambda one: one.time_s)


def _given_or_there(given: str | Path | None, run: Path, name: str) -> Path | None:
    if given is not None:
        return Path(given)
    there = file_in(run, name)
    return there if there.exists() else None


def _dose(light: ShownLight, rig: Rig, seen: SeenAgain) -> tuple[FloatArray | None, str | None]:
    """Return (look,) the dose up to each look, and its unit."""
    if light.shown is None or light.patterns is None:
        return None, None
    points = seen.points_mm
    if len(points) > _MOST_POINTS:
        points = points[np.random.default_rng(0).choice(len(points), _MOST_POINTS, replace=False)]
    dose = dose_over_time(points, light.patterns, rig, light.shown)
    factor = mj_per_cm2(light.patterns, rig)
    unit = "dose meant in the part after a turn" if factor is None else "mJ/cm^2"
    return np.interp(seen.time_s, light.shown.time_s, dose) * (factor or 1.0), unit


def _beyond(part: Mesh, grid: Grid, gelled: BoolArray, tolerance_mm: float) -> BoolArray:
    """Return (z, y, x) the gelled voxels that lie farther from a part than allowed."""
    z, y, x = np.nonzero(gelled)
    points = np.stack([grid.x_mm[x], grid.y_mm[y], grid.z_mm[z]], axis=1)
    beyond = np.zeros(gelled.shape, np.bool_)
    if len(points):
        beyond[z, y, x] = signed_distance(points, part) > tolerance_mm
    return beyond


def _first_above(density: FloatArray, threshold: float, lit_s: FloatArray) -> float | None:
    """Return the lit time at which the density rose above the threshold for good."""
    above = density >= threshold
    if not len(above) or not above[-1]:
        return None
    first = len(above) - int(np.argmin(above[::-1])) if not above.all() else 0
    return float(lit_s[first])


def _failure_json(one: Failure, light: ShownLight, turn_s: float) -> dict[str, Any]:
    lit_s = float(light.lit_at(np.array([one.time_s]))[0])
    return {
        "what": one.what, "time_s": one.time_s, "lit_s": lit_s, "turn": lit_s / turn_s, "at_mm": list(one.at_mm),
        "size_mm3": one.size_mm3,
    }  # fmt: skip


def _write_csv(path: Path, table: dict[str, FloatArray], unit: str | None) -> None:
    names = dict.fromkeys(table)
    units = {"mJ/cm^2": "dose_mj_per_cm2"}
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file)
        writer.writerow([units.get(unit or "", "dose_of_a_turn") if name == "dose" else name for name in names])
        writer.writerows([f"{value:.6g}" for value in row] for row in zip(*table.values(), strict=True))
