"""Rehearse a print: how a resin would cure under a plan's patterns, and when the light had best go off.

A rehearsal spreads a turn's dose evenly over the turn, so that only the chemistry is computed from step to step: half a
second a resin for a part of 10 mm on voxels of 0.2 mm.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, Grid, IntArray
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Plan
from vialight.metrology import sample_surface, signed_distance
from vialight.metrology.distance import SurfaceTree
from vialight.twin import ResinModel, TwinSettings, dose_of, grid_round
from vialight.twin.chemistry import Cure, cure, fresh
from vialight.twin.truth import gelled_surface

PLACES = 2000
SURFACE_SAMPLES = 10_000

_STEP_S = 1.0
_LOOK_S = 3.0
"""Between looks at the density."""
_KEPT_SHARE = 0.01
"""Of the lit time, between states kept as candidates for the best stop."""
_FIRST_VOLUME, _LAST_VOLUME, _LARGEST_VOLUME = 0.8, 1.35, 2.0
"""Shares of the part's volume: candidates begin, may end when all places are seen to have cured, and end anyway."""
_DARK_STEP_S = 2.0
_DARK_LIFETIMES = 6.0
"""After which nothing gels any more."""


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
        self._points = _spread(mesh)

    def rmse_mm(self, printed: Mesh) -> float:
        """Return the two-sided RMSE: of all distances, print to design and design to print, each side weighing half."""
        there = self._tree.nearest(_spread(printed)).distance_mm
        back = SurfaceTree(printed).nearest(self._points).distance_mm
        return float(np.sqrt((np.mean(there**2) + np.mean(back**2)) / 2))


@dataclass(frozen=True)
class Rehearsal:
    """A print, rehearsed in one resin.

    Parameters
    ----------
    crossing_s
        (place,) lit time at which each place's density, the mean of the last turn, passes that at the gel point; NaN
        where it never does.
    stop_s
        Lit time at which the light should go off.
    rmse_mm
        What the two-sided RMSE then is.
    at_stop
        The resin's state at about that time.
    """

    crossing_s: FloatArray = field(repr=False)
    stop_s: float
    rmse_mm: float
    at_stop: Cure = field(repr=False)


