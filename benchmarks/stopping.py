"""Print parts on the twin in resins of unknown sensitivity, and compare where `auto` stops with where it should have.

Usage: ``python benchmarks/stopping.py [--keep FOLDER] [--parts boat,part] [--markdown docs/stopping.md]``.  All of it
takes about a quarter of an hour on one core; prints that FOLDER holds are read from there.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from vialight.commands import PlanSettings
from vialight.control.history import fresh_history, observe, places, sample
from vialight.control.prediction import StopPrediction, predict, should_stop
from vialight.control.rehearsal import Design, Rehearser, lowest
from vialight.control.rehearsed_model import stop_model_for
from vialight.control.stop_model import StopModel
from vialight.core.arrays import Float32Array, FloatArray, IntArray
from vialight.core.config import Rig
from vialight.core.mesh import Mesh
from vialight.core.plan import Plan
from vialight.optics.viewing import ray_tilt
from vialight.planning.projections import Goal, light_for, make_patterns, method_named, optimise, strip_positions
from vialight.planning.shapes import bracket, gyroid, thin_wall_box
from vialight.planning.target import target_grid, voxelise
from vialight.store.foreign.meshes import load_mesh
from vialight.tomography.sliding.window import SlidingWindow
from vialight.twin import Faults, ResinModel, Twin, TwinSettings, find_rig, grid_round, load_resin, play
from vialight.twin.chemistry import Cure, cure, fresh
from vialight.twin.truth import gelled_surface

VOXEL_MM, BINNING = 0.2, 2
ANGLES, PASSES = 180, 20
IRRADIANCE_MW_PER_CM2 = 25.0
"""So that a part of plain walls takes the paper's 17 turns."""
FRAMES_A_TURN, LOOK_FRAMES = 180, 6
"""Frames between predictions; live, there is one with each."""
BRANCH_S = 2.0
"""Between states from which the light is cut."""
DARK_S, DARK_STEP_S = 40.0, 2.0
DARK_FRAMES = 20

SENSITIVITIES = (0.7, 0.85, 1.0, 1.2, 1.4)
GOAL_SHARE, LATEST_SHARE, RMSE_SHARE, RMSE_MM = 0.03, 0.05, 0.30, 0.015
SIGMAS = 2.0
"""Errors up to so many standard deviations count as covered."""

BOAT = Path(os.environ.get("VIALIGHT_CASES", Path(__file__).parents[2] / "shared" / "cases")) / "boat" / "boat.stl"
SAMPLE = Path(__file__).parents[1] / "src" / "vialight" / "commands" / "sample" / "part.stl"
PARTS: dict[str, Callable[[], Mesh]] = {
    "boat": lambda: load_mesh(BOAT),
    "part": lambda: load_mesh(SAMPLE),
    "gyroid": lambda: gyroid(10.0, 8.0, 6.0, 1.0, pitch_mm=0.1),
    "bracket": lambda: bracket(pitch_mm=0.1),
    "box": lambda: thin_wall_box((9.0, 7.0, 8.0), 0.6),
}


@dataclass(frozen=True)
class Upset:
    """What of the print the rehearsal does not know."""

    resin: Callable[[ResinModel], ResinModel] = lambda resin: resin
    settings: dict[str, Any] = field(default_factory=dict)
    voxel_mm: float = VOXEL_MM
    threshold: float = 1.0
    pixel_mm: float = 1.0
    axis_columns: float = 0.0


def _chemistry(**factors: float) -> Upset:
    def changed(resin: ResinModel) -> ResinModel:
        chemistry = resin.chemistry
        new = {name: by * getattr(chemistry, name) for name, by in factors.items()}
        return replace(resin, chemistry=replace(chemistry, **new))

    return Upset(changed)


def _middle(by: float) -> Upset:
    return Upset(
        lambda resin: replace(
            resin, scattering=replace(resin.scattering, middle_conversion=by * resin.scattering.middle_conversion)
        )
    )


