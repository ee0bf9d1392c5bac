"""The gelation threshold I_p from a standard cylinder, as in section S2 of Orth et al. 2022.

A cylinder whose diameter is known is seen from above: its density, averaged along its height.  I_p is the mean of that
along a circle of the known diameter, put where the cylinder is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from vialight.calibration.threshold.circles import (
    ROUNDNESS,
    Circle,
    check_round,
    edge_of,
    fit_circle,
    only_circle,
    samples_per_independent_one,
)
from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.errors import InputError

LEAST_CONTRAST = 10.0
"""Of what is cured, over the noise of the mean along its height."""
ENDS_SHARE = 0.1
"""Of the height, left out at either end, where the rims are soft."""


@dataclass(frozen=True)
class Overhead:
    """A cylinder seen from above.

    Parameters
    ----------
    density
        (y, x) mean along the cylinder's height.
    grid
        Of the volume.
    circle
        Where its edge is at half its own contrast: place and shape; the diameter is no measurement.
    bottom_mm, top_mm
        Where the cylinder ends.
    inside, outside
        Density there.
    taper_mm
        Radius near the top less that near the bottom.
    """

    density: FloatArray
    grid: Grid
    circle: Circle
    bottom_mm: float
    top_mm: float
    inside: float
    outside: float
    taper_mm: float

    @property
    def edge_std_mm(self) -> float:
        """Standard deviation of the Gaussian by which the edge is soft, from its slope at half the contrast."""
        step = self.grid.voxel_mm / 2
        inner, outer = (
            ring(self, self.circle.x_mm, self.circle.y_mm, self.circle.radius_mm + side * step).mean()
            for side in (-1, 1)
        )
        return _blur_std(self, float(inner - outer) / (2 * step))


@dataclass(frozen=True)
class RimThreshold:
    """I_p from one cylinder.

    Parameters
    ----------
    threshold
        Mean density along the circle, counts per mm.
    std
        Its standard uncertainty: of the noise along the circle, of the known radius, of the taper, and of the blur.
    slope_per_mm
        By how much the density falls with each mm outwards, there.
    around
        (n,) density along the circle, evenly from +x counter-clockwise.
    decentred
        The same along the circle where Hough's transform of the view from above puts it, to whole voxels.
    radius_mm, radius_std_mm
        As known from elsewhere.
    overhead
        What it was read from.
    """

    threshold: float
    std: float
    slope_per_mm: float
    around: FloatArray
    decentred: FloatArray
    radius_mm: float
    radius_std_mm: float
    overhead: Overhead

    @property
    def spread(self) -> float:
        """Standard deviation along the circle."""
        return float(self.around.std())

    @property
    def diameter_spread_mm(self) -> float:
        """The error of a diameter that one standard deviation along the circle means."""
        return 2 * self.spread / self.slope_per_mm

    @property
    def level(self) -> float:
        """Share of the contrast at which the threshold lies."""
        seen = self.overhead
        return (self.threshold - seen.outside) / (seen.inside - seen.outside)

    @property
    def blur_std_mm(self) -> float:
        """Standard deviation of the Gaussian by which the edge is blurred, from its slope."""
        return _blur_std(self.overhead, self.slope_per_mm)

    @property
    def diameter_std_mm(self) -> float:
        """Standard uncertainty of diameters at this threshold, from it alone."""
        return 2 * self.std / self.slope_per_mm


def overhead(density: Float32Array, grid: Grid, where: object = "", *, like_mm: float | None = None) -> Overhead:
    """Find a cylinder in a volume and look at it from above.

    Parameters
    ----------
    density
        (z, y, x), counts per mm.
    grid
        Where its voxels lie.
    where
        Named in errors.
    like_mm
        Radius of the one that is meant, where there are several.

    Raises
    ------
    InputError
        Nothing is cured, or it is no cylinder: not round, or not as wide at the top as at the bottom.
    """
    _check_that_something_cured(density, where)
    around_all = density.mean(axis=0, dtype=np.float64)
    rough = _circle(around_all, grid, where, like_mm)
    bottom, top = _ends(density, grid, rough, where)
    margin = ENDS_SHARE * (top - bottom)
    within = (grid.z_mm >= bottom + margin) & (grid.z_mm <= top - margin)
    seen = density[within].mean(axis=0, dtype=np.float64)
    circle = _circle(seen, grid, where, like_mm)
    check_round(circle, where)
    taper = _taper(density[within], grid, circle)
    if abs(taper) > ROUNDNESS * circle.radius_mm:
        raise InputError(
            where, f"the radius of {circle.radius_mm:.3f} mm changes by {taper:.3f} mm from bottom to top",
            accepted=f"a cylinder, even to {ROUNDNESS:.1%} of its radius", remedy="take another standard",
        )  # fmt: skip
    inside, outside = _levels(seen, grid, circle)
    return Overhead(seen, grid, circle, bottom, top, inside, outside, taper)


def rim_threshold(seen: Overhead, radius_mm: float, radius_std_mm: float = 0.0, where: object = "") -> RimThreshold:
    """Return the mean density along a circle of known radius about the cylinder's axis.

    Raises
    ------
    InputError
        The circle is not near the cylinder's edge.
    """
    circle, voxel = seen.circle, seen.grid.voxel_mm
    around = ring(seen, circle.x_mm, circle.y_mm, radius_mm)
    step = voxel / 2
    inner, outer = (ring(seen, circle.x_mm, circle.y_mm, radius_mm + side * step).mean() for side in (-1, 1))
    slope = float(inner - outer) / (2 * step)
    level = (float(around.mean()) - seen.outside) / (seen.inside - seen.outside)
    if not 0.05 < level < 0.95 or slope <= 0:
        raise InputError(
            where, f"is {circle.diameter_mm:.3f} mm wide where it scatters half as much as within, but "
            f"{2 * radius_mm:.3f} mm in the profile", accepted="the profile of the cylinder that was recorded",
            remedy="check --profile-pixel-mm and the rig's pixel_mm",
        )  # fmt: skip
    noise = around.std() * np.sqrt(samples_per_independent_one(around) / len(around))
    # The profile is of the top, the density of all heights: the top's radius is off the mean one by half the taper.
    tapered = seen.taper_mm / 2
    # A blur of standard deviation s leaves the density of a straight edge at the edge, that of a round one s^2/(2 r)
    # within it; how much of the edge's width is blur is not known.
    blurred = _blur_std(seen, slope) ** 2 / (2 * radius_mm)
    std = np.hypot(noise, slope * np.sqrt(radius_std_mm**2 + (tapered**2 + blurred**2) / 3))
    whole = [round((value - first) / voxel) * voxel + first
             for value, first in ((circle.x_mm, seen.grid.x_mm[0]), (circle.y_mm, seen.grid.y_mm[0]))]  # fmt: skip
    decentred = ring(seen, whole[0], whole[1], radius_mm)
    return RimThreshold(float(around.mean()), float(std), slope, around, decentred, radius_mm, radius_std_mm, seen)


def radius_at(seen: Overhead, threshold: float) -> Circle:
    """Return the circle along which the view from above crosses a threshold: what OST measures of the cylinder."""
    circle = seen.circle
    start = (circle.x_mm, circle.y_mm, circle.radius_mm)
    return _moved(fit_circle(edge_of(seen.density, threshold, seen.grid.voxel_mm), _in_pixels(start, seen.grid)),
                  seen.grid)  # fmt: skip


def ring(seen: Overhead, x_mm: float, y_mm: float, radius_mm: float) -> FloatArray:
    """Return the density along a circle, at four points a voxel."""
    phi = np.arange(int(8 * np.pi * radius_mm / seen.grid.voxel_mm)) / (4 * radius_mm / seen.grid.voxel_mm)
    x, y = x_mm + radius_mm * np.cos(phi), y_mm + radius_mm * np.sin(phi)
    at = [(y - seen.grid.y_mm[0]) / seen.grid.voxel_mm, (x - seen.grid.x_mm[0]) / seen.grid.voxel_mm]
    return np.asarray(map_coordinates(seen.density, at, order=3), dtype=np.float64)


def weighted_mean(values: Sequence[float], stds: Sequence[float]) -> tuple[float, float]:
    """Return the weighted mean, and the larger of its internal and its external standard uncertainty.

    The external one is from the scatter of the values about the mean (Birge 1932).

    Examples
    --------
    >>> np.round(weighted_mean([99.0, 101.0], [0.1, 0.1]), 6).tolist()
    [100.0, 1.0]
    """
    weight = np.asarray(stds, dtype=np.float64) ** -2.0
    mean = float(np.average(values, weights=weight))
    internal = float(weight.sum() ** -0.5)
    if len(values) < 2:
        return mean, internal
    birge = float(np.sqrt((weight * (np.asarray(values) - mean) ** 2).sum() / (len(values) - 1)))
    return mean, internal * max(1.0, birge)


def _blur_std(seen: Overhead, slope_per_mm: float) -> float:
    return float((seen.inside - seen.outside) / slope_per_mm / np.sqrt(2 * np.pi))


def _check_that_something_cured(density: Float32Array, where: object) -> None:
    # Pairs of slices that alternate see the same part, but other noise; neighbours share theirs by interpolation.
    bands = [density[np.arange(len(density)) // 2 % 2 == k].mean(axis=0, dtype=np.float64) for k in range(2)]
    smooth = [gaussian_filter(band, 1.0) for band in bands]
    noise = 1.4826 * float(np.median(np.abs(smooth[0] - smooth[1]))) / 2
    mean = (smooth[0] + smooth[1]) / 2
    contrast = float(np.percentile(mean, 99) - np.percentile(mean, 1))
    if contrast < LEAST_CONTRAST * noise:
        raise InputError(
            where, f"nothing has cured: seen from above, densities differ by {contrast:.3g} counts per mm, the noise "
            f"is {noise:.3g}", accepted="a turn with a cured cylinder", remedy="choose --turn, or other frames",
        )  # fmt: skip


def _circle(view: FloatArray, grid: Grid, where: object, like_mm: float | None) -> Circle:
    """Return the circle at half contrast of a view from above, in the object's frame."""
    low, high = np.percentile(view, [2, 98])
    level = (low + high) / 2
    edge = edge_of(gaussian_filter(view, 1.0), level, grid.voxel_mm)
    start = only_circle(edge, view.shape, grid.voxel_mm, where, like_mm)
    # The contrast of the part, not that of the view: a small part is less than 2 % of it.
    for _ in range(2):
        circle = _moved(fit_circle(edge_of(view, level, grid.voxel_mm), start), grid)
        inside, outside = _levels(view, grid, circle)
        level, start = (inside + outside) / 2, _in_pixels((circle.x_mm, circle.y_mm, circle.radius_mm), grid)
    return _moved(fit_circle(edge_of(view, level, grid.voxel_mm), start), grid)