class Rehearser:
    """All that rehearsals of a plan share.

    Parameters
    ----------
    plan
        What will be printed.
    rig
        The printer.
    resin
        What is believed to be in its vial.
    voxel_mm
        Of the chemistry.
    resolution_mm
        Standard deviation of the live volume's point spread.

    Attributes
    ----------
    rig : Rig
        With the resin in its vial.
    points_mm : numpy.ndarray
        (place, xyz) places inside the part that are watched.
    near_surface : numpy.ndarray
        (z, y, x) bool, voxels within one voxel of the design's surface.
    mj_per_s : numpy.ndarray
        (y, x, z) float32, mJ/cm^2 of light a second, the mean of a turn.

    Raises
    ------
    InputError
        The rig does not say how bright it is, or has no vial.
    """

    def __init__(self, plan: Plan, rig: Rig, resin: ResinModel, voxel_mm: float, resolution_mm: float) -> None:
        self.rig, self._resin, self._resolution_mm = resin.in_vial_of(rig), resin, resolution_mm
        optics, projector = self.rig.writing_optics(), self.rig.need_projector()
        if projector.irradiance_mw_per_cm2 is None or optics is None:
            raise InputError(
                f"{rig.source} [projector]", "does not say how bright it is",
                accepted="irradiance_mw_per_cm2 and a vial", remedy="add it, or use --stop manual",
            )  # fmt: skip
        self.grid = grid_round(plan.reference, voxel_mm, reach_mm=optics.field_radius_mm)
        self.turn_s = 360 / self.rig.stage.speed_deg_s
        a_turn = dose_of(plan.patterns, self.rig, self.grid, blur_mm=TwinSettings().blur_mm).transpose(1, 2, 0)
        # A dose of 1 is 1 rad of light at 1 / (255 dose_rate_per_level) of full level.
        mj = projector.irradiance_mw_per_cm2 / 255 / np.radians(self.rig.stage.speed_deg_s)
        rate = np.float32(mj / plan.patterns.dose_rate_per_level / self.turn_s)
        self.mj_per_s: Float32Array = np.ascontiguousarray(a_turn * rate)
        self.design = Design(plan.reference)
        depth = depth_in(plan.reference, self.grid)
        self.near_surface: BoolArray = np.abs(depth) < voxel_mm
        self._part_voxels = int((depth > 0).sum())
        watched = np.flatnonzero(depth.transpose(1, 2, 0) > voxel_mm / 2)
        if len(watched) > PLACES:
            watched = np.sort(np.random.default_rng(0).choice(watched, PLACES, replace=False))
        self._watched: IntArray = watched
        iy, ix, iz = np.unravel_index(watched, self.mj_per_s.shape)
        self.points_mm: FloatArray = np.stack([self.grid.x_mm[ix], self.grid.y_mm[iy], self.grid.z_mm[iz]], axis=1)

    def rehearse(self, resin: ResinModel, sensitivity: float = 1.0) -> Rehearsal:
        """Print in a resin, relative to whose own its sensitivity counts, until the print is overdone.

        Raises
        ------
        InputError
            The resin does not gel.
        """
        resin = replace(
            resin, chemistry=replace(resin.chemistry, sensitivity=sensitivity * resin.chemistry.sensitivity)
        )
        threshold = self._resin.gel_density  # of what is believed in, whatever is in the vial
        a_turn = max(1, round(self.turn_s / _LOOK_S))
        state, lit_s = fresh(self.grid, resin.chemistry), 0.0
        looks: list[Float32Array] = []
        kept: list[tuple[float, Cure]] = []
        longest_s = self._longest_s(resin)
        while lit_s < longest_s:
            state = self._cured(state, resin, self.mj_per_s, _STEP_S)
            lit_s += _STEP_S
            if lit_s % _LOOK_S:
                continue
            looks.append(self._look(resin, state))
            if kept and lit_s < kept[-1][0] * (1 + _KEPT_SHARE):
                continue
            share = self._volume_to_come(resin, state)
            if share > _FIRST_VOLUME:
                kept.append((lit_s, state))
            all_seen = (np.mean(looks[-a_turn:], axis=0) >= threshold).all()
            if share > _LARGEST_VOLUME or (share > _LAST_VOLUME and all_seen):
                break
        if not kept:
            raise InputError("resin", "does not gel in the rehearsal", remedy="check irradiance and absorption")
        stop_s, rmse_mm = self._best(kept, resin)
        at_stop = min(kept, key=lambda moment: abs(moment[0] - stop_s))[1]
        return Rehearsal(crossings_s(np.array(looks), _LOOK_S, a_turn, threshold), stop_s, rmse_mm, at_stop)

    def final_rmse_mm(self, state: Cure, resin: ResinModel) -> float:
        """Return the two-sided RMSE after the dark cure, if the light goes off now; infinite where nothing gels."""
        finished = self._finished(state, resin)
        if not float(finished.conversion.max()) > resin.chemistry.gel_conversion:
            return float("inf")
        return self.design.rmse_mm(gelled_surface(finished.conversion, self.grid, resin.chemistry.gel_conversion))

    def surface_density(self, state: Cure, resin: ResinModel) -> float:
        """Return I_p, as a calibration finds it: the mean of the live volume on the finished part's surface."""
        conversion = self._finished(state, resin).conversion
        surface = gelled_surface(conversion, self.grid, resin.chemistry.gel_conversion)
        z, y, x = ((surface.vertices_mm[:, ::-1] - np.array(self.grid.origin_mm)) / self.grid.voxel_mm).T
        return float(map_coordinates(self._blurred(resin, conversion), [y, x, z], order=1, mode="nearest").mean())

    def _finished(self, state: Cure, resin: ResinModel) -> Cure:
        """Return what becomes of a state in the dark."""
        dark = np.zeros_like(self.mj_per_s)
        for _ in range(int(np.ceil(_DARK_LIFETIMES / resin.chemistry.radical_decay_per_s / _DARK_STEP_S))):
            state = self._cured(state, resin, dark, _DARK_STEP_S)
        return state

    def _cured(self, state: Cure, resin: ResinModel, mj_per_s: Float32Array, duration_s: float) -> Cure:
        dose = mj_per_s * np.float32(duration_s)
        return cure(state, dose, duration_s, resin.chemistry, resin.absorption_per_mm, self.grid.voxel_mm)

    def _longest_s(self, resin: ResinModel) -> float:
        brightest = float(self.mj_per_s.max())
        critical = resin.chemistry.critical_dose_mj_per_cm2(resin.absorption_per_mm)
        return 20 * critical / brightest if brightest > 0 else 0.0

    def _look(self, resin: ResinModel, state: Cure) -> Float32Array:
        return np.asarray(self._blurred(resin, state.conversion).reshape(-1)[self._watched])

    def _blurred(self, resin: ResinModel, conversion: Float32Array) -> Float32Array:
        """Return (y, x, z) the density as a live volume has it."""
        density = resin.scattering.density(conversion)
        if self._resolution_mm > 0:
            density = gaussian_filter(density, self._resolution_mm / self.grid.voxel_mm)
        return density

    def _volume_to_come(self, resin: ResinModel, state: Cure) -> float:
        """Return what will have gelled when all radicals are trapped, as a share of the part."""
        chemistry = resin.chemistry
        reach = np.float32(chemistry.propagation_m3_per_mol_s / chemistry.radical_decay_per_s)
        coming = 1 - (1 - state.conversion) * np.exp(-reach * state.radicals)
        return float((coming >= chemistry.gel_conversion).sum()) / self._part_voxels

    def _best(self, kept: list[tuple[float, Cure]], resin: ResinModel) -> tuple[float, float]:
        """Return the lit time of the least error, and that error: thirds first, then a parabola."""
        errors: dict[int, float] = {}

        def error(index: int) -> float:
            if index not in errors:
                errors[index] = self.final_rmse_mm(kept[index][1], resin)
            return errors[index]

        low, high = 0, len(kept) - 1
        while high - low > 6:
            third = (high - low) // 3
            if error(low + third) < error(high - third):
                high -= third
            else:
                low += third
        near = range(low, high + 1)
        return lowest(np.array([kept[i][0] for i in near]), np.array([error(i) for i in near]))