WRONG_RESINS = {
    "diffusion x 2": _chemistry(oxygen_diffusion_mm2_per_s=2.0),
    "induction halved": _chemistry(oxygen_mol_per_m3=0.5),
    "scattering middle 10 % higher": _middle(1.1),
    "scattering middle 10 % lower": _middle(0.9),
}
UPSETS = {
    "voxels of 0.1 mm, steps of 0.5 s": Upset(voxel_mm=0.1, settings={"chemistry_step_s": 0.5}),
    "camera's pixel 1 % larger than believed, axis half a pixel off": Upset(pixel_mm=0.99, axis_columns=0.25),
    "imaging light fades by 5 % in 250 s": Upset(settings={"faults": Faults(led_drift_per_s=-2e-4)}),
    "5 % of frames dropped, times off by 10 ms": Upset(
        settings={"faults": Faults(dropped_share=0.05, timestamp_jitter_s=0.01)}
    ),
    "ten bubbles": Upset(settings={"faults": Faults(specks=10)}),
    "what scatters dims, by up to 15 %": Upset(settings={"extinction_mm2": 1e-4}),
    "projector out of focus, 0.1 mm": Upset(settings={"blur_mm": 0.1}),
}
NOMINAL = Upset()
UPSET_PARTS = ("boat", "gyroid")
"""That are also printed with what the rehearsal does not know, one in 14 turns, one in 6.5."""


@dataclass(frozen=True)
class Row:
    """One print: where it should have stopped and where it did."""

    part: str
    upset: str
    sensitivity: float
    best_s: float
    best_rmse_mm: float
    stop_s: float
    rmse_mm: float
    predicted_s: float
    sigma_s: float
    found_sensitivity: float
    ready_s: float
    rules_s: dict[str, float]

    @property
    def error(self) -> float:
        """Of the dose at the stop, relative to the best."""
        return self.stop_s / self.best_s - 1

    @property
    def covered(self) -> bool:
        """Whether the prediction is within `SIGMAS` of its standard deviations."""
        return abs(self.predicted_s - self.best_s) <= SIGMAS * self.sigma_s

    @property
    def is_close(self) -> bool:
        """Whether the RMSE reached is as near to the best as the goal asks."""
        return self.rmse_mm <= max((1 + RMSE_SHARE) * self.best_rmse_mm, self.best_rmse_mm + RMSE_MM)


def printer(irradiance_mw_per_cm2: float = IRRADIANCE_MW_PER_CM2) -> Rig:
    """Return the paper's printer, at a brightness, without resin."""
    rig = find_rig("orth2022-190")
    bright = rig.need_projector().model_copy(update={"irradiance_mw_per_cm2": irradiance_mw_per_cm2})
    return rig.model_copy(update={"projector": bright})


def plan_for(part: Mesh, rig: Rig, voxel_mm: float = VOXEL_MM, angles: int = ANGLES, passes: int = PASSES) -> Plan:
    """Plan a part on coarse voxels, and else as `vialight plan` does by default."""
    grid = target_grid(part, voxel_mm)
    target = voxelise(part, grid, coverage=True)
    optics = rig.writing_optics()
    assert optics is not None
    radius = min(max(grid.shape[1:]) / 2 * grid.voxel_mm, 0.98 * optics.field_radius_mm)
    light = light_for(
        grid, angles, radius_mm=radius, absorption_per_mm=rig.resin.absorption_per_mm or 0.0,
        tilt_at=ray_tilt(strip_positions(radius, voxel_mm), optics), climbing=True, held=PlanSettings().held,
    )  # fmt: skip
    goal = Goal(np.ascontiguousarray(target.transpose(1, 2, 0)), light.reach)
    best, _ = optimise(goal, light, method_named("object-space"), passes)
    return Plan(make_patterns(best.projections, light, grid, rig), part, target, grid, rig)


def recorded_by(rig: Rig) -> Rig:
    """Return the rig of the binned frames."""
    return rig.model_copy(update={"camera": rig.need_camera().binned(BINNING)})


