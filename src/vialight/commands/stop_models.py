"""Rehearse a print in resins of different sensitivity, to know when each place will be seen to cure and when to stop.

A rehearsal spreads a turn's dose evenly over the turn, so that only the chemistry is computed from step to step: about
a second a resin on voxels of 0.2 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter

from vialight.arrays import BoolArray, Float32Array, FloatArray, Grid, IntArray
from vialight.config import Rig
from vialight.errors import InputError
from vialight.feedback import Doubt, StopModel
from vialight.mesh import Mesh
from vialight.metrology import sample_surface, signed_distance
from vialight.metrology.distance import SurfaceTree
from vialight.plan import Patterns, Plan
from vialight.twin import ResinModel, dose_of, grid_round
from vialight.twin.chemistry import Cure, cure, fresh
from vialight.twin.truth import gelled_surface

SENSITIVITIES = (0.6, 0.8, 1.0, 1.25, 1.6)
PLACES = 2000
SURFACE_SAMPLES = 10_000
PHASES = 12
PROJECTOR_BLUR_MM = 0.05
"""As the twin's, see ``docs/twin.md``."""

_STEP_S = 1.0
_LOOK_S = 3.0
"""Between looks at the density."""
_KEPT_SHARE = 0.01
"""Of the time between states kept as candidates for the best stop."""
_DARK_TIMES = 6.0
"""In units of the radicals' lifetime, after which nothing gels any more."""


@dataclass(frozen=True)
class Rehearsal:
    """A print, rehearsed in one resin.

    Parameters
    ----------
    crossing_s
        (place,) lit time at which each place's density, the mean of the last turn, passes I_p; NaN where it never does.
    stop_s
        Lit time at which the light should go off.
    rmse_mm
        What the two-sided RMSE then is.
    """

    crossing_s: FloatArray
    stop_s: float
    rmse_mm: float


