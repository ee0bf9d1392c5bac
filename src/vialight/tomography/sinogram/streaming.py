"""A sinogram that is renewed frame by frame, with the weights that `resample` gives a whole turn.

A frame is read once, along the rays that it sees (`read_view`); then every ray of which it is one of the four frames
next to its stage angle is interpolated anew (`renew_rays`).  Arrays have z innermost, in blocks of slices that share
columns and directions, as in `resample`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vialight.core.arrays import TURN_RAD, Float32Array, FloatArray, IntArray, ParallelBeam
from vialight.core.compiling import FAST_MATH
from vialight.core.config import Camera, Optics
from vialight.optics.viewing import columns_and_directions, rows_and_plan_share
from vialight.tomography.sinogram.resampling import (
    BRIDGED_GAP_STEPS,
    WIDE_GAP_STEPS,
    angle_weights,
    cubic_convolution,
    row_taps,
    spline_coefficients,
)

NEVER, LOST, BRIDGED, SEEN = 0, 1, 2, 3
"""What is known of a ray: nothing; an older turn's value; one across a gap of missing frames; one from near frames."""

NEIGHBOURS = 7
"""Frames that `renew_rays` is told of: the new one in the middle and three on either side."""

StateArray = NDArray[np.uint8]


@dataclass(frozen=True)
class RayTaps:
    """Where in a frame rays are seen.

    Parameters
    ----------
    rows, row_weights
        (column, z, 4) rows to read, and their weights.
    columns, directions_rad
        (block, x_v) fractional column and gamma of each ray; NaN where none is seen.
    block
        Slices that share columns and directions.
    """

    rows: NDArray[np.int32]
    row_weights: Float32Array
    columns: FloatArray
    directions_rad: FloatArray
    block: int


def ray_taps(
    shape: tuple[int, int], camera: Camera, optics: Optics | None, beam: ParallelBeam, z_mm: FloatArray, block: int
) -> RayTaps:
    """Find where rays are seen.

    Parameters
    ----------
    shape
        (rows, columns) of a frame.
    camera, optics
        As the rig has them; no optics for data without a vial.
    beam
        The rays wanted.
    z_mm
        (z,) mid-heights wanted, ascending.
    block
        Slices that share columns and directions: a thin stack, see `resample`.
    """
    rows, weights, columns, directions = [], [], [], []
    for start in range(0, len(z_mm), block):
        heights = z_mm[start : start + block]
        column, direction = columns_and_directions(beam.virtual_x_mm, float(heights.mean()), camera, optics)
        seen = (column >= -0.5) & (column <= shape[1] - 0.5)
        columns.append(np.where(seen, column, np.nan))
        directions.append(np.where(seen, direction, np.nan))
        row, plan_share = rows_and_plan_share(shape[1], heights, camera, optics)
        at, weight = row_taps(row, plan_share, max(shape[0], 2))
        rows.append(np.minimum(at, shape[0] - 1))
        weights.append(weight)
    return RayTaps(
        np.concatenate(rows, axis=1),
        np.concatenate(weights, axis=1),
        np.stack(columns),
        np.stack(directions),
        block,
    )


def read_view(frame: Float32Array, taps: RayTaps, view: Float32Array) -> None:
    """Read a frame along the rays that it sees.

    Parameters
    ----------
    frame
        (row, column) counts above the background; overwritten.
    taps
        See `ray_taps`.
    view
        (x_v, z or more) float32, written; rays that the frame does not reach stay as they are.
    """
    if len(frame) > 1:
        spline_coefficients(frame)
    _read_view(frame, taps.rows, taps.row_weights, taps.columns, taps.block, view)


@njit(nogil=True, fastmath=FAST_MATH, cache=True)
def _read_view(
    coefficients: Float32Array,
    rows: NDArray[np.int32],
    weights: Float32Array,
    column: FloatArray,
    block: int,
    view: Float32Array,
) -> None:
    columns, depth, _ = rows.shape
    by_column = np.empty((columns, depth), np.float32)
    for c in range(columns):
        along = coefficients[:, c].copy()
        for z in range(depth):
            total = weights[c, z, 0] * along[rows[c, z, 0]]
            total += weights[c, z, 1] * along[rows[c, z, 1]]
            total += weights[c, z, 2] * along[rows[c, z, 2]]
            total += weights[c, z, 3] * along[rows[c, z, 3]]
            by_column[c, z] = total
    for x in range(column.shape[1]):
        for b in range(len(column)):
            if np.isnan(column[b, x]):
                continue
            position = min(max(column[b, x], 0.0), columns - 1.0)
            floor = min(int(position), columns - 2)
            w0, w1, w2, w3 = cubic_convolution(position - floor)
            before, after = max(floor - 1, 0), min(floor + 2, columns - 1)
            for z in range(b * block, min((b + 1) * block, depth)):
                view[x, z] = (
                    w0 * by_column[before, z]
                    + w1 * by_column[floor, z]
                    + w2 * by_column[floor + 1, z]
                    + w3 * by_column[after, z]
                )