class Prepared:
    """A part's plan and stop model, made once for all its prints."""

    def __init__(self, name: str, part: Mesh, rig: Rig, resin: ResinModel) -> None:
        self.name, self.resin, self.rig = name, resin, resin.in_vial_of(rig)
        self.plan = plan_for(part, self.rig)
        self.design = Design(part)
        self.model: StopModel = stop_model_for(self.plan, recorded_by(self.rig), resin, voxel_mm=VOXEL_MM)

    @classmethod
    def of(cls, name: str) -> Prepared:
        """Prepare one of `PARTS` for DUDMA."""
        return cls(name, PARTS[name](), printer(), load_resin("DUDMA"))


class Course:
    """A print on the twin with the light left on: what was seen, and states from which it can be cut."""

    def __init__(self, prepared: Prepared, upset: Upset, sensitivity: float, seed: int = 1) -> None:
        self.prepared = prepared
        changed = upset.resin(prepared.resin)
        self.resin = replace(changed, chemistry=replace(changed.chemistry, sensitivity=sensitivity))
        optics = prepared.rig.writing_optics()
        assert optics is not None
        grid = grid_round(prepared.plan.reference, upset.voxel_mm, reach_mm=optics.field_radius_mm)
        settings = replace(TwinSettings(binning=BINNING, seed=seed), **upset.settings)
        self.twin = Twin(prepared.rig, self.resin, grid, settings)
        self.states: list[tuple[float, Cure]] = []
        self._part_voxels = prepared.plan.reference.volume_mm3 / grid.voxel_mm**3
        self._see(upset)

    def _see(self, upset: Upset) -> None:
        window = self._window(upset)
        model, history = self.prepared.model, fresh_history(self.prepared.model)
        at = places(model, window.grid)
        self.prediction: StopPrediction | None = None
        self.stop_s = self.ready_s = np.inf
        self.seen: list[tuple[float, int, float]] = []
        for tick, moment in enumerate(play(self.twin, self.prepared.plan.patterns, turns=60, dark_turns=0)):
            now_s = self.twin.time_s
            if moment.frame is not None:
                window.add(moment.frame.counts, moment.frame.angle_rad)
            if np.isinf(self.stop_s) and self.prediction is not None and should_stop(self.prediction, now_s):
                self.stop_s = now_s
            if tick % LOOK_FRAMES == LOOK_FRAMES - 1:
                state = window.renew()
                history = observe(history, sample(window.volume, at), now_s, window.threshold)
                self.seen.append((now_s, int(np.isfinite(history.crossing_s).sum()), state.cured_volume_mm3))
                if np.isinf(self.stop_s):
                    self.prediction = predict(model, history)
                    if self.prediction.is_ready:
                        self.ready_s = min(self.ready_s, now_s)
            if self._keep(now_s):
                return

    def _window(self, upset: Upset) -> SlidingWindow:
        prepared, believed = self.prepared, recorded_by(self.prepared.rig)
        camera = believed.need_camera()
        camera = camera.model_copy(
            update={
                "pixel_mm": camera.pixel_mm * upset.pixel_mm, "axis_column": camera.axis_column + upset.axis_columns,
            }
        )  # fmt: skip
        rig = believed.model_copy(update={"camera": camera})
        frames = [self.twin.frame(of_the_empty_vial=True) for _ in range(DARK_FRAMES)]
        dark = np.mean([frame.counts for frame in frames if frame], axis=0)
        threshold = upset.threshold * BINNING**2 * prepared.resin.gel_density
        grid = grid_round(prepared.plan.reference, camera.pixel_mm / 2, margin_mm=0.6)
        return SlidingWindow(
            rig, self.twin.image_shape, FRAMES_A_TURN, dark=dark.astype(np.float32), threshold=threshold, grid=grid
        )

    def _keep(self, now_s: float) -> bool:
        """Keep states from which the light will be cut; return whether the print is overdone."""
        if abs(now_s / BRANCH_S - round(now_s / BRANCH_S)) > 1e-6 or now_s < 10:
            return False
        chemistry, state = self.resin.chemistry, self.twin.state
        reach = np.float32(chemistry.propagation_m3_per_mol_s / chemistry.radical_decay_per_s)
        coming = 1 - (1 - state.conversion) * np.exp(-reach * state.radicals)
        share = float((coming >= chemistry.gel_conversion).sum()) / self._part_voxels
        if share > 0.8:
            self.states.append((now_s, state))
        return share > 1.3 and now_s > self.stop_s + BRANCH_S

    def final_rmse_mm(self, index: int) -> float:
        """Return the two-sided RMSE of what one of the states becomes in the dark."""
        state, chemistry, grid = self.states[index][1], self.resin.chemistry, self.twin.grid
        dark: Float32Array = np.zeros_like(state.conversion)
        for _ in range(round(DARK_S / DARK_STEP_S)):
            state = cure(state, dark, DARK_STEP_S, chemistry, self.resin.absorption_per_mm, grid.voxel_mm)
        return self.prepared.design.rmse_mm(gelled_surface(state.conversion, grid, chemistry.gel_conversion))

    def sweep(self) -> tuple[FloatArray, FloatArray]:
        """Return lit times and final RMSE: every state near the best and at the stop, every fifth else."""
        times = np.array([time_s for time_s, _ in self.states])
        errors = {index: self.final_rmse_mm(index) for index in range(0, len(times), 5)}
        least = times[min(errors, key=errors.__getitem__)]
        near: IntArray = np.flatnonzero(
            (np.abs(times - least) < 0.04 * least + 5 * BRANCH_S) | (np.abs(times - self.stop_s) <= BRANCH_S)
        )
        errors |= {int(index): self.final_rmse_mm(int(index)) for index in near if int(index) not in errors}
        chosen = sorted(errors)
        return times[chosen], np.array([errors[index] for index in chosen])


