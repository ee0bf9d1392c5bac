"""The points of a flat target, dots or the corners of a chessboard, found in an image and numbered.

Dots and corners look the same turned by half a turn.  Each is first found by what it looks like smoothed, then put
where the image is most like itself turned about it: to some hundredths of a pixel, whatever the contrast.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter
from scipy.spatial import KDTree

from vialight.core.arrays import FloatArray, IntArray
from vialight.core.errors import InputError

Kind = Literal["dots", "chessboard"]
Bend = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]

FEWEST_ALONG = 4
"""Points that must be numbered along rows and along columns."""
_SMOOTHING = 0.17
"""Standard deviation of the filter that points are first found in, of a step."""
_FAINTEST = 0.3
"""Least response, of what the clearest points have."""
_REACH = 0.4
"""Of a step: how far a neighbour may lie from where it should, and the radius within which symmetry is looked for."""
_PASSES = 6
_MOST_ASYMMETRY = 0.3
"""Of the contrast round a point: beyond it, it is the rim of a chessboard, or no point."""
_FIRST_POINTS = 9


@dataclass(frozen=True)
class GridPoints:
    """Points of a target in an image.

    Parameters
    ----------
    columns, rows
        (point,) fractional places.
    across, up
        (point,) whole numbers, which count to the right and upwards from one of them.
    """

    columns: FloatArray
    rows: FloatArray
    across: IntArray
    up: IntArray


def find_grid(image: FloatArray, kind: Kind, step: tuple[float, float], where: object = "") -> GridPoints:
    """Find and number the points of a target.

    Parameters
    ----------
    image
        (row, column).
    kind
        Of the target.
    step
        Columns and rows from point to point, to within a third.
    where
        Named in errors.

    Raises
    ------
    InputError
        No grid is seen.

    Examples
    --------
    >>> row, column = np.mgrid[:120, :160]
    >>> image = np.cos(np.pi * (column - 80.3) / 12) * np.cos(np.pi * (row - 60.1) / 12)
    >>> seen = find_grid(image, "chessboard", (11.0, 13.0))
    >>> place = seen.columns - 12 * seen.across
    >>> round(float(place.mean() % 12), 2), round(float(place.std()), 2)  # of a corner, six columns from 80.3
    (2.3, 0.0)
    """
    flat = _evened(np.asarray(image, np.float64), step)
    grids = []
    for response in _responses(flat, kind, step):
        numbered = _numbered(_clear_maxima(response, step), step)
        columns, rows = numbered[:, :2].astype(int).T
        # What lies between dots makes a grid too, but a flatter one: dots cover the lesser part.
        grids.append((float(np.median(response[rows, columns])) if len(rows) else 0.0, numbered))
    best = max(grids, key=lambda grid: grid[0])[1]
    points = GridPoints(best[:, 0], best[:, 1], best[:, 2].astype(np.int64), best[:, 3].astype(np.int64))
    if len(best):
        # In the image as it is: evening out the contrast would move points at the target's rim.
        points = centred(image, points, step)
    if min(len(np.unique(points.across)), len(np.unique(points.up))) < FEWEST_ALONG:
        raise InputError(
            where, f"of {'dots' if kind == 'dots' else 'corners'} about {step[0]:.1f} columns and {step[1]:.1f} rows "
            f"apart, {len(points.up)} are seen in a grid",
            accepted=f"{FEWEST_ALONG} x {FEWEST_ALONG} and more, level within 15 deg",
            remedy="check pitch, focus and light, and that the rig's pixel_mm is right to a third",
        )  # fmt: skip
    return points


def centred(image: FloatArray, points: GridPoints, step: tuple[float, float], bend: Bend | None = None) -> GridPoints:
    """Move points to where the image is most like itself turned by half a turn; leave out what is unlike itself.

    Gauss-Newton on ``I(c + b + d) - I(c + b - d)``, with a slope of the brightness as a nuisance.

    Parameters
    ----------
    image
        (row, column).
    points
        Within `_REACH` steps.
    step
        See `find_grid`.
    bend
        ``b`` for columns (n, 1), rows (n, 1), and ``d`` to the right and down (k,): half of what two offsets that are
        opposite on the target are not opposite in the image, (n, k, 2).  None where the image is even.
    """
    image = np.asarray(image, np.float64)
    right, down = _half_disk(step)
    places = start = np.stack([points.columns, points.rows], axis=1)
    slopes = [np.gradient(image, axis=axis) for axis in (1, 0)]
    for _ in range(_PASSES):
        middle = places[:, None, :] + (0.0 if bend is None else bend(places[:, :1], places[:, 1:], right, down))
        offset = np.stack([right, down], axis=1)
        one, other = (_read(image, middle + side * offset) for side in (1, -1))
        moves = [_read(slope, middle + offset) - _read(slope, middle - offset) for slope in slopes]
        design = np.stack([*moves, *np.broadcast_arrays(right, down, moves[0])[:2]], axis=2)
        normal = np.einsum("nki,nkj->nij", design, design) + 1e-9 * np.eye(4)
        shift = np.linalg.solve(normal, np.einsum("nki,nk->ni", design, other - one)[..., None])[..., 0]
        places = places + np.clip(shift[:, :2], -0.5, 0.5)
    unlike = (other - one) - np.einsum("nki,ni->nk", design, shift)
    asymmetry = unlike.std(axis=1) / (np.concatenate([one, other], axis=1).std(axis=1) + 1e-12)
    good = (np.hypot(*((places - start) / step).T) < _REACH) & (np.abs(shift[:, :2]).max(axis=1) < 0.05)
    good &= asymmetry < _MOST_ASYMMETRY
    return GridPoints(places[good, 0], places[good, 1], points.across[good], points.up[good])


def _half_disk(step: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return offsets to the right and down, one of each two that are opposite."""
    reach = np.maximum(_REACH * np.asarray(step), 2.0)
    right, down = np.meshgrid(np.arange(-np.ceil(reach[0]), np.ceil(reach[0]) + 1), np.arange(np.ceil(reach[1]) + 1))
    inside = ((down > 0) | (right > 0)) & (np.hypot(right / (reach[0] + 0.5), down / (reach[1] + 0.5)) <= 1)
    return right[inside], down[inside]