def _levels(view: FloatArray, grid: Grid, circle: Circle) -> tuple[float, float]:
    away = np.hypot(grid.x_mm - circle.x_mm, grid.y_mm[:, None] - circle.y_mm)
    reach = np.hypot(grid.x_mm, grid.y_mm[:, None]) < grid.x_mm[-1]
    inside, outside = away < 0.6 * circle.radius_mm, (away > 1.1 * circle.radius_mm + 2 * grid.voxel_mm) & reach
    beyond = float(np.median(view[outside])) if outside.any() else 0.0
    return float(np.median(view[inside])), beyond


def _ends(density: Float32Array, grid: Grid, circle: Circle, where: object) -> tuple[float, float]:
    """Return where the density within half the radius comes and goes, to parts of a voxel."""
    within = np.hypot(grid.x_mm - circle.x_mm, grid.y_mm[:, None] - circle.y_mm) < circle.radius_mm / 2
    along = density[:, within].mean(axis=1, dtype=np.float64)
    level = np.percentile(along, 98) / 2
    cured = np.flatnonzero(along > level)
    first, last = int(cured[0]), int(cured[-1])
    if last - first < 8:
        raise InputError(
            where, f"is {(last - first + 1) * grid.voxel_mm:.2f} mm high", accepted="a cylinder of 9 voxels and more",
            remedy="choose a smaller --voxel, or a higher standard",
        )  # fmt: skip
    ends = []
    for inner, outer in ((first, first - 1), (last, last + 1)):
        known = 0 <= outer < len(along)
        part = (along[inner] - level) / (along[inner] - along[outer]) if known else 0.5
        ends.append(float(grid.z_mm[inner] + (outer - inner) * part * grid.voxel_mm))
    return ends[0], ends[1]


