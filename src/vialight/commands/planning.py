"""Compute the patterns that print a part; judge patterns under other conditions."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vialight.arrays import BoolArray, Float32Array, Grid, centred
from vialight.commands.provenance import inputs_json, versions
from vialight.config import Rig, load_rig
from vialight.errors import InputError
from vialight.mesh import load_mesh
from vialight.plan import Patterns, Plan
from vialight.projections import (
    DEFAULT_PASSES,
    VOID_LIMIT,
    Goal,
    Light,
    MethodName,
    Progress,
    State,
    light_for,
    make_patterns,
    method_named,
    optimise,
)
from vialight.scoring import Score, dose_of_patterns, score_dose
from vialight.store import SavedState, read_plan, read_state, staged_folder, write_json, write_plan, write_state
from vialight.target import Placement, Room, check_sound, place, printable_room, target_grid, voxelise
from vialight.viewing import ray_tilt


@dataclass(frozen=True)
class PlanSettings:
    """How to compute patterns.

    Parameters
    ----------
    method
        See `vialight.projections.methods`.
    passes
        Of the method; by default its own number.
    angles
        Projections in a turn, and patterns.
    voxel_mm
        By default the projector's pixel.
    coverage
        Voxels at the surface count by the share of them that is inside, instead of by their centres.
    void_limit
        Dose that a void may get, where the part gets 1.
    climbing
        Model the climb of rays above and below the optical axis; without, light stays in its slice, which is quicker
        and wrong by a few per cent at flat ends of a part.
    projector_blur_mm, diffusion_mm
        Standard deviations, in the resin, of what the forward model is to undo.
    background, clip_level, bound_void
        Of the method `normalised`.
    rotate_deg, scale, fit, centre
        See `vialight.target.place`.
    """

    method: MethodName = "object-space"
    passes: int | None = None
    angles: int = 360
    voxel_mm: float | None = None
    coverage: bool = False
    void_limit: float = VOID_LIMIT
    climbing: bool = True
    projector_blur_mm: float = 0.0
    diffusion_mm: float = 0.0
    background: float = 0.5
    clip_level: float | None = None
    bound_void: bool = False
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float | None = None
    fit: bool = False
    centre: bool = True

    def __post_init__(self) -> None:
        if self.angles < 4 or self.angles % 2:
            raise InputError("--angles", f"is {self.angles}", accepted="an even number, 4 or more")
        if self.passes is not None and self.passes < 1:
            raise InputError("--passes", f"is {self.passes}", accepted="1 or more")
        if not 0 < self.void_limit < 1:
            raise InputError("--void-limit", f"is {self.void_limit}", accepted="more than 0 and less than 1")
        for name in ("projector_blur_mm", "diffusion_mm"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(
                    f"--{name.removesuffix('_mm').replace('_', '-')}", f"is {value}", accepted="0 or more mm"
                )

    def method_parameters(self) -> dict[str, float | bool | None]:
        """Return the parameters that only its method knows."""
        if self.method != "normalised":
            return {}
        return {"background": self.background, "clip_level": self.clip_level, "bound_void": self.bound_void}


def plan_part(
    part_path: str | Path,
    rig_path: str | Path,
    out: str | Path,
    *,
    settings: PlanSettings | None = None,
    resume: str | Path | None = None,
    save_state: str | Path | None = None,
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
    resume, save_state
        Go on from a saved state; save where the method stood at the end.
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
    started = time.monotonic()
    settings = settings or PlanSettings()
    rig = load_rig(rig_path)
    room = printable_room(rig)
    mesh = load_mesh(part_path)
    placement = place(
        mesh, room, rotate_deg=settings.rotate_deg, scale=settings.scale, fit=settings.fit, centre=settings.centre,
        where=part_path,
    )  # fmt: skip
    check_sound(placement.mesh, part_path)
    grid = target_grid(placement.mesh, settings.voxel_mm or rig.need_projector().pixel_mm)
    target = voxelise(placement.mesh, grid, coverage=settings.coverage)
    light = _light(grid, rig, room, settings)
    goal = Goal(np.ascontiguousarray(target.transpose(1, 2, 0)), light.reach, settings.void_limit)
    method = method_named(settings.method, **settings.method_parameters())
    passes = settings.passes or DEFAULT_PASSES[settings.method]
    state = None
    if resume is not None:
        geometry = light.geometry
        state = State(*read_state(resume, (len(geometry.psi_rad), geometry.samples, grid.shape[0]), goal.inside.shape))
    best, last = optimise(goal, light, method, passes, state=state, progress=progress, keep_going=keep_going)
    if save_state is not None:
        write_state(save_state, SavedState(last.passes, last.model, last.projections, last.dose))
    patterns = make_patterns(best.projections, light, grid, rig)
    metrics, dose = judge(patterns, rig, grid, target)
    metrics |= {
        "passes": best.passes,
        "believed": _believed(best, goal).to_json(),
        "optimisation_s": round(time.monotonic() - started, 3),
    }
    plan = Plan(
        patterns, placement.mesh, target, grid, rig, asdict(settings) | _placement_json(placement), metrics,
        inputs_json(part=part_path, rig=rig_path),
    )  # fmt: skip
    return _write(out, plan, dose)


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
    score = score_dose(dose, target, _judged(grid), patterns)
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
    plain = light_for(grid, settings.angles, radius_mm=radius)
    positions = centred(plain.geometry.samples, plain.geometry.spacing_mm)
    return light_for(
        grid, settings.angles, radius_mm=radius, absorption_per_mm=rig.resin.absorption_per_mm or 0.0,
        tilt_at=None if optics is None else ray_tilt(positions, optics),
        climbing=settings.climbing and optics is not None,
        projector_blur_mm=settings.projector_blur_mm, diffusion_mm=settings.diffusion_mm,
    )  # fmt: skip


def _judged(grid: Grid) -> BoolArray:
    radius = max(grid.shape[1:]) / 2 * grid.voxel_mm
    return np.asarray(np.hypot(grid.x_mm, grid.y_mm[:, None]) <= radius)[None]


def _believed(best: State, goal: Goal) -> Score:
    return score_dose(best.dose, goal.inside, goal.reach > 0)


def _placement_json(placement: Placement) -> dict[str, Any]:
    return {"placement": placement.matrix.tolist(), "placed_scale": placement.scale}


def _write(out: str | Path, plan: Plan, dose: Float32Array) -> dict[str, Any]:
    from vialight.report import write_plan_page

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
        write_plan_page(folder / f"{out.stem}.html", plan, dose)
    return result