def crossings_s(looks: Float32Array, look_s: float, window: int, threshold: float) -> FloatArray:
    """Return when the mean of the last looks passes a threshold.

    Parameters
    ----------
    looks
        (look, place) density, `look_s` apart, the first that long after the light went on; before it there was none.
    look_s
        Between looks.
    window
        Looks' worth of time that a live volume is the mean of.
    threshold
        I_p.

    Returns
    -------
    numpy.ndarray
        (place,) lit time, NaN where it never passes.

    Examples
    --------
    A density that rises evenly lags by half the window:

    >>> crossings_s(np.arange(1.0, 21.0, dtype=np.float32)[:, None], 3.0, 6, 10.0)
    array([39.])
    """
    before = np.zeros((window + 1, looks.shape[1]))
    integral = np.cumsum(np.concatenate([before, looks]), axis=0, dtype=np.float64)
    # By the trapezium rule: half of the first and of the last look lie outside the window.
    integral[1:] = (integral[1:] + integral[:-1]) / 2
    mean = (integral[window + 1 :] - integral[1:-window]) / window
    above = mean >= threshold
    after = np.argmax(above, axis=0)
    place = np.arange(looks.shape[1])
    low, high = np.where(after > 0, mean[after - 1, place], 0.0), mean[after, place]
    share = np.clip((threshold - low) / np.maximum(high - low, 1e-12), 0, 1)
    return np.where(above.any(axis=0), (after + share) * look_s, np.nan)


def lowest(times_s: FloatArray, errors_mm: FloatArray) -> tuple[float, float]:
    """Return where the parabola through the squares of errors about the least one is lowest, and the least error.

    Examples
    --------
    >>> times = np.arange(5.0)
    >>> round(lowest(times, np.sqrt(0.01 + 0.02 * (times - 1.8) ** 2))[0], 6)
    1.8
    """
    least = int(np.argmin(errors_mm))
    near = slice(max(0, least - 2), least + 3)
    times, squares = times_s[near], errors_mm[near] ** 2
    if len(times) < 3 or not np.isfinite(squares).all():
        return float(times_s[least]), float(errors_mm[least])
    curve = np.polynomial.Polynomial.fit(times, squares, 2)
    if not curve.convert().coef[-1] > 0:
        return float(times_s[least]), float(errors_mm[least])
    return float(np.clip(curve.deriv().roots()[0].real, times[0], times[-1])), float(errors_mm[least])


def depth_in(part: Mesh, grid: Grid) -> FloatArray:
    """Return (z, y, x) how deep inside a part each voxel's centre lies, mm; minus infinity well outside."""
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


def _spread(mesh: Mesh) -> FloatArray:
    """Return points spread evenly over a surface, its vertices left out."""
    return sample_surface(mesh, SURFACE_SAMPLES).points_mm[-SURFACE_SAMPLES:]