class Design:
    """A part that printed surfaces are compared with, as placed.

    Parameters
    ----------
    mesh
        The part.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self._tree = SurfaceTree(mesh)
        self._points = sample_surface(mesh, SURFACE_SAMPLES).points_mm[-SURFACE_SAMPLES:]

    def rmse_mm(self, printed: Mesh) -> float:
        """Return the two-sided RMSE: of all distances, print to design and design to print, each side weighing half."""
        there = self._tree.nearest(sample_surface(printed, SURFACE_SAMPLES).points_mm[-SURFACE_SAMPLES:]).distance_mm
        back = SurfaceTree(printed).nearest(self._points).distance_mm
        return float(np.sqrt((np.mean(there**2) + np.mean(back**2)) / 2))


def stop_model_for(
    plan: Plan,
    rig: Rig,
    resin: ResinModel,
    *,
    voxel_mm: float = 0.2,
    resolution_mm: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> StopModel:
    """Rehearse a plan, for `vialight.feedback` to tell from what is seen when to stop.

    Parameters
    ----------
    plan
        What will be printed.
    rig
        The printer.
    resin
        What the resin is believed to be; its sensitivity counts as 1.
    voxel_mm
        Of the rehearsal, and edge of the places watched.
    resolution_mm
        Standard deviation of the live volume's point spread; by default that of the rig's camera: pixels are
        interpolated linearly and filtered by a cosine, and the density of a cube is averaged.
    progress
        Called with rehearsals done and to do.

    Raises
    ------
    InputError
        The resin does not gel, or the rig says too little.
    """
    stage = _Stage(
        plan,
        rig,
        resin,
        voxel_mm,
        _resolution_mm(resin.in_vial_of(rig), voxel_mm) if resolution_mm is None else resolution_mm,
    )
    doubted = _doubted(resin)
    runs: list[Rehearsal] = []
    for count, (model, sensitivity) in enumerate(
        [(resin, s) for s in SENSITIVITIES] + [(m, 1.0) for m in doubted.values()]
    ):
        runs.append(stage.rehearse(model, sensitivity))
        if progress:
            progress(count + 1, len(SENSITIVITIES) + len(doubted))
    nominal = runs[SENSITIVITIES.index(1.0)]
    doubts = tuple(
        Doubt(name, np.log(run.crossing_s / nominal.crossing_s), float(np.log(run.stop_s / nominal.stop_s)))
        for name, run in zip(doubted, runs[len(SENSITIVITIES) :], strict=True)
    )
    by_sensitivity = runs[: len(SENSITIVITIES)]
    return StopModel(
        stage.points_mm, voxel_mm, np.array(SENSITIVITIES), np.stack([run.crossing_s for run in by_sensitivity]),
        np.array([run.stop_s for run in by_sensitivity]), doubts, stage.turn_s,
        waiting_s(plan, stage.rig, stage.grid, stage.near_surface),
    )  # fmt: skip


def _resolution_mm(rig: Rig, cube_mm: float) -> float:
    optics = rig.imaging_optics()
    spacing = rig.need_camera().pixel_mm / (1.0 if optics is None else optics.resin_index)
    # Variances of a cosine filter (two deltas half a spacing off), of linear interpolation, and of a cube.
    return float(np.sqrt(spacing**2 * (1 / 4 + 1 / 6) + cube_mm**2 / 12))


def _doubted(resin: ResinModel) -> dict[str, ResinModel]:
    """Return resins that differ from the believed one in what may be wrong, by one standard deviation of its prior."""
    chemistry, scattering = resin.chemistry, resin.scattering
    changed = {
        "diffusion of oxygen": {"oxygen_diffusion_mm2_per_s": 1.5},
        "oxygen, and so induction": {"oxygen_mol_per_m3": 0.7},
        # Both, so that it takes as much light as before.
        "lifetime of radicals": {"radical_decay_per_s": 1.5, "propagation_m3_per_mol_s": 1.5},
    }
    resins = {
        name: replace(
            resin, chemistry=replace(chemistry, **{key: getattr(chemistry, key) * by for key, by in change.items()})
        )
        for name, change in changed.items()
    }
    seen_later = replace(scattering, middle_conversion=1.07 * scattering.middle_conversion)
    return resins | {"density at the gel point": replace(resin, scattering=seen_later)}


class _Stage:
    """All that rehearsals of a plan share."""

    def __init__(self, plan: Plan, rig: Rig, resin: ResinModel, voxel_mm: float, resolution_mm: float) -> None:
        self.rig = resin.in_vial_of(rig)
        optics, projector = self.rig.writing_optics(), self.rig.need_projector()
        if projector.irradiance_mw_per_cm2 is None or optics is None:
            raise InputError(
                f"{rig.source} [projector]", "does not say how bright it is",
                accepted="irradiance_mw_per_cm2 and a vial", remedy="add it, or use --stop manual",
            )  # fmt: skip
        self.believed, self.voxel_mm, self.resolution_mm = resin, voxel_mm, resolution_mm
        self.grid = grid_round(plan.reference, voxel_mm, reach_mm=optics.field_radius_mm)
        self.turn_s = 360 / self.rig.stage.speed_deg_s
        a_turn = dose_of(plan.patterns, self.rig, self.grid, blur_mm=PROJECTOR_BLUR_MM).transpose(1, 2, 0)
        # A dose of 1 is 1 rad of light at 1 / (255 dose_rate_per_level) of full level.
        mj = projector.irradiance_mw_per_cm2 / 255 / np.radians(self.rig.stage.speed_deg_s)
        self.mj_per_s: Float32Array = np.ascontiguousarray(
            a_turn * np.float32(mj / plan.patterns.dose_rate_per_level / self.turn_s)
        )
        self.design = Design(plan.reference)
        depth = _depth(plan.reference, self.grid)
        self.near_surface: BoolArray = np.abs(depth) < voxel_mm
        watched = np.flatnonzero(depth.transpose(1, 2, 0) > voxel_mm / 2)
        if len(watched) > PLACES:
            watched = np.sort(np.random.default_rng(0).choice(watched, PLACES, replace=False))
        self._watched: IntArray = watched
        shape = self.mj_per_s.shape
        iy, ix, iz = np.unravel_index(watched, shape)
        self.points_mm: FloatArray = np.stack([self.grid.x_mm[ix], self.grid.y_mm[iy], self.grid.z_mm[iz]], axis=1)
        self._part_voxels = int((depth > 0).sum())

    def rehearse(self, resin: ResinModel, sensitivity: float) -> Rehearsal:
        """Print in a resin until the print is overdone."""
        chemistry = replace(resin.chemistry, sensitivity=sensitivity * resin.chemistry.sensitivity)
        mu = self.believed.absorption_per_mm
        # I_p is the density at the gel point of the resin that it was calibrated in.
        threshold = float(
            self.believed.scattering.density(np.array([self.believed.chemistry.gel_conversion], np.float32))[0]
        )
        reach = np.float32(chemistry.propagation_m3_per_mol_s / chemistry.radical_decay_per_s)
        state, lit_s, dose = fresh(self.grid, chemistry), 0.0, self.mj_per_s * np.float32(_STEP_S)
        looks: list[Float32Array] = []
        kept: list[tuple[float, Cure]] = []
        longest = 20 * chemistry.critical_dose_mj_per_cm2(mu) / max(float(self.mj_per_s.max()), 1e-12)
        while lit_s < longest:
            state = cure(state, dose, _STEP_S, chemistry, mu, self.grid.voxel_mm)
            lit_s += _STEP_S
            if lit_s % _LOOK_S == 0:
                looks.append(self._look(resin, state))
            if (not kept and lit_s % _LOOK_S) or (kept and lit_s < kept[-1][0] * (1 + _KEPT_SHARE)):
                continue
            coming = 1 - (1 - state.conversion) * np.exp(-reach * state.radicals)
            share = float((coming >= chemistry.gel_conversion).sum()) / self._part_voxels
            if share > 0.8:
                kept.append((lit_s, state))
            if share > 1.35 and looks[-1].min() > threshold:
                break
            if share > 2.0:
                break
        if not kept:
            raise InputError("resin", "does not gel in the rehearsal", remedy="check irradiance and absorption")
        stop_s, rmse = self._best(kept, replace(resin, chemistry=chemistry))
        return Rehearsal(self._crossings(np.array(looks), threshold), stop_s, rmse)

    def _look(self, resin: ResinModel, state: Cure) -> Float32Array:
        density = resin.scattering.density(state.conversion)
        if self.resolution_mm > 0:
            density = gaussian_filter(density, self.resolution_mm / self.voxel_mm)
        return np.asarray(density.reshape(-1)[self._watched])

    def _crossings(self, looks: Float32Array, threshold: float) -> FloatArray:
        """Return when the mean of the last turn's looks (look, place) passes the threshold."""
        window = max(1, round(self.turn_s / _LOOK_S))
        sums = np.cumsum(np.concatenate([np.zeros((window, looks.shape[1])), looks.astype(np.float64)]), axis=0)
        # Of the turn's first and last look half belongs to the window.
        ends = (looks + np.concatenate([np.zeros((window, looks.shape[1])), looks[:-window]])) / 2
        inner = np.concatenate([np.zeros((1, looks.shape[1])), sums[window:-1] - sums[1:-window]])
        mean = (inner + ends) / window
        above = mean >= threshold
        after = np.argmax(above, axis=0)
        before = np.maximum(after - 1, 0)
        column = np.arange(looks.shape[1])
        low, high = mean[before, column], mean[after, column]
        share = np.clip((threshold - low) / np.maximum(high - low, 1e-12), 0, 1)
        return np.where(above.any(axis=0), (after + share) * _LOOK_S, np.nan)

    def _best(self, kept: list[tuple[float, Cure]], resin: ResinModel) -> tuple[float, float]:
        """Return the lit time after which the dark cure ends closest to the design, and how close."""
        errors: dict[int, float] = {}

        def error(index: int) -> float:
            if index not in errors:
                errors[index] = self._final_error(kept[index][1], resin)
            return errors[index]

        low, high = 0, len(kept) - 1
        while high - low > 6:
            third = (high - low) // 3
            if error(low + third) < error(high - third):
                high -= third
            else:
                low += third
        return vertex(
            np.array([kept[i][0] for i in range(low, high + 1)]), np.array([error(i) for i in range(low, high + 1)])
        )

    def _final_error(self, state: Cure, resin: ResinModel) -> float:
        dark, step_s = np.zeros_like(self.mj_per_s), 2.0
        for _ in range(int(np.ceil(_DARK_TIMES / resin.chemistry.radical_decay_per_s / step_s))):
            state = cure(state, dark, step_s, resin.chemistry, self.believed.absorption_per_mm, self.grid.voxel_mm)
        return self.design.rmse_mm(gelled_surface(state.conversion, self.grid, resin.chemistry.gel_conversion))


