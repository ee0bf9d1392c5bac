"""Methods that compute projections for a target, behind one interface: an iterator of states.

Every method yields a `State` after each pass, so that whoever runs it can show progress, stop at any pass with the best
so far, keep a state and go on from it later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array
from vialight.core.compiling import FAST_MATH
from vialight.planning.projections.forward import Light, dose_of, filtered_projections
from vialight.planning.projections.goals import Goal, State, make_light, strips_of_use

MethodName = Literal["object-space", "osmo", "gradient", "normalised"]

CEILING = 0.3
"""Light that `object_space` allows, in that of the brightest ray of filtered backprojection, by default."""


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
    floor = (background if clip_level is None else clip_level) / (2 * np.pi)
    first = np.where(goal.inside >= 0.5, 1, background).astype(np.float32) * goal.reach
    model, passes = (first, 0) if state is None else (state.model, state.passes)
    while True:
        projections = filtered_projections(model, light)
        make_light(projections, np.ones(light.geometry.samples, np.float32), floor)
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
    useful = strips_of_use(goal, light)
    model, passes = ((goal.inside >= 0.5).astype(np.float32), 0) if state is None else (state.model, state.passes)
    _, dose = _clipped(model, light, useful)
    while True:
        model = model.copy()
        _raise_part(model, goal.inside, dose, np.float32(high), _largest(dose))
        _, dose = _clipped(model, light, useful)
        _lower_void(model, goal.inside, goal.reach, dose, np.float32(low), _largest(dose))
        projections, dose = _clipped(model, light, useful)
        passes += 1
        # In units where the part's threshold is 1.
        scale = 1 / (np.float32(high) * _largest(dose))
        yield State(passes, model, projections * scale, dose * scale)


def _clipped(model: Float32Array, light: Light, useful: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the model's filtered projections, clipped, and their dose."""
    projections = filtered_projections(model, light)
    make_light(projections, useful)
    return projections, dose_of(projections, light)


def _largest(dose: Float32Array) -> np.float32:
    return np.float32(max(float(dose.max()), 1e-12))


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _raise_part(
    model: Float32Array, inside: Float32Array, dose: Float32Array, level: np.float32, largest: np.float32
) -> None:
    """Raise a model where the part's dose, as a share of the largest, is below a level, by how much it is."""
    zero, scale = np.float32(0), np.float32(1) / largest
    for y in prange(model.shape[0]):
        for x in range(model.shape[1]):
            for z in range(model.shape[2]):
                short = max(level - scale * dose[y, x, z], zero)
                model[y, x, z] += short if inside[y, x, z] >= np.float32(0.5) else zero


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _lower_void(
    model: Float32Array, inside: Float32Array, reach: Float32Array, dose: Float32Array, level: np.float32,
    largest: np.float32,
) -> None:  # fmt: skip
    """Lower a model where the void's dose is above a level."""
    zero, scale = np.float32(0), np.float32(1) / largest
    for y in prange(model.shape[0]):
        for x in range(model.shape[1]):
            for z in range(model.shape[2]):
                above = reach[y, x, 0] * max(scale * dose[y, x, z] - level, zero)
                model[y, x, z] -= zero if inside[y, x, z] >= np.float32(0.5) else above


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
    step, useful = step / _gain(light), strips_of_use(goal, light)
    top = np.inf if ceiling >= 1 else _ceiling(filtered_projections(start, light) * useful[:, None], ceiling)
    while True:
        latest, before = models
        pushed = latest - before
        pushed *= np.float32(max(passes - 1, 0) / (passes + 2))
        pushed += latest
        projections = filtered_projections(pushed, light)
        make_light(projections, useful, 0, top)
        dose = dose_of(projections, light)
        passes += 1
        change = _blurred(goal.error_of(dose), light)
        change *= np.float32(step)
        models = np.empty((2, *latest.shape), np.float32)
        np.subtract(pushed, change, out=models[0])
        models[1] = latest
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