def measure(prepared: Prepared, upset_name: str, upset: Upset, sensitivity: float) -> Row:
    """Print once, and find what the best stop would have been."""
    course = Course(prepared, upset, sensitivity)
    times, errors = course.sweep()
    best_s, best_rmse_mm = best_stop(times, errors)
    prediction = course.prediction
    assert prediction is not None
    return Row(
        prepared.name, upset_name, sensitivity, best_s, best_rmse_mm, course.stop_s,
        float(np.interp(course.stop_s, times, errors)), prediction.best_s, prediction.sigma_s, prediction.sensitivity,
        course.ready_s, simple_rules(prepared, course),
    )  # fmt: skip


def best_stop(times_s: FloatArray, errors_mm: FloatArray) -> tuple[float, float]:
    """Return where the final RMSE is least: the vertex of a parabola through its squares within 4 % of the least."""
    least = times_s[np.argmin(errors_mm)]
    near = np.abs(times_s - least) <= max(0.04 * least, 2.5 * BRANCH_S)
    curve = np.polynomial.Polynomial.fit(times_s[near], errors_mm[near] ** 2, 2)
    if near.sum() < 4 or curve.convert().coef[-1] <= 0:
        return lowest(times_s, errors_mm)
    vertex = float(np.clip(curve.deriv().roots()[0].real, times_s[near][0], times_s[near][-1]))
    return vertex, float(errors_mm.min())


def simple_rules(prepared: Prepared, course: Course) -> dict[str, float]:
    """Return when simpler rules would have stopped."""
    model = prepared.model
    nominal = int(np.flatnonzero(model.sensitivities == 1.0)[0])
    stop_s = float(model.stop_s[nominal])
    times, counts, volumes = (np.array(column, dtype=np.float64) for column in zip(*course.seen, strict=True))
    part_mm3 = prepared.plan.reference.volume_mm3
    onset_s = float(times[np.argmax(counts >= 0.02 * counts.max())])
    nominal_onset_s = float(np.nanquantile(model.crossing_s[nominal], 0.02))
    reached = volumes >= part_mm3
    return {
        "dose alone, as rehearsed": stop_s,
        "live volume as large as the part": float(times[np.argmax(reached)]) if reached.any() else float("inf"),
        "1.15 times the onset": 1.15 * onset_s,
        "onset times the rehearsed factor": stop_s * onset_s / nominal_onset_s,
    }


