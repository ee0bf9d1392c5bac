"""Methods that compute projections for a target, behind one interface: an iterator of states.

Every method yields a `State` after each pass, so that whoever runs it can show progress, stop at any pass with the best
so far, keep a state and go on from it later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vialight.arrays import Float32Array
from vialight.projections.light import Light, collect, dose_of, filtered_projections
from vialight.radon import ramp_filter

MethodName = Literal["object-space", "osmo", "gradient", "normalised"]

VOID_LIMIT = 0.85
"""Dose that a void may reach, where the part gets 1, by default."""

CEILING = 0.3
"""Light that `object_space` allows, in that of the brightest ray of filtered backprojection, by default."""


@dataclass(frozen=True)
class State:
    """Where a method stands after a pass.

    Parameters
    ----------
    passes
        Passes done.
    model
        What the method carries on: the target as modified so far, (y, x, z); for `object_space` also the one before,
        (2, y, x, z); for `gradient`, the projections.
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
    part, useful = goal.inside >= 0.5, _strips_of_use(goal, light)
    model, passes = (part.astype(np.float32), 0) if state is None else (state.model, state.passes)
    _, scaled = _scaled_dose(model, light, useful)
    while True:
        model = model + np.where(part, np.maximum(high - scaled, 0), 0).astype(np.float32)
        _, scaled = _scaled_dose(model, light, useful)
        model = model - np.where(part, 0, np.maximum(scaled - low, 0)).astype(np.float32) * goal.reach
        projections, scaled = _scaled_dose(model, light, useful)
        passes += 1
        # In units where the part's threshold is 1.
        yield State(passes, model, projections / np.float32(high), scaled / np.float32(high))


def _strips_of_use(goal: Goal, light: Light) -> Float32Array:
    """Return (s, 1): 1 for strips that can light the part at some angle, 0 for those that only pass beside it.

    Filtered projections have light there too, beside voids that a model has lowered.  It does no good, and what it does
    at the rim, where nothing is judged, no method sees.
    """
    geometry = light.geometry
    radius = np.hypot(geometry.x_mm, geometry.y_mm[:, None])[:, :, None]
    farthest = float((radius * ((goal.inside > 0) & (goal.reach > 0))).max()) + geometry.voxel_mm
    farthest += 2 * math.hypot(light.projector_blur_mm, light.diffusion_mm)
    s_mm = geometry.first_s_mm + np.arange(geometry.samples) * geometry.spacing_mm
    return np.asarray(np.abs(s_mm) <= farthest, dtype=np.float32)[:, None]


def _scaled_dose(model: Float32Array, light: Light, useful: Float32Array) -> tuple[Float32Array, Float32Array]:
    projections: Float32Array = np.maximum(filtered_projections(model, light), 0) * useful
    dose = dose_of(projections, light)
    peak = np.float32(max(float(dose.max()), 1e-12))
    return np.asarray(projections / peak, np.float32), np.asarray(dose / peak, np.float32)


def object_space(
    goal: Goal, light: Light, state: State | None = None, *, step: float = 0.9, ceiling: float = CEILING
) -> Iterator[State]:
    """Accelerated Landweber steps in object space: the model moves by how much the dose is off, and keeps some speed.

    Projections are the model's, ramp-filtered and clipped from 0 to a ceiling; then ``model -= step * error``, with the
    error of `Goal`.  Unlike `osmo`, both regions move at once, the dose keeps its scale, and inside it is held from
    both sides, so that the in-part range closes.  Each step starts from the model pushed on by (k - 1) / (k + 2) of its
    last move (Nesterov 1983): half as many passes come as far.

    The filtered pair's largest eigenvalue was found to be 1.27 (64 voxels across) to 1.43 (128), for waves at the rim;
    such steps converge below 4/3 of its inverse.  Absorption raises it, and so do few angles: the step is divided by
    `_gain`.  Where light is blurred, so is the error, as the transpose of the light would have it:
    without, the model runs away.

    A few rays of filtered backprojection are far brighter than all others, those along flat sides of the part.  The
    brightest sets what one grey level is, and with it how long a print takes.  Under a ceiling others do their work.

    Parameters
    ----------
    goal, light, state
        As for every method; its model is two volumes, the latest and the one before.
    step
        Relaxation.
    ceiling
        Light allowed, in that of the brightest ray of the part's filtered backprojection, but never less than the
        brightest 2 % of lit rays have there: a disk needs them all.  1 or more: any.
    """
    start = goal.inside * goal.reach
    models, passes = (np.stack([start, start]), 0) if state is None else (state.model, state.passes)
    step, useful = step / _gain(light), _strips_of_use(goal, light)
    top = np.float32(np.inf if ceiling >= 1 else _ceiling(filtered_projections(start, light) * useful, ceiling))
    while True:
        latest, before = models
        pushed = latest + np.float32(max(passes - 1, 0) / (passes + 2)) * (latest - before)
        projections = np.asarray(np.clip(filtered_projections(pushed, light), 0, top) * useful, np.float32)
        dose = dose_of(projections, light)
        passes += 1
        models = np.stack([pushed - np.float32(step) * _blurred(goal.error_of(dose), light), latest])
        yield State(passes, models, projections, dose)