def vertex(times_s: FloatArray, errors_mm: FloatArray) -> tuple[float, float]:
    """Return where the parabola through the squares of errors about the least one is lowest, and the least error.

    Examples
    --------
    >>> times = np.arange(5.0)
    >>> round(vertex(times, np.sqrt(0.01 + 0.02 * (times - 1.8) ** 2))[0], 6)
    1.8
    """
    least = int(np.argmin(errors_mm))
    near = slice(max(0, least - 2), least + 3)
    curve = np.polynomial.Polynomial.fit(times_s[near], errors_mm[near] ** 2, 2)
    if len(times_s[near]) < 3 or curve.convert().coef[-1] <= 0:
        return float(times_s[least]), float(errors_mm[least])
    lowest = float(np.clip(curve.deriv().roots()[0].real, times_s[near][0], times_s[near][-1]))
    return lowest, float(errors_mm[least])


def _depth(part: Mesh, grid: Grid) -> FloatArray:
    """Return (z, y, x) how deep inside a part each voxel's centre lies, mm; far outside, only that it is outside."""
    low, high = part.bounds_mm
    margin = 3 * grid.voxel_mm
    near = [
        np.flatnonzero((axis > low[i] - margin) & (axis < high[i] + margin))
        for i, axis in ((2, grid.z_mm), (1, grid.y_mm), (0, grid.x_mm))
    ]
    z, y, x = np.meshgrid(grid.z_mm[near[0]], grid.y_mm[near[1]], grid.x_mm[near[2]], indexing="ij")
    depth = np.full(grid.shape, -np.inf)
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    depth[np.ix_(*near)] = -signed_distance(points, part).reshape(x.shape)
    return depth


