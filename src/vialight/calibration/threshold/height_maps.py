"""The rim of a standard cylinder in a profilometer's height map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vialight.calibration.threshold.circles import (
    ROUNDNESS,
    Circle,
    Edge,
    check_round,
    edge_of,
    fit_circle,
    only_circle,
)
from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError

_FLANK = (0.2, 0.5, 0.8)
"""Heights at which the edge is taken, of that of the top: the middle one counts, the others say how steep it is."""

_POINTS_AN_OCTANT = 10
"""Without missing pixels beside them, from which on the others need not count."""


def circle_in_heights(heights_mm: FloatArray, pixel_mm: float, where: object = "") -> Circle:
    """Find the rim of a cylinder that stands on a flat ground, in a height map of it.

    The edge is taken at half the height of the top over the ground, between pixels; where pixels are missing, in the
    middle of the gap.  Half the height, for there a profilometer's lateral resolution moves the edge least, and a
    rounded or beaded rim not at all.

    Parameters
    ----------
    heights_mm
        (row, column), NaN where nothing was measured.
    pixel_mm
        Pitch of its pixels.
    where
        Named in errors.

    Returns
    -------
    Circle
        In mm from the middle of pixel (0, 0), x along columns, y along rows.

    Raises
    ------
    InputError
        There is no circle, or more than one, or it is not round, or its flank is that of a cone.

    Examples
    --------
    >>> row, column = np.mgrid[:80, :100]
    >>> circle = circle_in_heights(np.where(np.hypot(column - 52.3, row - 41.1) < 30, 4.0, 0.0), 0.1)
    >>> round(circle.x_mm, 2), round(circle.y_mm, 2), round(circle.diameter_mm, 2)
    (5.23, 4.11, 6.0)
    """
    low, high = _ground_and_top(heights_mm, where)
    # A map of the top alone: what is missing is ground.
    if np.isnan(low):
        heights_mm, low, high = np.where(np.isnan(heights_mm), 0.0, 1.0), 0.0, 1.0
    edges = [edge_of(heights_mm, low + share * (high - low), pixel_mm) for share in _FLANK]
    rough = only_circle(edges[1], heights_mm.shape, pixel_mm, where)
    lower, circle, upper = (fit_circle(edge, rough) for edge in edges)
    check_round(circle, where)
    gap = float(np.median(circle.edge.gap_mm)) - pixel_mm
    flank = max(lower.radius_mm - upper.radius_mm, gap)
    if flank > 2 * ROUNDNESS * circle.radius_mm:
        raise InputError(
            where, f"the flank of the circle of {circle.diameter_mm:.3f} mm is {flank:.3f} mm wide",
            accepted="a cylinder, whose flank is steep", remedy="a cone has no one diameter: take another standard",
        )  # fmt: skip
    if (sharp := _without_gaps(edges[1], circle, pixel_mm)) is not None:
        return fit_circle(sharp, (circle.x_mm, circle.y_mm, circle.radius_mm))
    # Where in a gap the edge lies is not known, and it may lie so all round.
    gaps = circle.edge.gap_mm
    unseen = float(np.average(np.maximum(gaps - pixel_mm, 0), weights=gaps**-2.0)) / np.sqrt(12)
    return replace(circle, radius_std_mm=float(np.hypot(circle.radius_std_mm, unseen)))


def _without_gaps(edge: Edge, circle: Circle, pixel_mm: float) -> Edge | None:
    """Return the points of an edge where no pixel is missing, if there are some in all directions."""
    sharp = edge.gap_mm < 1.5 * pixel_mm
    points = edge.points_mm[sharp]
    octant = np.floor(np.arctan2(points[:, 1] - circle.y_mm, points[:, 0] - circle.x_mm) / (np.pi / 4)).astype(int) + 4
    near = np.abs(np.hypot(points[:, 0] - circle.x_mm, points[:, 1] - circle.y_mm) - circle.radius_mm) < 2 * pixel_mm
    enough = np.bincount(octant[near], minlength=8)[:8].min() >= _POINTS_AN_OCTANT
    return Edge(points, edge.gap_mm[sharp]) if enough else None


def _ground_and_top(heights: FloatArray, where: object) -> tuple[float, float]:
    """Return the two levels of a map; NaN for the ground where only the top was measured."""
    known = heights[np.isfinite(heights)]
    if len(known) < 100:
        raise InputError(where, f"has {len(known)} heights", accepted="a height map with NaN where nothing was seen")
    counts, bounds = np.histogram(known, bins=256)
    middle, share = (bounds[:-1] + bounds[1:]) / 2, np.cumsum(counts) / counts.sum()
    mean = np.cumsum(counts * middle) / counts.sum()
    with np.errstate(divide="ignore", invalid="ignore"):
        # The split that leaves the least variance within both parts (Otsu 1979).
        between = np.nan_to_num((mean[-1] * share - mean) ** 2 / (share * (1 - share)))
    split = float(middle[np.flatnonzero(between >= 0.999 * between.max())].mean())
    low, high = known[known <= split], known[known > split]
    apart = float(np.median(high) - np.median(low))
    # Of one level with noise, Otsu's split leaves standard deviations of 0.6 on each side, and medians 1.3 apart.
    if apart > 6 * max(_robust_std(low), _robust_std(high)):
        return float(np.median(low)), float(np.median(high))
    if len(known) > 0.97 * heights.size:
        raise InputError(
            where, f"no step: heights from {known.min():.3f} to {known.max():.3f} mm without two levels",
            accepted="the top of a cylinder over its ground", remedy="include its surroundings",
        )  # fmt: skip
    return np.nan, float(np.median(known))


def _robust_std(values: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0
