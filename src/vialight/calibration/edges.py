"""The vial's edges: streaks of stray light at ``|b| = R``, frame by frame, and the circle on which they go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics

SEARCH_COLUMNS = 6.0
"""How far an edge may lie from where the rig has it."""

LEAST_CONTRAST = 6.0
"""Peak over its own noise from which on an edge shows."""

_WIDEST_COLUMNS = 4.0
_FRAME_PASSES = 8


@dataclass(frozen=True)
class Edges:
    """Where the vial's edges lie.

    Parameters
    ----------
    left, right
        (frame,) fractional columns; NaN where an edge does not show.
    """

    left: FloatArray
    right: FloatArray


@dataclass(frozen=True)
class EdgeCircle:
    """What edges say of the vial as it turns.

    Parameters
    ----------
    left, right
        Columns in the mean.
    run_out_mm, covariance_mm2
        x and y in the object's frame, and their covariance.
    scatter
        Standard deviation of a frame's edge about the circle, columns.
    """

    left: float
    right: float
    run_out_mm: FloatArray
    covariance_mm2: FloatArray
    scatter: float

    @property
    def middle(self) -> float:
        """Column midway between the edges."""
        return (self.left + self.right) / 2


def edge_x_c_mm(optics: Optics) -> float:
    """Return where in the axis plane the ray is seen that touches the vial, ``R / sqrt(1 - (R/D)^2)``.

    Examples
    --------
    >>> round(edge_x_c_mm(Optics(12.4, 11.3, 1.472, 1.48, 190.0)), 4)
    12.4265
    """
    return float(optics.outer_radius_mm / np.sqrt(1 - (optics.outer_radius_mm / optics.distance_mm) ** 2))


def track_edges(profiles: FloatArray, camera: Camera, optics: Optics, *, search: float = SEARCH_COLUMNS) -> Edges:
    """Find both edges in every frame.

    Parameters
    ----------
    profiles
        (frame, column) counts as recorded, background and all, mean over rows.
    camera, optics
        As the rig has them; the axis within `search` columns.
    search
        Columns on either side of where an edge should be.
    """
    reach = edge_x_c_mm(optics) / camera.pixel_mm
    found = []
    for side in (-1, 1):
        place = camera.axis_column + side * reach
        first = max(0, int(np.floor(place - search)))
        last = min(profiles.shape[1], int(np.ceil(place + search)) + 1)
        if last - first < search:  # more than half of it lies beside the image
            found.append(np.full(len(profiles), np.nan))
            continue
        found.append(first + _peaks(profiles[:, first:last]))
    return Edges(*found)


def fit_circle(edges: Edges, angles_rad: FloatArray, camera: Camera, optics: Optics) -> EdgeCircle | None:
    """Fit the circle on which the edges go round; None where neither shows.

    Parameters
    ----------
    edges
        See `track_edges`.
    angles_rad
        (frame,) counter-clockwise seen from above.
    camera, optics
        As the rig has them.

    Notes
    -----
    A vial displaced by ``(c_x, c_y)`` in the lab is seen ``c_x (1 + (x_c/D)^2) - x_c c_y/D`` farther to the right.
    """
    reach, distance, pixel = edge_x_c_mm(optics), optics.distance_mm, camera.pixel_mm
    lines, places = [], []
    for which, (side, columns) in enumerate(((-1, edges.left), (1, edges.right))):
        seen = np.isfinite(columns)
        if seen.mean() < 0.8:
            continue
        cosine, sine = np.cos(angles_rad[seen]), np.sin(angles_rad[seen])
        spread, x_c = 1 + (reach / distance) ** 2, side * reach
        mean = np.zeros((2, len(cosine)))
        mean[which] = 1
        by_x, by_y = cosine * spread - x_c / distance * sine, -sine * spread - x_c / distance * cosine
        lines.append(np.stack([*mean, by_x / pixel, by_y / pixel], axis=1))
        places.append(columns[seen])
    if not lines:
        return None
    design, place = np.concatenate(lines), np.concatenate(places)
    known = design.any(axis=0)
    values = np.full(4, np.nan)
    # A frame that something passed in front of is left out: more than four standard deviations off.
    kept = np.ones(len(place), bool)
    for _ in range(3):
        values[known] = np.linalg.lstsq(design[kept][:, known], place[kept], rcond=None)[0]
        off = place - design[:, known] @ values[known]
        scatter = 1.4826 * float(np.median(np.abs(off[kept]))) + 1e-9
        kept = np.abs(off) < 4 * scatter
    inverse = np.linalg.inv(design[kept][:, known].T @ design[kept][:, known]) * scatter**2
    return EdgeCircle(float(values[0]), float(values[1]), values[2:], inverse[-2:, -2:], scatter)


def _peaks(windows: FloatArray) -> FloatArray:
    """Return the fractional column of the streak in every window (frame, column); NaN where none shows.

    The mean of all frames is the streak's own shape, smeared by what it moves: each frame is shifted onto it by least
    squares, with a level and a slope of its own, and the mean is made anew of the shifted frames.
    """
    count = windows.shape[1]
    column = np.arange(count, dtype=np.float64)
    level = windows - np.median(windows, axis=1, keepdims=True)
    mean = level.mean(axis=0)
    noise = 1.4826 * np.median(np.abs(np.diff(mean) - np.median(np.diff(mean)))) + 1e-12
    top = int(mean[1:-1].argmax()) + 1
    half = mean > mean[top] / 2
    share = np.where(half & (np.abs(column - top) <= _WIDEST_COLUMNS), np.maximum(mean, 0), 0)
    if mean[top] < LEAST_CONTRAST * min(noise, np.median(np.std(np.diff(windows, axis=0), axis=0))) or share.sum() <= 0:
        return np.full(len(windows), np.nan)
    middle = float((share * column).sum() / share.sum())
    width = max(0.6, np.sqrt(float((share * (column - middle) ** 2).sum() / share.sum())))
    places = np.full(len(windows), middle)
    for index, window in enumerate(windows):
        places[index] = _gaussian_at(window, column, middle, width)
    return places


def _gaussian_at(window: FloatArray, column: FloatArray, middle: float, width: float) -> float:
    """Return where a Gaussian on a slope fits best, by Gauss-Newton; NaN where it does not."""
    place, spread = middle, width
    for _ in range(_FRAME_PASSES):
        offset = (column - place) / spread
        bell = np.exp(-(offset**2) / 2)
        flat = np.stack([bell, np.ones_like(column), column - middle], axis=1)
        height, level, slope = np.linalg.lstsq(flat, window, rcond=None)[0]
        if height <= 0:
            return float("nan")
        left = window - flat @ np.array([height, level, slope])
        design = np.column_stack([flat, height * bell * offset / spread, height * bell * offset**2 / spread])
        step = np.linalg.lstsq(design, left, rcond=None)[0][3:]
        place += float(np.clip(step[0], -1, 1))
        spread = float(np.clip(spread + np.clip(step[1], -0.3, 0.3), 0.4, _WIDEST_COLUMNS))
        if abs(place - middle) > len(column) / 2:
            return float("nan")
    return place