@njit(nogil=True, fastmath=FAST_MATH, cache=True)
def renew_rays(
    sinogram: Float32Array,
    states: StateArray,
    touched: StateArray,
    views: Float32Array,
    directions: FloatArray,
    block: int,
    angle: float,
    offsets: FloatArray,
    slots: IntArray,
    step: float,
) -> None:
    """Interpolate every ray anew that a new frame changes.

    Parameters
    ----------
    sinogram
        (psi, x_v, z) float32, changed; psi is evenly spaced over the turn and begins at 0.
    states
        (block, psi, x_v) what is known of each ray, changed.
    touched
        (psi,) set to 1 for angles of which a ray has changed.
    views
        (slot, x_v, z) frames as `read_view` has them.
    directions, block
        Of `RayTaps`.
    angle
        Stage angle of the new frame.
    offsets, slots
        (`NEIGHBOURS`,) angles relative to the new frame's and slots of it and of the frames about it on the circle.
    step
        Nominal step between frames.
    """
    count, depth = len(sinogram), sinogram.shape[2]
    spacing = TURN_RAD / count
    for x in range(sinogram.shape[1]):
        for b in range(len(directions)):
            direction = directions[b, x]
            if np.isnan(direction):
                continue
            first = int(np.ceil((angle + offsets[1] + direction) / spacing))
            last = int(np.floor((angle + offsets[5] + direction) / spacing))
            for n in range(first, last + 1):
                k = n % count
                position = n * spacing - direction - angle
                j = 1
                while j < 4 and position >= offsets[j + 1]:
                    j += 1
                t0, t1 = offsets[j - 1] - position, offsets[j] - position
                t2, t3 = offsets[j + 1] - position, offsets[j + 2] - position
                a0, a1, a2, a3, gap = angle_weights(t0, t1, t2, t3, step)
                if gap > BRIDGED_GAP_STEPS:
                    if states[b, k, x] > LOST:
                        states[b, k, x] = LOST
                        touched[k] = 1
                    continue
                state = np.uint8(SEEN if gap <= WIDE_GAP_STEPS else BRIDGED)
                v0, v1 = views[slots[j - 1], x], views[slots[j], x]
                v2, v3 = views[slots[j + 1], x], views[slots[j + 2], x]
                row, change = sinogram[k, x], np.float32(0)
                for z in range(b * block, min((b + 1) * block, depth)):
                    value = a0 * v0[z] + a1 * v1[z] + a2 * v2[z] + a3 * v3[z]
                    change += abs(value - row[z])
                    row[z] = value
                if change > 0 or state != states[b, k, x]:
                    states[b, k, x] = state
                    touched[k] = 1


@njit(nogil=True, fastmath=FAST_MATH, cache=True)
def fold_changes(
    sinogram: Float32Array,
    states: StateArray,
    block: int,
    held: Float32Array,
    rows: IntArray,
    changes: Float32Array,
) -> None:
    """Fold opposite angles, ``q(psi, s) = p(psi, s) + p(psi + pi, -s)``, and say what is new since the last time.

    Of a ray and its opposite, the one that is known better stands for both, as where `resample` fills gaps.

    Parameters
    ----------
    sinogram, states, block
        As for `renew_rays`.
    held
        (psi / 2, x_v, z) the folded sinogram as it was; set to what it is.
    rows
        (n,) angles of the first half turn to fold.
    changes
        (n, x_v or more, z) float32, written: folded now less folded then.
    """
    half, samples, depth = held.shape
    for x in range(samples):
        opposite = samples - 1 - x
        for i in range(len(rows)):
            k = rows[i]
            for b in range(len(states)):
                here, there = states[b, k, x], states[b, k + half, opposite]
                v = np.float32(1 if here == there else 2 if here > there else 0)
                w = np.float32(2) - v
                one, other = sinogram[k, x], sinogram[k + half, opposite]
                kept, change = held[k, x], changes[i, x]
                for z in range(b * block, min((b + 1) * block, depth)):
                    folded = v * one[z] + w * other[z]
                    change[z] = folded - kept[z]
                    kept[z] = folded
