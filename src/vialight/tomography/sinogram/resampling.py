"""Reading rays off frames: cubic B-splines along rows, cubic convolution along columns, cubic polynomials in angle."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from vialight.core.arrays import TURN_RAD, BoolArray, Float32Array, FloatArray, IntArray, ParallelBeam
from vialight.core.compiling import FAST_MATH
from vialight.core.config import Camera, Optics
from vialight.optics.viewing import columns_and_directions, rows_and_plan_share
from vialight.tomography.sinogram.turns import check_gaps, nominal_step, sorted_turn

AngleTaps = tuple[np.intp, np.intp, np.intp, np.intp, np.float32, np.float32, np.float32, np.float32, np.float32]

WIDE_GAP_STEPS = 1.75
"""A gap of more nominal steps than this has lost a frame: rays there are taken from the opposite side."""

BRIDGED_GAP_STEPS = 4.5
"""Up to this many steps a ray that no side sees is interpolated across the gap."""

_SPLINE_POLE = np.sqrt(3.0) - 2.0

_SPLINE_REACH = 14
"""Rows until powers of the pole vanish in single precision."""


def resample(
    frames: Float32Array,
    first_row: int,
    angles_rad: FloatArray,
    camera: Camera,
    optics: Optics | None,
    beam: ParallelBeam,
    z_mm: FloatArray,
) -> Float32Array:
    """Read a parallel-beam sinogram off the frames of one turn.

    Parameters
    ----------
    frames
        (frame, row, column) counts above the background, or attenuation.
    first_row
        The image's row that the frames begin with.
    angles_rad
        (frame,) angles of the object, counter-clockwise seen from above.
    camera, optics
        As the rig has them; no optics for data without a vial.
    beam
        The rays wanted.
    z_mm
        (z,) mid-heights wanted: a thin stack, as columns and directions are evaluated at its middle (over 64 slices
        they change by less than 0.002 columns and 0.01 deg in any machine of this kind).

    Returns
    -------
    numpy.ndarray
        (psi, x_v, z) float32: integrals along the rays' plan view; zero for rays that the image does not reach.

    Raises
    ------
    InputError
        Frames are missing over too wide an angle.
    """
    order, angles = sorted_turn(angles_rad)
    check_gaps(angles, half_turn_suffices=optics is None)
    column, direction = columns_and_directions(beam.virtual_x_mm, float(z_mm.mean()), camera, optics)
    rows, plan_share = rows_and_plan_share(frames.shape[2], z_mm, camera, optics)
    if frames.shape[1] == 1:
        frames = np.repeat(frames, 2, axis=1)
    taps, weights = row_taps(rows - first_row, plan_share, frames.shape[1])
    # NumPy's memory comes in large pages, numba's does not.
    by_column = np.empty((frames.shape[2], len(order), len(z_mm)), np.float32)
    _read_rows(frames, order, taps, weights, by_column)
    step = nominal_step(angles)
    out = np.zeros((len(beam.psi_rad), len(column), len(z_mm)), np.float32)
    gap_steps = np.zeros(out.shape[:2], np.float32)
    _read_columns_and_angles(by_column, column, direction, angles, step, beam.psi_rad, out, gap_steps)
    _fill_from_opposite(out, gap_steps)
    return out


def _fill_from_opposite(sinogram: Float32Array, gap_steps: Float32Array) -> None:
    """Take rays that a gap has lost from the opposite side, where (psi + pi, -x_v) is the same ray."""
    half = len(sinogram) // 2
    opposite_gap = np.roll(gap_steps, -half, axis=0)[:, ::-1]
    lost = gap_steps > WIDE_GAP_STEPS
    psi, x = np.nonzero(lost & (opposite_gap <= WIDE_GAP_STEPS))
    sinogram[psi, x] = sinogram[(psi + half) % len(sinogram), sinogram.shape[1] - 1 - x]
    unseen: BoolArray = lost & (opposite_gap > BRIDGED_GAP_STEPS) & (gap_steps > BRIDGED_GAP_STEPS)
    sinogram[unseen] = 0


@njit(inline="always")
def cubic_convolution(t: float) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Weights of samples -1, 0, 1, 2 at 0 <= t < 1 (Keys 1981, a = -1/2)."""
    return (
        np.float32(((-0.5 * t + 1.0) * t - 0.5) * t),
        np.float32((1.5 * t - 2.5) * t * t + 1.0),
        np.float32(((-1.5 * t + 2.0) * t + 0.5) * t),
        np.float32((0.5 * t - 0.5) * t * t),
    )


def row_taps(rows: FloatArray, share: FloatArray, height: int) -> tuple[NDArray[np.int32], Float32Array]:
    """Return (column, z, 4) rows and weights of the cubic B-spline through an image's column.

    Beyond the end rows, of which there are two at least, the image goes on as it ends; splines are mirrored there.
    """
    position = np.clip(rows, 0.0, height - 1.0)
    floor = np.minimum(position.astype(np.int32), height - 2)
    t = position - floor
    u = 1 - t
    weights = np.stack([u**3 / 6, (3 * t - 6) * t * t / 6 + 4 / 6, (3 * u - 6) * u * u / 6 + 4 / 6, t**3 / 6], axis=-1)
    taps = np.stack([np.abs(floor - 1), floor, floor + 1, np.minimum(floor + 2, 2 * height - 4 - floor)], axis=-1)
    return taps.astype(np.int32), (weights * share[..., None]).astype(np.float32)