def within_a_turn(prepared: Prepared) -> list[tuple[float, float, float, float]]:
    """Return, over a turn about the best stop: turns, RMSE of patterns as they come and of an even dose, waiting."""
    course = Course(prepared, NOMINAL, 1.0)
    rehearser = Rehearser(prepared.plan, prepared.rig, prepared.resin, VOXEL_MM, 0.0)
    model, turn_s = prepared.model, prepared.model.turn_s
    best_s = float(model.stop_s[np.flatnonzero(model.sensitivities == 1.0)[0]])
    even, lit_s = fresh(rehearser.grid, prepared.resin.chemistry), 0.0
    rows = []
    for index, (time_s, _) in enumerate(course.states):
        while lit_s < time_s - 1e-9:
            even = cure(
                even, rehearser.mj_per_s, 1.0, prepared.resin.chemistry, prepared.resin.absorption_per_mm, VOXEL_MM
            )
            lit_s += 1.0
        if abs(time_s - best_s) <= turn_s / 2:
            phase = (time_s / turn_s) % 1 * len(model.waiting_s)
            waiting = np.interp(phase, range(len(model.waiting_s) + 1), [*model.waiting_s, model.waiting_s[0]])
            even_mm = rehearser.final_rmse_mm(even, prepared.resin)
            rows.append((time_s / turn_s, course.final_rmse_mm(index), even_mm, float(waiting)))
    return rows


@dataclass(frozen=True)
class Kept:
    """Results that took long, in a folder; without one, nothing is kept."""

    folder: Path | None

    def get(self, name: str, make: Callable[[], Any]) -> Any:
        """Return plain values, made once."""
        if self.folder is None:
            return make()
        path = self.folder / f"{re.sub(r'[^a-z0-9.]+', '-', name.lower())}.json"
        if not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(make()), encoding="utf-8")
        return json.loads(path.read_text(encoding="utf-8"))


def run(parts: list[str], kept: Kept) -> tuple[list[Row], dict[str, list[list[float]]]]:
    """Return all rows, and turns looked at closely, by part."""
    rows, turns = [], {}
    for name in parts:
        prepared = cache(partial(Prepared.of, name))
        cases = [("", NOMINAL, sensitivity) for sensitivity in SENSITIVITIES]
        cases += [(upset, change, 1.0) for upset, change in WRONG_RESINS.items()]
        if name in UPSET_PARTS:
            cases += [(upset, change, 1.0) for upset, change in UPSETS.items()]
            turns[name] = kept.get(f"{name} turn", partial(_made, prepared, within_a_turn))
        for upset, change, sensitivity in cases:
            started = time.monotonic()
            make = partial(_made, prepared, measure, upset, change, sensitivity)
            rows.append(Row(**kept.get(f"{name} {upset} {sensitivity:g}", make)))
            sys.stderr.write(f"{time.monotonic() - started:.1f} s: {rows[-1]}\n")
    return rows, turns


def _made(prepared: Callable[[], Prepared], make: Callable[..., Any], *arguments: Any) -> Any:
    """Return a result as plain values; the part is prepared only where there is something to make."""
    made = make(prepared(), *arguments)
    return asdict(made) if isinstance(made, Row) else made


def main() -> None:
    """Run, print, and write the page."""
    from stopping_page import page

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path, help="folder for results, read from there the next time")
    parser.add_argument("--parts", default=",".join(PARTS), help="of %(default)s")
    parser.add_argument("--markdown", type=Path, help="page to write")
    given = parser.parse_args()
    text = page(*run(given.parts.split(","), Kept(given.keep)))
    sys.stdout.write(text)
    if given.markdown:
        given.markdown.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