def _read(values: FloatArray, places: FloatArray) -> FloatArray:
    """Return (n, k) values at columns and rows (n, k, 2)."""
    return np.asarray(map_coordinates(values, [places[..., 1], places[..., 0]], order=3, mode="nearest"))


def _evened(image: FloatArray, step: tuple[float, float]) -> FloatArray:
    """Return the image without slow changes of level and contrast."""
    wide = (1.5 * step[1], 1.5 * step[0])
    level = image - gaussian_filter(image, wide)
    contrast = np.sqrt(gaussian_filter(level**2, wide))
    return np.asarray(level / (contrast + 0.2 * float(contrast.max()) + 1e-12))


def _responses(flat: FloatArray, kind: Kind, step: tuple[float, float]) -> list[FloatArray]:
    """Return images that are highest where points are."""
    sigma = (_SMOOTHING * step[1], _SMOOTHING * step[0])
    if kind == "dots":
        smooth = gaussian_filter(flat, sigma)
        return [smooth, -smooth]
    along, across, mixed = (gaussian_filter(flat, sigma, order=order) for order in ((2, 0), (0, 2), (1, 1)))
    return [mixed**2 - along * across]  # a saddle


def _clear_maxima(response: FloatArray, step: tuple[float, float]) -> FloatArray:
    """Return (point, 2) columns and rows."""
    size = (max(3, 2 * int(0.3 * step[1]) + 1), max(3, 2 * int(0.3 * step[0]) + 1))
    is_top = (maximum_filter(response, size) == response) & (response > 0)
    row, column = np.nonzero(is_top)
    height = response[row, column]
    if not len(height):
        return np.empty((0, 2))
    kept = height > _FAINTEST * np.percentile(height, 90)
    return np.stack([column[kept], row[kept]], axis=1).astype(np.float64)


def _numbered(points: FloatArray, step: tuple[float, float]) -> FloatArray:
    """Return (point, 4) column, row and numbers of the largest grid that grows from a point near the middle."""
    if len(points) < FEWEST_ALONG**2:
        return np.empty((0, 4))
    tree = KDTree(points / step)  # in steps, so that a stretched grid has square meshes
    starts = np.atleast_1d(tree.query(np.median(points / step, axis=0), k=_FIRST_POINTS)[1])
    grown: dict[tuple[int, int], int] = {}
    for start in starts:
        grown = max(grown, _grown(tree, int(start)), key=len)
        if len(grown) > len(points) / 2:
            break
    return np.array([(*points[point], *number) for number, point in grown.items()])


def _grown(tree: KDTree, start: int) -> dict[tuple[int, int], int]:
    """Return the points that are numbered from one of them on, each by a neighbour's steps."""
    places = np.asarray(tree.data)
    found, taken = {(0, 0): start}, {start}
    steps = {(0, 0): (np.array([1.0, 0.0]), np.array([0.0, -1.0]))}
    queue = deque([(0, 0)])
    while queue:
        number = queue.popleft()
        for axis, side in ((0, 1), (0, -1), (1, 1), (1, -1)):
            beside = (number[0] + side * (axis == 0), number[1] + side * (axis == 1))
            if beside in found:
                continue
            step = steps[number][axis]
            away, point = tree.query(places[found[number]] + side * step)
            if away > _REACH * np.hypot(*step) or point in taken:
                continue
            found[beside] = int(point)
            taken.add(int(point))
            own = list(steps[number])
            own[axis] = side * (places[point] - places[found[number]])
            steps[beside] = (own[0], own[1])
            queue.append(beside)
    return found