@njit(inline="always", cache=True)  # `streaming` calls it by itself, too
def spline_coefficients(frame: Float32Array) -> None:
    """Turn samples along rows into cubic B-spline coefficients in place, mirrored at the ends (Unser 1999, box 2)."""
    height, columns = frame.shape
    pole, period = np.float32(_SPLINE_POLE), 2 * (height - 1)
    first = np.zeros(columns, np.float32)
    for k in range(_SPLINE_REACH):
        weight = np.float32(_SPLINE_POLE**k)
        mirrored = min(k % period, period - k % period)
        for c in range(columns):
            first[c] += weight * frame[mirrored, c]
    frame[0] = first
    for r in range(1, height):
        for c in range(columns):
            frame[r, c] += pole * frame[r - 1, c]
    for c in range(columns):
        frame[height - 1, c] = (frame[height - 1, c] + pole * frame[height - 2, c]) / (1 - pole * pole)
    for r in range(height - 2, -1, -1):
        for c in range(columns):
            frame[r, c] += pole * frame[r + 1, c]
    for r in range(height):
        for c in range(columns):
            frame[r, c] *= (1 - pole) * (1 - pole)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _read_rows(
    frames: Float32Array, order: IntArray, taps: NDArray[np.int32], weights: Float32Array, out: Float32Array
) -> None:
    """(frame, row, column) -> (column, frame, z): each column at the rows that see the heights."""
    columns, depth, _ = taps.shape
    for f in prange(len(order)):
        coefficients = frames[order[f]].copy()
        spline_coefficients(coefficients)
        for c in range(columns):
            for z in range(depth):
                total = weights[c, z, 0] * coefficients[taps[c, z, 0], c]
                total += weights[c, z, 1] * coefficients[taps[c, z, 1], c]
                total += weights[c, z, 2] * coefficients[taps[c, z, 2], c]
                total += weights[c, z, 3] * coefficients[taps[c, z, 3], c]
                out[c, f, z] = total


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _read_columns_and_angles(
    by_column: Float32Array,
    column: FloatArray,
    direction: FloatArray,
    angles: FloatArray,
    step: float,
    psi_rad: FloatArray,
    out: Float32Array,
    gap_steps: Float32Array,
) -> None:
    columns, count, depth = by_column.shape
    for x in prange(len(column)):
        position = column[x]
        if not -0.5 <= position <= columns - 0.5:  # NaN too
            gap_steps[:, x] = np.inf
            continue
        position = min(max(position, 0.0), columns - 1.0)
        floor = min(int(position), columns - 2)
        w0, w1, w2, w3 = cubic_convolution(position - floor)
        before, after = max(floor - 1, 0), min(floor + 2, columns - 1)
        views = np.empty((count, depth), np.float32)
        for f in range(count):
            for z in range(depth):
                views[f, z] = (
                    w0 * by_column[before, f, z]
                    + w1 * by_column[floor, f, z]
                    + w2 * by_column[floor + 1, f, z]
                    + w3 * by_column[after, f, z]
                )
        for p in range(len(psi_rad)):
            i0, i1, i2, i3, a0, a1, a2, a3, gap = _angle_taps(psi_rad[p] - direction[x], angles, step)
            gap_steps[p, x] = gap
            for z in range(depth):
                out[p, x, z] = a0 * views[i0, z] + a1 * views[i1, z] + a2 * views[i2, z] + a3 * views[i3, z]


@njit(inline="always")
def _angle_taps(theta: float, angles: FloatArray, step: float) -> AngleTaps:
    """Return four frames about a stage angle, their weights, and the width in steps of the gap that it falls in."""
    count = len(angles)
    theta = theta % TURN_RAD
    i1 = np.searchsorted(angles, theta, side="right") - 1
    i1, i2 = i1 % count, (i1 + 1) % count
    i0, i3 = (i1 - 1) % count, (i2 + 1) % count
    # Positions relative to theta, so that the turn's end needs no case of its own.
    t1, t2 = -((theta - angles[i1]) % TURN_RAD), (angles[i2] - theta) % TURN_RAD
    t0, t3 = t1 - (angles[i1] - angles[i0]) % TURN_RAD, t2 + (angles[i3] - angles[i2]) % TURN_RAD
    return i0, i1, i2, i3, *angle_weights(t0, t1, t2, t3, step)


@njit(inline="always")
def angle_weights(
    t0: float, t1: float, t2: float, t3: float, step: float
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Return the weights of four frames, at angles relative to the one wanted, and the gap's width in steps.

    Cubic where all three gaps are narrow, linear where a neighbouring one is wide; within half a step of a frame a wide
    gap does not count, and that frame stands alone.
    """
    gap = (t2 - t1) / step
    if gap > WIDE_GAP_STEPS and min(-t1, t2) <= 0.5 * step:
        near = np.float32(1) if -t1 <= t2 else np.float32(0)
        return np.float32(0), near, np.float32(1) - near, np.float32(0), np.float32(1)
    if max(gap, (t1 - t0) / step, (t3 - t2) / step) > WIDE_GAP_STEPS:
        weight = np.float32(-t1 / (t2 - t1))
        return np.float32(0), np.float32(1) - weight, weight, np.float32(0), np.float32(gap)
    a0 = np.float32(-t1 * t2 * t3 / ((t0 - t1) * (t0 - t2) * (t0 - t3)))
    a1 = np.float32(-t0 * t2 * t3 / ((t1 - t0) * (t1 - t2) * (t1 - t3)))
    a2 = np.float32(-t0 * t1 * t3 / ((t2 - t0) * (t2 - t1) * (t2 - t3)))
    a3 = np.float32(-t0 * t1 * t2 / ((t3 - t0) * (t3 - t1) * (t3 - t2)))
    return a0, a1, a2, a3, np.float32(gap)
