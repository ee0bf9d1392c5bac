"""What is wanted of the dose, and where a method stands on its way there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.planning.projections.forward import Light

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
        off = np.empty(dose.shape, np.float32)
        _find_error(dose, self.inside, self.reach, np.float32(self.void_limit), off)
        return off

    def cost_of(self, dose: Float32Array) -> float:
        """Return the sum of squares of `error_of`, in voxels."""
        rows = np.empty(len(dose), np.float64)
        _find_cost(dose, self.inside, self.reach, np.float32(self.void_limit), rows)
        return float(rows.sum())


def strips_of_use(goal: Goal, light: Light) -> Float32Array:
    """Return (s,): 1 for strips that can light the part at some angle, 0 for those that only pass beside it.

    Filtered projections have light there too, beside voids that a model has lowered.  It does no good, and what it does
    at the rim, where nothing is judged, no method sees.
    """
    geometry = light.geometry
    radius = np.hypot(geometry.x_mm, geometry.y_mm[:, None])
    lit = (goal.inside.max(axis=2) > 0) & (goal.reach[:, :, 0] > 0)
    farthest = float((radius * lit).max()) + geometry.voxel_mm
    farthest += 2 * math.hypot(light.projector_blur_mm, light.diffusion_mm)
    s_mm = geometry.first_s_mm + np.arange(geometry.samples) * geometry.spacing_mm
    return np.asarray(np.abs(s_mm) <= farthest, dtype=np.float32)


def make_light(filtered: Float32Array, useful: Float32Array, lowest: float = 0.0, highest: float = np.inf) -> None:
    """Bound filtered projections (psi, s, z) to what light can be, in place; strips that are of no use are dark."""
    _bound(filtered, useful, np.float32(lowest), np.float32(highest))


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _bound(filtered: Float32Array, useful: Float32Array, lowest: np.float32, highest: np.float32) -> None:
    for a in prange(filtered.shape[0]):
        for i in range(filtered.shape[1]):
            for z in range(filtered.shape[2]):
                filtered[a, i, z] = useful[i] * min(max(filtered[a, i, z], lowest), highest)


@njit(inline="always")
def _off(dose: np.float32, inside: np.float32, limit: np.float32) -> np.float32:
    one, zero = np.float32(1), np.float32(0)
    return dose - one if inside >= np.float32(0.5) else max(dose - limit, zero)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _find_error(
    dose: Float32Array, inside: Float32Array, reach: Float32Array, limit: np.float32, off: Float32Array
) -> None:
    for y in prange(dose.shape[0]):
        for x in range(dose.shape[1]):
            for z in range(dose.shape[2]):
                off[y, x, z] = reach[y, x, 0] * _off(dose[y, x, z], inside[y, x, z], limit)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _find_cost(
    dose: Float32Array, inside: Float32Array, reach: Float32Array, limit: np.float32, rows: FloatArray
) -> None:
    for y in prange(dose.shape[0]):
        row = 0.0
        for x in range(dose.shape[1]):
            column = np.float32(0)
            for z in range(dose.shape[2]):
                off = _off(dose[y, x, z], inside[y, x, z], limit)
                column += off * off
            row += column * reach[y, x, 0]
        rows[y] = row