def waiting_s(plan: Plan, rig: Rig, grid: Grid, near_surface: BoolArray) -> FloatArray:
    """Return (phase,) by how many seconds places near the design's surface are ahead or behind after a part of a turn.

    Root mean square over places, and over the angle at which the turn began: light may have paused.
    """
    patterns = plan.patterns
    count = len(patterns.levels)
    edges = np.linspace(0, count, PHASES + 1).round().astype(int)
    parts = np.stack([
        dose_of(
            Patterns(
                patterns.levels[a:b], patterns.angles_rad[a:b], patterns.first_row, patterns.first_column,
                patterns.dose_rate_per_level,
            ),
            rig, grid, turns=(b - a) / count,
        )[near_surface]
        for a, b in pairwise(edges)
    ])  # fmt: skip
    whole = parts.sum(axis=0)
    shares = parts[:, whole > 0] / whole[whole > 0]
    ahead = np.concatenate([np.zeros((1, shares.shape[1])), np.cumsum(np.concatenate([shares, shares]), axis=0)])
    begins = np.arange(PHASES)
    turn_s = 360 / rig.stage.speed_deg_s
    return np.array(
        [turn_s * np.sqrt(np.mean((ahead[begins + k] - ahead[begins] - k / PHASES) ** 2)) for k in range(PHASES)]
    )
