"""Methods that compute projections for a target, behind one interface: an iterator of states.

Every method yields a `State` after each pass, so that whoever runs it can show progress, stop at any pass with the best
so far, keep a state and go on from it later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vialight.arrays import Float32Array, FloatArray
from vialight.projections.light import Light, collect, dose_of, filtered_projections

MethodName = Literal["object-space", "osmo", "gradient", "normalised"]

VOID_LIMIT = 0.85
"""Dose that a void may reach, where the part gets 1, by default."""


@dataclass(frozen=True)
class State:
    """Where a method stands after a pass.

    Parameters
    ----------
    passes
        Passes done.
    model
        (y, x, z) what the method carries on: the target as modified so far; for `gradient`, the projections.
    projections
        (psi, s, z) non-negative.
    dose
        (y, x, z) that they make.
    """

    passes: int
    model: Float32Array
    projections: Float32Array
    dose: Float32Array


@dataclass(frozen=True)
class Goal:
    """What is wanted of the dose.

    Parameters
    ----------
    inside
        (y, x, z) float32: share of each voxel inside the part, 0 to 1; from 1/2 on a voxel is meant to cure.
    reach
        (y, x, 1): 1 where light reaches from all sides; what lies outside is not judged.
    void_limit
        Dose that a void may reach.
    """

    inside: Float32Array
    reach: Float32Array
    void_limit: float = VOID_LIMIT

    def error_of(self, dose: Float32Array) -> Float32Array:
        """Return by how much each voxel's dose is off: both ways inside, only upwards in the void."""
        part = self.inside >= 0.5
        off = np.where(part, dose - 1, np.maximum(dose - self.void_limit, 0))
        return np.asarray(off * self.reach, dtype=np.float32)

    def cost_of(self, dose: Float32Array) -> float:
        """Return the sum of squares of `error_of`, in voxels."""
        return float(np.square(self.error_of(dose), dtype=np.float64).sum())


Method = Callable[[Goal, Light, State | None], Iterator[State]]


def normalised(
    goal: Goal,
    light: Light,
    state: State | None = None,
    *,
    background: float = 0.5,
    clip_level: float | None = None,
    bound_void: bool = False,
) -> Iterator[State]:
    """Iterate the paper's dose normalisation (Orth et al. 2022, Methods).

    The target I_0 is 1 in the part and `background` elsewhere.  Filtered projections are clipped from below, their dose
    D_k is computed, and the next target is ``I_{k+1} = I_0 / (D_k / I_0)``.  The first pass is filtered backprojection,
    the second what the paper prints.

    Parameters
    ----------
    goal, light, state
        As for every method.
    background
        Level B of the void.
    clip_level
        Projections are raised to that of a uniform volume of this level; None: the background's.  In that scale, dose
        equals target where nothing is clipped.
    bound_void
        Take the void's target as an upper bound: where its dose is lower, nothing is added.
    """
    floor = np.float32((background if clip_level is None else clip_level) / (2 * np.pi))
    first = np.where(goal.inside >= 0.5, 1, background).astype(np.float32) * goal.reach
    model, passes = (first, 0) if state is None else (state.model, state.passes)
    while True:
        projections = np.maximum(filtered_projections(model, light), floor)
        dose = dose_of(projections, light)
        passes += 1
        ratio = np.maximum(dose, 1e-6) / np.maximum(first, 1e-6)
        if bound_void:
            ratio = np.where(goal.inside >= 0.5, ratio, np.maximum(ratio, 1))
        model = (first / ratio).astype(np.float32)
        yield State(passes, model, projections, dose)


