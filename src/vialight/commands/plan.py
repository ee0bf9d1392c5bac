"""Compute the patterns that print a part; judge patterns under other conditions."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vialight.commands.plan_settings import GivenProjections, PlanSettings
from vialight.core.arrays import Float32Array, Grid
from vialight.core.config import Rig
from vialight.core.plan import Patterns, Plan
from vialight.optics.viewing import ray_tilt
from vialight.planning.projections import (
    DEFAULT_PASSES,
    Goal,
    Light,
    Progress,
    State,
    lay_in_vial,
    light_for,
    make_patterns,
    method_named,
    optimise,
    strip_positions,
)
from vialight.planning.scoring import Score, dose_of_patterns, judged_voxels, score_dose
from vialight.planning.target import Placement, Room, check_sound, place, printable_room, target_grid, voxelise
from vialight.store import (
    SavedState,
    read_plan,
    read_projections,
    read_state,
    staged_folder,
    write_json,
    write_plan,
    write_state,
)
from vialight.store.foreign.meshes import load_mesh
from vialight.store.provenance import inputs_json, versions
from vialight.store.rig_files import load_rig


@dataclass(frozen=True)
class _Job:
    """A part in its vial, cut into voxels."""

    rig: Rig
    room: Room
    placement: Placement
    grid: Grid
    target: Float32Array


def plan_part(
    part_path: str | Path,
    rig_path: str | Path,
    out: str | Path,
    *,
    settings: PlanSettings | None = None,
    given: GivenProjections | None = None,
    resume: str | Path | None = None,
    save_state: str | Path | None = None,
    page: bool = True,
    progress: Progress | None = None,
    keep_going: Callable[[], bool] = lambda: True,
) -> dict[str, Any]:
    """Compute the patterns for a part and write them, with their metrics and a page that shows them.

    Parameters
    ----------
    part_path
        The mesh, mm.
    rig_path
        A rig with projector, vial and the resin's writing index.
    out
        The plan, HDF5; ``.html`` beside it shows it, ``.json`` holds its metrics.
    settings
        How.
    given
        Projections to take instead.
    resume, save_state
        Go on from a saved state; save where the method stood at the end.
    page
        Whether to draw the page, which takes longer than a coarse plan.
    progress
        Called with passes done and to do.
    keep_going
        Asked after each pass: False ends the run with the best so far.

    Returns
    -------
    dict
        What the ``.json`` holds.

    Raises
    ------
    InputError
        Part, rig or settings cannot be used, or the part does not fit.
    """
    settings = settings or PlanSettings()
    job = _prepare(part_path, load_rig(rig_path), settings)
    asked = asdict(settings)
    known: dict[str, Any] = {}
    if given is not None:
        patterns = _laid(job, given, settings)
        asked |= {"method": "given", "given": {name: str(value) for name, value in asdict(given).items() if value}}
    else:
        patterns, known = _optimised(job, settings, resume, save_state, progress, keep_going)
    metrics, dose = judge(patterns, job.rig, job.grid, job.target)
    asked |= {"placement": job.placement.matrix.tolist(), "placed_scale": job.placement.scale}
    inputs = inputs_json(part=part_path, rig=rig_path, **({} if given is None else {"projections": given.path}))
    plan = Plan(
        patterns, job.placement.mesh, job.target, job.grid, job.rig, asked, metrics | known, inputs
    )  # fmt: skip
    return _write(out, plan, dose if page else None)


def _prepare(part_path: str | Path, rig: Rig, settings: PlanSettings) -> _Job:
    room = printable_room(rig)
    placement = place(
        load_mesh(part_path), room, rotate_deg=settings.rotate_deg, scale=settings.scale, fit=settings.fit,
        centre=settings.centre, where=part_path,
    )  # fmt: skip
    check_sound(placement.mesh, part_path)
    voxel_mm = rig.need_projector().pixel_mm if settings.voxel_mm is None else settings.voxel_mm
    grid = target_grid(placement.mesh, voxel_mm)
    return _Job(rig, room, placement, grid, voxelise(placement.mesh, grid, coverage=settings.coverage))


def _laid(job: _Job, given: GivenProjections, settings: PlanSettings) -> Patterns:
    values, angles_rad = read_projections(given.path, axes=given.axes, angles=given.angles, span_deg=given.span_deg)
    pixel_mm = job.grid.voxel_mm if given.pixel_mm is None else given.pixel_mm
    projections, light, rows = lay_in_vial(values, angles_rad, pixel_mm, job.grid.centre_z_mm)
    return make_patterns(projections, light, rows, job.rig, count=settings.angles)


def _optimised(
    job: _Job,
    settings: PlanSettings,
    resume: str | Path | None,
    save_state: str | Path | None,
    progress: Progress | None,
    keep_going: Callable[[], bool],
) -> tuple[Patterns, dict[str, Any]]:
    """Return patterns, and what is known of their making."""
    started = time.monotonic()
    light = _light(job.grid, job.rig, job.room, settings)
    goal = Goal(np.ascontiguousarray(job.target.transpose(1, 2, 0)), light.reach, settings.void_limit)
    method = method_named(settings.method, **settings.method_parameters())
    passes = settings.passes or DEFAULT_PASSES[settings.method]
    state = None
    if resume is not None:
        shape = (len(light.geometry.psi_rad), light.geometry.samples, job.grid.shape[0])
        state = State(*read_state(resume, settings.method, shape, goal.inside.shape)[1:])
    best, last = optimise(goal, light, method, passes, state=state, progress=progress, keep_going=keep_going)
    if save_state is not None:
        write_state(save_state, SavedState(settings.method, last.passes, last.model, last.projections, last.dose))
    known = {
        "passes": best.passes,
        "believed": score_dose(best.dose, goal.inside, goal.reach > 0).to_json(),
        "optimisation_s": round(time.monotonic() - started, 3),
    }
    return make_patterns(best.projections, light, job.grid, job.rig), known


def score_plan(plan_path: str | Path, rig_path: str | Path) -> dict[str, Any]:
    """Judge a plan's patterns as another rig would show them.

    Raises
    ------
    InputError
        Plan or rig cannot be used.
    """
    plan = read_plan(plan_path)
    rig = load_rig(rig_path)
    metrics, _ = judge(plan.patterns, rig, plan.grid, plan.target)
    return {
        "inputs": inputs_json(plan=plan_path, rig=rig_path),
        "metrics": metrics,
        "metrics_as_planned": dict(plan.metrics),
        "versions": versions(),
    }


def judge(patterns: Patterns, rig: Rig, grid: Grid, target: Float32Array) -> tuple[dict[str, Any], Float32Array]:
    """Return what patterns are expected to do, with units in the names, and their dose (z, y, x)."""
    dose = dose_of_patterns(patterns, rig, grid)
    score = score_dose(dose, target, judged_voxels(grid), patterns)
    return score.to_json() | exposure_json(score, patterns, rig), dose


def exposure_json(score: Score, patterns: Patterns, rig: Rig) -> dict[str, float | None]:
    """Return the light per turn and the turns it takes, where the rig says how bright and how sensitive things are."""
    irradiance, critical = rig.need_projector().irradiance_mw_per_cm2, rig.resin.critical_exposure_mj_per_cm2
    if irradiance is None:
        return {"exposure_per_turn_mj_per_cm2": None, "turns_to_critical_exposure": None}
    # A dose of 1 is 1 rad of light at 1 / (255 dose_rate_per_level) of full level.
    seconds_per_rad = 1 / np.radians(rig.stage.speed_deg_s)
    per_dose = irradiance * seconds_per_rad / (255 * patterns.dose_rate_per_level)
    exposure = per_dose * score.best_threshold
    return {
        "exposure_per_turn_mj_per_cm2": float(exposure),
        "turns_to_critical_exposure": None if critical is None else float(critical / exposure),
    }


def _light(grid: Grid, rig: Rig, room: Room, settings: PlanSettings) -> Light:
    optics = rig.writing_optics()
    radius = min(max(grid.shape[1:]) / 2 * grid.voxel_mm, room.radius_mm)
    return light_for(
        grid, settings.angles, radius_mm=radius, absorption_per_mm=rig.resin.absorption_per_mm or 0.0,
        tilt_at=None if optics is None else ray_tilt(strip_positions(radius, grid.voxel_mm), optics),
        climbing=settings.climbing and optics is not None,
        projector_blur_mm=settings.projector_blur_mm, diffusion_mm=settings.diffusion_mm, held=settings.held,
    )  # fmt: skip


def _write(out: str | Path, plan: Plan, dose: Float32Array | None) -> dict[str, Any]:
    """Write a plan, its metrics, and where there is a dose to show, the page."""
    out = Path(out)
    result = {
        "inputs": dict(plan.inputs),
        "settings": dict(plan.settings),
        "patterns": {
            "shape": list(plan.patterns.levels.shape),
            "first_row": plan.patterns.first_row,
            "first_column": plan.patterns.first_column,
            "dose_rate_per_level": plan.patterns.dose_rate_per_level,
        },
        "metrics": dict(plan.metrics),
        "versions": versions(),
    }
    with staged_folder(out.parent) as folder:
        write_plan(folder / out.name, plan)
        write_json(folder / f"{out.stem}.json", result)
        if dose is not None:
            from vialight.report import write_plan_page

            write_plan_page(folder / f"{out.stem}.html", plan, dose)
    return result
