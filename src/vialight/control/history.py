"""What the live volume has shown so far: when the density at each place passed the gelation threshold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.control.stop_model import StopModel
from vialight.core.arrays import BoolArray, Float32Array, FloatArray, Grid, IntArray
from vialight.core.errors import InputError

_SAMPLES_A_SIDE = (2, 3)
"""Least and most along each side of a place: two find the mean of the voxels that a place lies between."""


@dataclass(frozen=True)
class StopHistory:
    """What has been seen of the places that a model watches.

    Parameters
    ----------
    lit_s
        Lit time of the newest frame seen; NaN before the first.
    density
        (place,) as it was then, counts per mm.
    crossing_s
        (place,) lit time at which the density last rose through the threshold; NaN where it is below.
    """

    lit_s: float
    density: FloatArray
    crossing_s: FloatArray


def fresh_history(model: StopModel) -> StopHistory:
    """Return the history of a print that has not begun."""
    nothing = np.full(len(model.points_mm), np.nan)
    return StopHistory(float("nan"), nothing, nothing)


def places(model: StopModel, grid: Grid) -> IntArray:
    """Return (axis, place, sample) indices of the voxels of a live volume (z, y, x) that make up each place.

    Computed once before the print, used by `sample` with every snapshot.

    Raises
    ------
    InputError
        A place lies outside the grid.
    """
    count = int(np.clip(round(2 * model.size_mm / grid.voxel_mm), *_SAMPLES_A_SIDE))
    spread = (np.arange(count) - (count - 1) / 2) * (model.size_mm / count)
    offsets = np.stack([axis.ravel() for axis in np.meshgrid(spread, spread, spread, indexing="ij")], axis=1)
    at = (model.points_mm[:, None] + offsets)[..., ::-1]
    index = np.rint((at - np.array(grid.origin_mm)) / grid.voxel_mm).astype(np.int64)
    inside: BoolArray = ((index >= 0) & (index < np.array(grid.shape))).all(axis=-1)
    if not inside.any(axis=1).all():
        raise InputError(
            "stop model", f"watches {int((~inside.any(axis=1)).sum())} places that the camera does not see",
            accepted="a part within the camera's field", remedy="check rig and plan, or use --stop manual",
        )  # fmt: skip
    return np.ascontiguousarray(np.moveaxis(np.clip(index, 0, np.array(grid.shape) - 1), -1, 0))


def sample(density: Float32Array, indices: IntArray) -> FloatArray:
    """Return (place,) the mean density of each place; `indices` are those of `places` for the volume's grid."""
    z, y, x = indices
    return np.asarray(density[z, y, x].mean(axis=1, dtype=np.float64))


def observe(history: StopHistory, density: FloatArray, lit_s: float, threshold: float) -> StopHistory:
    """Add what a renewal of the live volume shows.

    Parameters
    ----------
    history
        So far.
    density
        (place,) of `sample`.
    lit_s
        Lit time of the newest frame in the volume; renewals that are not later than the last are left out.
    threshold
        I_p, counts per mm, of the live volume's pixels.

    Examples
    --------
    >>> before = StopHistory(10.0, np.array([0.0, 40.0]), np.full(2, np.nan))
    >>> observe(before, np.array([20.0, 80.0]), 12.0, 60.0).crossing_s
    array([nan, 11.])
    """
    if lit_s <= history.lit_s:
        return history
    above = density >= threshold
    rose = above & ~(history.density >= threshold)
    rise = np.maximum(density - history.density, 1e-12)
    share = np.nan_to_num(np.clip((density - threshold) / rise, 0, 1))
    since = lit_s - share * (lit_s - history.lit_s if np.isfinite(history.lit_s) else 0.0)
    crossing = np.where(above, np.where(rose, since, history.crossing_s), np.nan)
    return StopHistory(lit_s, density, crossing)