def osmo(
    goal: Goal, light: Light, state: State | None = None, *, low: float = 0.6, high: float = 0.85
) -> Iterator[State]:
    """Object-space model optimisation (Rackson et al. 2021).

    In turn, the model is raised inside the part where the dose, scaled to a maximum of 1, is below `high`, and lowered
    in the void where it is above `low`; projections are the model's, ramp-filtered and clipped at 0.

    Parameters
    ----------
    goal, light, state
        As for every method.
    low, high
        Thresholds, as shares of the largest dose.
    """
    part = goal.inside >= 0.5
    model, passes = (part.astype(np.float32), 0) if state is None else (state.model, state.passes)
    while True:
        _, scaled = _scaled_dose(model, light)
        model = model + np.where(part, np.maximum(high - scaled, 0), 0).astype(np.float32)
        _, scaled = _scaled_dose(model, light)
        model = model - np.where(part, 0, np.maximum(scaled - low, 0)).astype(np.float32) * goal.reach
        projections, dose = _scaled_dose(model, light)
        passes += 1
        # In units where the part's threshold is 1.
        yield State(passes, model, projections / np.float32(high), dose / np.float32(high))


def _scaled_dose(model: Float32Array, light: Light) -> tuple[Float32Array, Float32Array]:
    projections: Float32Array = np.maximum(filtered_projections(model, light), 0)
    dose = dose_of(projections, light)
    peak = np.float32(max(float(dose.max()), 1e-12))
    return np.asarray(projections / peak, np.float32), np.asarray(dose / peak, np.float32)


def object_space(goal: Goal, light: Light, state: State | None = None, *, step: float = 1.2) -> Iterator[State]:
    """Landweber steps in object space: the model moves by how much the dose is off.

    Projections are the model's, ramp-filtered and clipped at 0; then ``model -= step * error``, with the error of
    `Goal`.  Unlike `osmo`, both regions move at once, the dose keeps its scale, and inside it is held from both sides,
    so that the in-part range closes.

    Parameters
    ----------
    goal, light, state
        As for every method.
    step
        Relaxation, in units of the inverse of the filtered pair's largest eigenvalue: below 2 it converges.
    """
    step = step / _largest_eigenvalue_of_filtered_pair(light)
    model, passes = (goal.inside * goal.reach, 0) if state is None else (state.model, state.passes)
    while True:
        projections = np.maximum(filtered_projections(model, light), 0)
        dose = dose_of(projections, light)
        passes += 1
        model = model - np.float32(step) * goal.error_of(dose)
        yield State(passes, model, projections, dose)


def _largest_eigenvalue_of_filtered_pair(light: Light) -> float:
    """Return max(1, pi voxels / angles), with the voxels across the circle and the angles of a full turn.

    Filtered projections of few angles overlap too much near the axis; measured in docs/normalisation.md.
    """
    geometry = light.geometry
    angles = len(geometry.psi_rad) * (2 if geometry.from_both_sides else 1)
    across = geometry.samples * geometry.spacing_mm / geometry.voxel_mm
    return float(max(1.0, np.pi * across / angles))


def gradient(goal: Goal, light: Light, state: State | None = None, *, steps: int = 10) -> Iterator[State]:
    """Quasi-Newton descent (L-BFGS-B, Byrd et al. 1995) on the squared threshold losses of `Goal`.

    The losses are convex in the projections, which are bounded below by 0: it converges on every target to the best
    that these losses allow.  It starts from clipped filtered projections.

    Parameters
    ----------
    goal, light, state
        As for every method.
    steps
        Quasi-Newton steps in a pass; the memory of curvature begins anew with each pass.
    """
    from scipy.optimize import Bounds, minimize

    if state is None:
        now, passes = np.maximum(filtered_projections(goal.inside * goal.reach, light), 0), 0
    else:
        now, passes = state.projections, state.passes
    shape = now.shape

    def cost(values: FloatArray) -> tuple[float, FloatArray]:
        off = goal.error_of(dose_of(values.reshape(shape).astype(np.float32), light))
        slope = collect(2 * off, light)
        return float(np.square(off, dtype=np.float64).sum()), slope.ravel().astype(np.float64)

    while True:
        found = minimize(
            cost, now.ravel().astype(np.float64), jac=True, method="L-BFGS-B", bounds=Bounds(lb=0),
            options={"maxiter": steps, "maxcor": 8, "ftol": 0, "gtol": 0},
        )  # fmt: skip
        now = found.x.reshape(shape).astype(np.float32)
        passes += 1
        yield State(passes, now, now, dose_of(now, light))