def _ceiling(projections: Float32Array, ceiling: float) -> float:
    lit = projections[projections > 0]
    return max(ceiling * float(lit.max()), float(np.quantile(lit, _FEW_RAYS))) if len(lit) else math.inf


_FEW_RAYS = 0.98
"""Share of lit rays that are never bounded by a ceiling."""


def _gain(light: Light) -> float:
    """Return by what the filtered pair's largest eigenvalue is raised.

    At the rim absorption raises it by the mean of ``cosh(mu t)``; near the axis, where projections overlap, few angles
    raise it by pi times the voxels across over the angles of a full turn (measured in docs/normalisation.md).
    """
    geometry = light.geometry
    radius_mm = -geometry.first_s_mm
    angles = len(geometry.psi_rad) * (2 if geometry.from_both_sides else 1)
    few_angles = np.pi * geometry.samples * geometry.spacing_mm / geometry.voxel_mm / angles
    return max(float(np.i0(geometry.absorption_per_mm * radius_mm)), few_angles)


def _blurred(volume: Float32Array, light: Light) -> Float32Array:
    """Blur a volume as its projections and its dose would be."""
    sigma_mm = math.hypot(light.projector_blur_mm, light.diffusion_mm)
    if sigma_mm == 0:
        return volume
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(volume, sigma_mm / light.geometry.voxel_mm, mode="constant"), np.float32)


def gradient(goal: Goal, light: Light, state: State | None = None, *, steps: int = 10) -> Iterator[State]:
    """Quasi-Newton descent (L-BFGS) on the squared threshold losses of `Goal`, projected on what light can be.

    The losses are convex in the projections, which are bounded below by 0: it converges on every target to the best
    that these losses allow.  It starts from clipped filtered projections.  Each step is the two-loop recursion
    (Nocedal 1980) among the rays that are not held at 0 (Bertsekas 1982), halved until the loss falls.  The ramp filter
    stands in for the inverse Hessian to begin with, which it nearly is.  Nothing but sums over arrays is needed, where
    L-BFGS-B (Byrd et al. 1995) spends most of its time on its generalised Cauchy point.

    Parameters
    ----------
    goal, light, state
        As for every method.
    steps
        Quasi-Newton steps in a pass; the memory of curvature begins anew with each pass.
    """
    if state is None:
        clipped = np.maximum(filtered_projections(goal.inside * goal.reach, light), 0)
        now, passes = np.asarray(clipped * _strips_of_use(goal, light), np.float32), 0
        dose = dose_of(now, light)
    else:
        now, passes, dose = state.projections, state.passes, state.dose
    spacing_mm = light.geometry.spacing_mm
    # Such that a first step is as long as one of `object_space`.
    scale = np.float32(light.geometry.voxel_mm**2 / (4 * spacing_mm * light.step_rad))
    ramp = ramp_filter("ram-lak", light.geometry.samples, spacing_mm) * scale
    while True:
        moves: list[tuple[Float32Array, Float32Array]] = []
        for _ in range(steps):
            slope = collect(2 * goal.error_of(dose), light)
            if moves:
                moves[-1] = (moves[-1][0], slope - moves[-1][1])
                moves = [pair for pair in moves if _inner(*pair) > 0][-_MEMORY:]
            free = (now > 0) | (slope < 0)
            found = _lower(goal, light, now, dose, _quasi_newton(slope * free, moves, ramp) * free, slope)
            if found is None:
                break
            moves.append((found[0] - now, slope))
            now, dose = found
        passes += 1
        yield State(passes, now, now, dose)


_MEMORY = 8
_HALVINGS = 20
_LEAST_FALL = 1e-4
"""Pairs of moves remembered, step lengths tried, and what share of the fall that the slope promises is enough."""


def _quasi_newton(
    slope: Float32Array, moves: list[tuple[Float32Array, Float32Array]], ramp: Float32Array
) -> Float32Array:
    """Return minus the inverse Hessian, as the ramp and past moves and changes of slope tell it, times the slope."""
    direction = -slope
    shares = []
    for move, change in reversed(moves):
        shares.append(_inner(move, direction) / _inner(move, change))
        direction = direction - np.float32(shares[-1]) * change
    direction = np.asarray(np.matmul(ramp, direction), np.float32)
    if moves:
        direction *= np.float32(_inner(*moves[-1]) / _inner(moves[-1][1], np.matmul(ramp, moves[-1][1])))
    for (move, change), share in zip(moves, reversed(shares), strict=True):
        direction = direction + np.float32(share - _inner(change, direction) / _inner(move, change)) * move
    return direction


def _lower(
    goal: Goal, light: Light, now: Float32Array, dose: Float32Array, direction: Float32Array, slope: Float32Array
) -> tuple[Float32Array, Float32Array] | None:
    """Return projections along a direction, clipped at 0, whose loss is enough lower, with their dose."""
    cost, length = goal.cost_of(dose), np.float32(1)
    for _ in range(_HALVINGS):
        there = np.maximum(now + length * direction, 0)
        dose_there = dose_of(there, light)
        if goal.cost_of(dose_there) < cost + _LEAST_FALL * _inner(slope, there - now):
            return there, dose_there
        length *= np.float32(0.5)
    return None


def _inner(first: Float32Array, second: Float32Array) -> float:
    return float(np.einsum("asz,asz->", first, second, dtype=np.float64))