def _taper(density: Float32Array, grid: Grid, circle: Circle) -> float:
    """Return the radius at the top less that at the bottom, from a line through four parts of the height."""
    parts = np.array_split(density, 4)
    inside, outside = _levels(density.mean(axis=0, dtype=np.float64), grid, circle)
    start = _in_pixels((circle.x_mm, circle.y_mm, circle.radius_mm), grid)
    radii = [
        fit_circle(edge_of(part.mean(axis=0, dtype=np.float64), (inside + outside) / 2, grid.voxel_mm), start).radius_mm
        for part in parts
    ]
    return float(np.polyfit(np.arange(4), radii, 1)[0]) * 4 / (1 - 2 * ENDS_SHARE)


def _in_pixels(circle: tuple[float, float, float], grid: Grid) -> tuple[float, float, float]:
    """Return a circle of the object's frame in mm from the middle of the first voxel."""
    return circle[0] - float(grid.x_mm[0]), circle[1] - float(grid.y_mm[0]), circle[2]


def _moved(circle: Circle, grid: Grid) -> Circle:
    """Return a circle in mm from the middle of the first voxel in the object's frame."""
    first = np.array([grid.x_mm[0], grid.y_mm[0]])
    x_mm, y_mm = circle.x_mm + float(first[0]), circle.y_mm + float(first[1])
    return replace(circle, x_mm=x_mm, y_mm=y_mm, edge=replace(circle.edge, points_mm=circle.edge.points_mm + first))
