"""The kernel of `opposite_views`: frames compared with their opposite views, ray by ray."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.core.arrays import TURN_RAD, Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.optics.run_out import really_seen

AXIS, TILT, OUT_X, OUT_Y, DRIFT = range(5)
"""Places in the vector of parameters: column, rad, mm, mm, share a turn; what changes gamma alone follows."""

_NEAR = 8
"""Frames that are smoothed over."""

_Four = tuple[float, float, float, float]

Sample = tuple[float, float, float, float, float]


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def add_up(
    coefficients: Float32Array, angles: FloatArray, time: FloatArray, x_c: FloatArray, z_c: FloatArray,
    gamma: FloatArray, slopes: FloatArray, climb: FloatArray, parameters: FloatArray, camera: FloatArray,
    normal: FloatArray, gradient: FloatArray, differences: Float32Array, by_angle: Float32Array, weights: Float32Array,
) -> None:  # fmt: skip
    """Compare every ray with its opposite, and add up what says how parameters must change.

    Parameters
    ----------
    coefficients
        (frame, row, column) cubic B-spline coefficients along rows and columns, sorted by angle.
    angles, time
        (frame,) ascending in [0, 2 pi), counter-clockwise; place in the turn by time, -1/2 to 1/2.
    x_c, z_c
        (x,) positive and (z,) places in the axis plane.
    gamma, slopes
        (x, z) directions of the rays, (k, x, z) their derivatives by further parameters.
    climb
        (x, z) by how many rows a ray's and its opposite's heights differ, RMS, over what noise there is: the inverse
        of a count.
    parameters
        (5 + k,), see `AXIS` and so on; the further ones are not read.
    camera
        pixel_mm, optical_row, distance_mm.
    normal, gradient
        (z, 5 + k, 5 + k), (z, frame, 5 + k), added to: J'J and J'r.
    differences, by_angle
        (frame, x, z), (2, frame, x, z), written: each ray less its opposite, NaN where one is not seen, and the
        derivatives of the two by the stage's angle.
    weights
        (frame, x, z), written: of each difference, 1 where heights do not matter.
    """
    frames, further = len(angles), len(slopes)
    count = 5 + further
    for k in prange(len(z_c)):
        here, there, row = np.empty(count), np.empty(count), np.empty(count)
        for f in range(frames):
            for i in range(len(x_c)):
                theta = angles[f]
                one = _look(coefficients, angles, time, theta, x_c[i], z_c[k], parameters, camera, here)
                out_x, out_y = parameters[OUT_X], parameters[OUT_Y]
                aside = (out_x * np.cos(theta) - out_y * np.sin(theta)) / camera[2]
                opposite = theta + 2 * gamma[i, k] + np.pi
                aside -= (out_x * np.cos(opposite) - out_y * np.sin(opposite)) / camera[2]
                other = _look(coefficients, angles, time, opposite + aside, -x_c[i], z_c[k], parameters, camera, there)
                difference = one[0] - other[0]
                differences[f, i, k] = difference
                by_angle[0, f, i, k], by_angle[1, f, i, k] = one[1], other[1]
                weights[f, i, k] = 0.0
                if np.isnan(difference):
                    continue
                weight = 1 / (1 + ((one[2] + other[2]) / 2 * climb[i, k]) ** 2)
                weights[f, i, k] = weight
                for p in range(5):
                    row[p] = here[p] - there[p]
                # What bends rays bends the one to the right as much as its opposite to the left.
                row[OUT_X] -= other[1] * (np.cos(theta) - np.cos(opposite)) / camera[2]
                row[OUT_Y] += other[1] * (np.sin(theta) - np.sin(opposite)) / camera[2]
                for p in range(further):
                    row[5 + p] = -2 * other[1] * slopes[p, i, k]
                for p in range(count):
                    gradient[k, f, p] += weight * row[p] * difference
                    for q in range(count):
                        normal[k, p, q] += weight * row[p] * row[q]


@njit(fastmath=FAST_MATH, cache=True)
def _look(
    coefficients: Float32Array, angles: FloatArray, time: FloatArray, theta: float, x_c: float, z_c: float,
    parameters: FloatArray, camera: FloatArray, by: FloatArray,
) -> Sample:  # fmt: skip
    """Read a ray at a stage angle, and its derivatives: by each parameter into `by`, by angle, row and column."""
    pixel, optical_row, distance = camera
    cosine, sine = np.cos(theta), np.sin(theta)
    x, z = really_seen(x_c, z_c, cosine, sine, parameters[OUT_X], parameters[OUT_Y], parameters[TILT], distance)
    column, row = parameters[AXIS] + x / pixel, optical_row - z / pixel
    spread = 1 + (x_c / distance) ** 2
    value, by_angle, by_row, by_column, by_gain = _read(
        coefficients, angles, time, parameters[DRIFT], theta, row, column
    )
    by[AXIS] = by_column
    by[TILT] = (by_column * z + by_row * x) / pixel
    by[OUT_X] = by_column * (cosine * spread - x_c * sine / distance) / pixel
    by[OUT_Y] = by_column * (-sine * spread - x_c * cosine / distance) / pixel
    by[DRIFT] = by_gain
    return value, by_angle, by_row, by_column, by_gain


@njit(fastmath=FAST_MATH, cache=True)
def _read(
    coefficients: Float32Array, angles: FloatArray, time: FloatArray, drift: float, theta: float, row: float,
    column: float,
) -> Sample:  # fmt: skip
    """Interpolate frames: cubic B-splines along rows and columns, the cubic through four frames in angle."""
    frames, rows, columns = coefficients.shape
    if not (1 <= row <= rows - 3 and 1 <= column <= columns - 3):
        return np.nan, np.nan, np.nan, np.nan, np.nan
    r, c = int(row), int(column)
    w, dw = _spline(row - r)
    v, dv = _spline(column - c)
    near = _frames_near(angles, theta)
    weights, changes = _lagrange(near)
    value, by_angle, by_row, by_column, by_gain = 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(4):
        frame = (near[0] + m) % frames
        plain, along_rows, along_columns = 0.0, 0.0, 0.0
        for a in range(4):
            line, slope = 0.0, 0.0
            for b in range(4):
                sample = coefficients[frame, r + a - 1, c + b - 1]
                line += v[b] * sample
                slope += dv[b] * sample
            plain += w[a] * line
            along_rows += dw[a] * line
            along_columns += w[a] * slope
        weight, gain = weights[m], 1 / (1 + drift * time[frame])
        value += weight * gain * plain
        by_angle += changes[m] * gain * plain
        by_row += weight * gain * along_rows
        by_column += weight * gain * along_columns
        by_gain -= weight * gain * gain * time[frame] * plain
    return value, by_angle, by_row, by_column, by_gain


@njit(fastmath=FAST_MATH, cache=True)
def _frames_near(angles: FloatArray, theta: float) -> tuple[int, float, float, float, float]:
    """Return the first of the four frames about an angle, and the angles of all four from there."""
    frames = len(angles)
    first = int((np.searchsorted(angles, theta % TURN_RAD, side="right") - 2) % frames)
    t0 = (angles[first] - theta + np.pi) % TURN_RAD - np.pi
    t1 = (angles[(first + 1) % frames] - theta + np.pi) % TURN_RAD - np.pi
    t2 = (angles[(first + 2) % frames] - theta + np.pi) % TURN_RAD - np.pi
    t3 = (angles[(first + 3) % frames] - theta + np.pi) % TURN_RAD - np.pi
    return first, t0, t1, t2, t3


def read_between(frames: Float32Array, angles: FloatArray, at: FloatArray, aside: FloatArray) -> Float32Array:
    """Read each column at angles of its own, smoothed over a frame on either side.

    Parameters
    ----------
    frames
        (frame, row, column), sorted by angle.
    angles
        (frame,) ascending in [0, 2 pi).
    at, aside
        (k,), (column,): column c is read at ``at - aside[c]``.

    Returns
    -------
    numpy.ndarray
        (k, row, column).
    """
    read = np.zeros((len(at), *frames.shape[1:]), np.float32)
    _read_between(frames, angles, at, aside, read)
    return read


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _read_between(
    frames: Float32Array, angles: FloatArray, at: FloatArray, aside: FloatArray, read: Float32Array
) -> None:
    """Weigh the frames about an angle by a Gaussian, and such that what is linear in angle stays."""
    count, width = len(angles), TURN_RAD / len(angles)
    for c in prange(len(aside)):
        apart = np.empty(_NEAR)
        for f in range(len(at)):
            theta = at[f] - aside[c]
            first = int((np.searchsorted(angles, theta % TURN_RAD, side="right") - _NEAR // 2) % count)
            for m in range(_NEAR):
                apart[m] = (angles[(first + m) % count] - theta + np.pi) % TURN_RAD - np.pi
            weight = np.exp((np.min(apart**2) - apart**2) / (2 * width**2))
            weight *= (weight * apart**2).sum() - apart * (weight * apart).sum()
            weight /= weight.sum()
            for m in range(_NEAR):
                for r in range(frames.shape[1]):
                    read[f, r, c] += weight[m] * frames[(first + m) % count, r, c]


@njit(fastmath=FAST_MATH, cache=True)
def _spline(t: float) -> tuple[_Four, _Four]:
    """Return the weights of the cubic B-spline's samples -1, 0, 1, 2 at 0 <= t < 1, and their derivatives."""
    u = 1 - t
    weights = (u**3 / 6, (3 * t - 6) * t * t / 6 + 4 / 6, (3 * u - 6) * u * u / 6 + 4 / 6, t**3 / 6)
    slopes = (-u * u / 2, (1.5 * t - 2) * t, -(1.5 * u - 2) * u, t * t / 2)
    return weights, slopes


