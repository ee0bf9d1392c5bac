"""Circles in maps: Hough's transform, then a robust fit to the edge between pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft2, rfft2

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError

COARSE_PIXELS = 128
"""Along the longer side of the map that votes are counted on."""
SMALLEST = 8.0
"""Radius, of those pixels."""
VOTES = 0.5
"""Share of a ring that must have an edge under it."""
ROUNDNESS = 0.025
"""Largest amplitude of any wave of the radius round a circle, of the radius: axes that differ by 5 % at the most."""
ALL_ROUND = 0.75
"""Share of the directions in which an edge must be seen."""
LIKE = 0.08
"""Share by which a circle's radius may differ from that of the one looked for, among others."""
MOST_CIRCLES = 8
_SECTORS = 36
WAVES = (2, 3, 4, 5, 6)
"""Waves round the circle that are looked for: 2 is an ellipse, 4 a square."""


@dataclass(frozen=True)
class Edge:
    """Points of an edge.

    Parameters
    ----------
    points_mm
        (n, 2) x, y.
    gap_mm
        (n,) how far apart the two pixels are that the edge lies between.
    """

    points_mm: FloatArray
    gap_mm: FloatArray


@dataclass(frozen=True)
class Circle:
    """A circle and how well it is known.

    Parameters
    ----------
    x_mm, y_mm, radius_mm
        In the frame of what it was found in.
    centre_std_mm, radius_std_mm
        Standard uncertainties.
    scatter_mm
        Robust standard deviation of the edge about it.
    wave_mm, wave
        Largest amplitude of `WAVES` of the radius round the circle, and which it is.
    edge
        What it was fitted to.
    """

    x_mm: float
    y_mm: float
    radius_mm: float
    centre_std_mm: float
    radius_std_mm: float
    scatter_mm: float
    wave_mm: float
    wave: int
    edge: Edge

    @property
    def diameter_mm(self) -> float:
        """Twice the radius."""
        return 2 * self.radius_mm


def edge_of(heights: FloatArray, level: float, pixel_mm: float) -> Edge:
    """Return where a map crosses a level along rows and columns, between pixels that were measured."""
    along_rows, gap_rows = _crossings(heights, level)
    along_columns, gap_columns = _crossings(heights.T, level)
    points = np.concatenate([along_rows, along_columns[:, ::-1]])
    return Edge(points * pixel_mm, np.concatenate([gap_rows, gap_columns]) * pixel_mm)


def fit_circle(edge: Edge, start: tuple[float, float, float], *, steps: int = 30) -> Circle:
    """Fit a circle to an edge by least squares with Tukey's weights, so that what lies off it does not count.

    Parameters
    ----------
    edge
        Points, others than the circle's included.
    start
        Centre and radius, mm, to within some gaps.
    """
    x, y, radius = start
    reach = 3 * float(np.median(edge.gap_mm)) + 0.1 * radius
    near = np.abs(_off(edge.points_mm, x, y, radius)) < reach
    points, gap = edge.points_mm[near], edge.gap_mm[near]
    # Crossings along a row tell the edge's place best where the edge runs across the row.
    floor = np.median(gap) / np.sqrt(12)
    weight = 1 / (gap**2 / 12 + 0.1 * floor**2)
    for _ in range(steps):
        off = _off(points, x, y, radius)
        scale = 1.4826 * float(np.median(np.abs(off))) + 1e-12
        tukey = np.clip(1 - (off / (4.685 * max(scale, floor))) ** 2, 0, None) ** 2
        phi = np.arctan2(points[:, 1] - y, points[:, 0] - x)
        slopes = np.stack([np.cos(phi), np.sin(phi), np.ones_like(phi)], axis=1)
        weighted = slopes * (weight * tukey)[:, None]
        step = np.linalg.solve(slopes.T @ weighted, weighted.T @ off)
        x, y, radius = x + float(step[0]), y + float(step[1]), radius + float(step[2])
        if np.abs(step).max() < 1e-9 * radius:
            break
    off = _off(points, x, y, radius)
    kept = tukey > 0
    order = np.argsort(phi[kept])
    left, slopes, share = off[kept][order], slopes[kept][order], (weight * tukey)[kept][order]
    inverse = np.linalg.inv(slopes.T @ (slopes * share[:, None]))
    spread = inverse @ (slopes.T @ (slopes * (share * left)[:, None] ** 2)) @ inverse
    covariance = spread * samples_per_independent_one(left) * len(left) / max(len(left) - 3, 1)
    wave_mm, wave = _largest_wave(phi, off)
    return Circle(
        x, y, radius, float(np.sqrt(covariance[0, 0] + covariance[1, 1]) / np.sqrt(2)),
        float(np.sqrt(covariance[2, 2])), scale, wave_mm, wave, Edge(points[kept], gap[kept]),
    )  # fmt: skip


