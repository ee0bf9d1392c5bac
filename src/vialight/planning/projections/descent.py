"""Quasi-Newton descent on threshold losses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.planning.projections.forward import Light, collect, dose_of, filtered_projections
from vialight.planning.projections.goals import Goal, State, make_light, strips_of_use
from vialight.tomography.radon import filter_rays, ramp_filter


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
        now, passes = filtered_projections(goal.inside * goal.reach, light), 0
        make_light(now, strips_of_use(goal, light))
        dose = dose_of(now, light)
    else:
        now, passes, dose = state.projections, state.passes, state.dose
    spacing_mm = light.geometry.spacing_mm
    # Such that a first step is as long as one of `object_space`.
    scale = np.float32(light.geometry.voxel_mm**2 / (4 * spacing_mm * light.step_rad))
    ramp = ramp_filter("ram-lak", light.geometry.samples, spacing_mm) * scale
    while True:
        moves: list[Float32Array] = []
        changes: list[Float32Array] = []
        last: tuple[Float32Array, Float32Array] | None = None
        for _ in range(steps):
            slope = _slope(goal, light, dose)
            if last is not None:
                move, change = last[0], slope - last[1]
                if _inner(move, change) > 0:
                    moves, changes = [*moves, move][-_MEMORY:], [*changes, change][-_MEMORY:]
            direction = _quasi_newton(_freed(slope, now, slope), moves, changes, ramp)
            found = _lower(goal, light, now, dose, _freed(direction, now, slope), slope)
            if found is None:
                break
            last = found[0] - now, slope
            now, dose = found
        passes += 1
        yield State(passes, now, now, dose)


_MEMORY = 8
_HALVINGS = 20
_LEAST_FALL = 1e-4
"""Pairs of moves remembered, step lengths tried, and what share of the fall that the slope promises is enough."""


def _slope(goal: Goal, light: Light, dose: Float32Array) -> Float32Array:
    """Return by how much the cost rises with each ray, given the dose."""
    error = goal.error_of(dose)
    error *= 2
    return collect(error, light)


def _quasi_newton(
    slope: Float32Array, moves: list[Float32Array], changes: list[Float32Array], ramp: Float32Array
) -> Float32Array:
    """Return minus the inverse Hessian, as the ramp and past moves and changes of slope tell it, times the slope."""
    direction = -slope
    shares = []
    curvatures = [_inner(move, change) for move, change in zip(moves, changes, strict=True)]
    for move, change, curvature in reversed([*zip(moves, changes, curvatures, strict=True)]):
        shares.append(_inner(move, direction) / curvature)
        _add(direction, -shares[-1], change)
    direction = filter_rays(ramp, direction)
    if moves:
        direction *= np.float32(curvatures[-1] / _inner(changes[-1], filter_rays(ramp, changes[-1])))
    for move, change, curvature, share in zip(moves, changes, curvatures, reversed(shares), strict=True):
        _add(direction, share - _inner(change, direction) / curvature, move)
    return direction


def _lower(
    goal: Goal, light: Light, now: Float32Array, dose: Float32Array, direction: Float32Array, slope: Float32Array
) -> tuple[Float32Array, Float32Array] | None:
    """Return projections along a direction, clipped at 0, whose loss is enough lower, with their dose."""
    cost, length = goal.cost_of(dose), 1.0
    for _ in range(_HALVINGS):
        there = now.copy()
        _add(there, length, direction)
        np.maximum(there, 0, out=there)
        dose_there = dose_of(there, light)
        if goal.cost_of(dose_there) < cost + _LEAST_FALL * _inner(slope, there - now):
            return there, dose_there
        length *= 0.5
    return None


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _freed(values: Float32Array, now: Float32Array, slope: Float32Array) -> Float32Array:
    """Return values, 0 for rays that are held at 0."""
    zero, out = np.float32(0), np.empty_like(values)
    for a in prange(values.shape[0]):
        for i in range(values.shape[1]):
            for z in range(values.shape[2]):
                free = now[a, i, z] > zero or slope[a, i, z] < zero
                out[a, i, z] = values[a, i, z] if free else zero
    return out


def _add(values: Float32Array, share: float, more: Float32Array) -> None:
    """Add a share of an array to another, in place."""
    _add_rows(values, np.float32(share), more)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _add_rows(values: Float32Array, share: np.float32, more: Float32Array) -> None:
    for a in prange(values.shape[0]):
        for i in range(values.shape[1]):
            for z in range(values.shape[2]):
                values[a, i, z] += share * more[a, i, z]


def _inner(first: Float32Array, second: Float32Array) -> float:
    rows = np.empty(len(first), np.float64)
    _inner_rows(first, second, rows)
    return float(rows.sum())


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _inner_rows(first: Float32Array, second: Float32Array, rows: FloatArray) -> None:
    for a in prange(first.shape[0]):
        row = np.float64(0)
        for i in range(first.shape[1]):
            strip = np.float32(0)
            for z in range(first.shape[2]):
                strip += first[a, i, z] * second[a, i, z]
            row += strip
        rows[a] = row