@njit(fastmath=FAST_MATH, cache=True)
def _lagrange(near: tuple[int, float, float, float, float]) -> tuple[_Four, _Four]:
    """Return the weights, at 0, of samples at four places, and how they change as the place asked for moves on."""
    _, a, b, c, d = near
    p, q = 1 / ((a - b) * (a - c) * (a - d)), 1 / ((b - a) * (b - c) * (b - d))
    r, s = 1 / ((c - a) * (c - b) * (c - d)), 1 / ((d - a) * (d - b) * (d - c))
    weights = (-b * c * d * p, -a * c * d * q, -a * b * d * r, -a * b * c * s)
    changes = (
        (b * c + b * d + c * d) * p, (a * c + a * d + c * d) * q, (a * b + a * d + b * d) * r,
        (a * b + a * c + b * c) * s,
    )  # fmt: skip
    return weights, changes


@njit(fastmath=FAST_MATH, cache=True)
def add_up_angles(
    differences: Float32Array, by_angle: Float32Array, weights: Float32Array, gamma: FloatArray, angles: FloatArray,
    normal: FloatArray, gradient: FloatArray,
) -> None:  # fmt: skip
    """Add up what says how the angle of every frame must change.

    Parameters
    ----------
    differences, by_angle, weights, gamma, angles
        See `add_up`.
    normal, gradient
        (frame, frame), (z, frame), added to: J'J and J'r.
    """
    frames, columns, depth = differences.shape
    place, row = np.empty(5, np.int64), np.empty(5)
    for f in range(frames):
        for i in range(columns):
            for k in range(depth):
                difference = differences[f, i, k]
                if np.isnan(difference):
                    continue
                near = _frames_near(angles, angles[f] + 2 * gamma[i, k] + np.pi)
                shares, _ = _lagrange(near)
                for m in range(4):
                    place[m] = (near[0] + m) % frames
                    row[m] = -by_angle[1, f, i, k] * shares[m]
                place[4], row[4] = f, by_angle[0, f, i, k]
                for p in range(5):
                    gradient[k, place[p]] += weights[f, i, k] * row[p] * difference
                    for q in range(5):
                        normal[place[p], place[q]] += weights[f, i, k] * row[p] * row[q]