def samples_per_independent_one(values: FloatArray) -> float:
    """Return how many neighbours on a ring say the same, from the ring's autocorrelation.

    Examples
    --------
    >>> round(samples_per_independent_one(np.random.default_rng(0).normal(size=4000)), 1)
    1.0
    """
    off = values - values.mean()
    power = np.abs(np.fft.rfft(off)) ** 2
    if power.sum() == 0:
        return 1.0
    correlation = np.fft.irfft(power, len(off))[: len(off) // 2] / (power[1:].sum() * 2 / len(off))
    below = np.flatnonzero(correlation < 0.05)
    until = int(below[0]) if len(below) else len(correlation)
    return float(1 + 2 * correlation[1:until].sum())


def _off(points: FloatArray, x: float, y: float, radius: float) -> FloatArray:
    return np.asarray(np.hypot(points[:, 0] - x, points[:, 1] - y) - radius)


def _largest_wave(phi: FloatArray, off: FloatArray) -> tuple[float, int]:
    """Return amplitude and number of the largest wave of the radius, from medians over sectors: dust does not count."""
    sectors = 72
    index = ((phi + np.pi) / (2 * np.pi) * sectors).astype(int) % sectors
    median = np.array([np.median(off[index == k]) if (index == k).any() else 0.0 for k in range(sectors)])
    amplitudes = 2 * np.abs(np.fft.rfft(median)) / sectors
    largest = max(WAVES, key=lambda wave: float(amplitudes[wave]))
    return float(amplitudes[largest]), largest


def check_round(circle: Circle, where: object) -> None:
    """Refuse an edge that does not go all round, or goes in and out by more than `ROUNDNESS`."""
    points = circle.edge.points_mm - [circle.x_mm, circle.y_mm]
    sectors = np.floor(np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    seen = len(np.unique(sectors)) / _SECTORS
    if seen < ALL_ROUND:
        raise InputError(
            where, f"the circle of {circle.diameter_mm:.3f} mm has an edge on {seen:.0%} of its way round",
            accepted=f"one that is seen on {ALL_ROUND:.0%} and more", remedy="see that all of it is in the map",
        )  # fmt: skip
    if circle.wave_mm > ROUNDNESS * circle.radius_mm:
        shape = {2: "an ellipse", 3: "a triangle", 4: "a square"}.get(circle.wave, f"{circle.wave} corners")
        raise InputError(
            where, f"the radius of {circle.radius_mm:.3f} mm goes up and down by {circle.wave_mm:.3f} mm, as that of "
            f"{shape}", accepted=f"a circle, round to {ROUNDNESS:.1%} of its radius", remedy="take another standard",
        )  # fmt: skip


def _crossings(heights: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """Return (n, 2) columns and rows at which rows of a map cross a level, and the gaps between the pixels there."""
    rows, columns = np.nonzero(np.isfinite(heights))
    above = heights[rows, columns] - level
    crossed = np.flatnonzero((rows[1:] == rows[:-1]) & ((above[1:] > 0) != (above[:-1] > 0)))
    before, after = above[crossed], above[crossed + 1]
    gap = (columns[crossed + 1] - columns[crossed]).astype(np.float64)
    at = columns[crossed] + gap * before / (before - after)
    return np.stack([at, rows[crossed]], axis=1), gap


def only_circle(
    edge: Edge, shape: tuple[int, ...], pixel_mm: float, where: object, like_mm: float | None = None
) -> tuple[float, float, float]:
    """Return centre and radius of a map's circle, roughly; refuse a map with none or with two.

    Of several, the one whose radius is like `like_mm`, where that is given and the others' are not.
    """
    found = strongest_circle(edge, shape, pixel_mm)
    if found is None:
        raise InputError(
            where, f"no circle: no ring has an edge under more than {VOTES:.0%} of it",
            accepted="a map with the whole rim of one cylinder", remedy="see that all of it is in the map",
        )  # fmt: skip
    circles: list[tuple[float, float, float]] = []
    while found is not None and len(circles) < MOST_CIRCLES:
        x, y, radius, coarse = found
        circles.append((x, y, radius))
        rest = np.abs(_off(edge.points_mm, x, y, radius)) > 3 * coarse
        edge = Edge(edge.points_mm[rest], edge.gap_mm[rest])
        found = strongest_circle(edge, shape, pixel_mm)
    if len(circles) == 1:
        return circles[0]
    fit = [one for one in circles if like_mm is not None and abs(one[2] / like_mm - 1) < LIKE]
    if len(fit) != 1:
        (x, y, radius), other = circles[:2]
        wanted = "one" if like_mm is None else f"one of {2 * like_mm:.2f} mm, others of other sizes"
        raise InputError(
            where, f"two circles: of {2 * radius:.2f} mm at ({x:.2f}, {y:.2f}) mm and of {2 * other[2]:.2f} mm at "
            f"({other[0]:.2f}, {other[1]:.2f}) mm", accepted=wanted, remedy="cut the map to one of them",
        )  # fmt: skip
    return fit[0]


def strongest_circle(edge: Edge, shape: tuple[int, ...], pixel_mm: float) -> tuple[float, float, float, float] | None:
    """Find the ring that has most edge under it, by Hough's transform.

    Votes for a radius are the correlation of a map of the edge with a ring, by Fourier transforms.

    Returns
    -------
    tuple or None
        Centre, radius and the coarse pixel that they are known to, mm; None where no ring has an edge under `VOTES`
        of it.
    """
    coarse = pixel_mm * max(1.0, max(shape) / COARSE_PIXELS)
    size = [int(np.ceil(count * pixel_mm / coarse)) + 1 for count in shape]
    column, row = np.rint(edge.points_mm.T / coarse).astype(int)
    image = np.zeros(size)
    image[np.clip(row, 0, size[0] - 1), np.clip(column, 0, size[1] - 1)] = 1
    if not image.any():
        return None
    image -= image.mean()  # dust, which lies under every ring alike
    padded = [2 * count for count in size]
    spectrum = rfft2(image, padded)
    away = np.hypot(*np.meshgrid(*[np.fft.fftfreq(count, 1 / count) for count in padded], indexing="ij"))
    best: tuple[float, tuple[float, float, float, float]] = (VOTES, (0.0, 0.0, 0.0, 0.0))
    found = False
    for radius in np.arange(SMALLEST, max(size) / 2 + 1):
        # A ring is as thick as rounding moves points; more than one of them under a part of it counts once, nearly.
        ring = np.clip(1.25 - np.abs(away - radius), 0, 1)
        votes = irfft2(spectrum * np.conj(rfft2(ring)), padded)[: size[0], : size[1]] / (2 * np.pi * radius)
        at = np.unravel_index(int(np.argmax(votes)), votes.shape)
        if votes[at] > best[0]:
            best = (float(votes[at]), (float(at[1]) * coarse, float(at[0]) * coarse, float(radius) * coarse, coarse))
            found = True
    return best[1] if found else None
