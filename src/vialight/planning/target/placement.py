"""Placing a part in the vial: turned, scaled and moved only as asked, refused where it does not fit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.planning.target.room import Room

_UNITS_IN_MM = {"metres": 1000.0, "inches": 25.4, "centimetres": 10.0, "micrometres": 0.001}
_DOUBTFULLY_SMALL = 0.1
"""Of the room's radius: a part in inches or metres that fills the room falls below it."""
_DOUBTFULLY_LARGE = 10.0
"""Times the room's size: a part in micrometres lies above it."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Placement:
    """A part where it is to be printed.

    Parameters
    ----------
    mesh
        The part in the object frame.
    matrix
        (4, 4): takes the mesh as it was given there, in mm; rotation times scale, and shift.
    scale
        The factor in `matrix`; 1 unless it was asked for.
    """

    mesh: Mesh
    matrix: FloatArray
    scale: float


class _Circle(NamedTuple):
    x_mm: float
    y_mm: float
    radius_mm: float


def place(
    mesh: Mesh,
    room: Room,
    *,
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    scale: float | None = None,
    fit: bool = False,
    centre: bool = True,
    where: object = "part",
) -> Placement:
    """Turn, scale and centre a part, and see that it fits.

    Parameters
    ----------
    mesh
        The part as its file has it, in mm.
    room
        Where the projector can print.
    rotate_deg
        Angles about the fixed axes x, then y, then z, through the origin.
    scale
        Factor about the origin.  None leaves the part as it is and refuses sizes that smell of another unit; any
        number, 1 included, says that the size is meant.
    fit
        Scale, down or up, to the largest that fits.
    centre
        Move the part to where the printer is at its best: sideways the smallest circle round it goes about the axis, so
        that the largest part fits and no light is asked for nearer to the vial's edge than need be (the middle of the
        bounding box would do neither, and would change with the angle about z); in height its middle goes to the plane
        of the optical axis, z = 0, where rays do not climb, or as near to it as the room allows.
    where
        What to call the part in errors.

    Raises
    ------
    InputError
        The part does not fit (with the largest scale that does), its size smells of another unit, or an argument is
        impossible.

    Examples
    --------
    >>> corner = Mesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> placed = place(corner, Room(8.0, -10.0, 10.0))
    >>> placed.matrix[:3, 3].tolist(), placed.scale
    ([-1.0, -1.0, -2.0], 1.0)
    """
    _check_arguments(rotate_deg, scale, fit=fit)
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(rotate_deg)
    turned = _used_points(mesh.moved(matrix))
    if scale is None and not fit:
        _check_unit(float(np.ptp(turned, axis=0).max()), room, where)
    shift = np.zeros(3)
    if centre:
        circle = _smallest_circle(turned[:, :2])
        shift = -np.array([circle.x_mm, circle.y_mm, (turned[:, 2].min() + turned[:, 2].max()) / 2])
    largest = _largest_scale(turned + shift, room, centre=centre)
    factor = largest if fit else 1.0 if scale is None else scale
    if factor > largest * (1 + _ROUNDING) or not largest > 0:
        raise _too_large(factor * (turned + shift), room, largest / factor, factor, where, centre=centre)
    matrix[:3, :3] *= factor
    if centre:
        half = factor * float(np.ptp(turned[:, 2])) / 2
        # The limits meet, up to rounding, where the part is as tall as the room.
        height = min(max(0.0, room.bottom_mm + half), max(room.top_mm - half, room.bottom_mm + half))
        matrix[:3, 3] = factor * shift + [0.0, 0.0, height]
    return Placement(mesh.moved(matrix), matrix, factor)


def radius_about_axis(mesh: Mesh) -> float:
    """Return the largest distance from the rotation axis, in mm.

    Examples
    --------
    >>> radius_about_axis(Mesh([[0, 0, 0], [3, 4, 0], [0, 0, 1]], [[0, 1, 2]]))
    5.0
    """
    return _radius(_used_points(mesh))


def _radius(points: FloatArray) -> float:
    return float(np.hypot(points[:, 0], points[:, 1]).max())


def _used_points(mesh: Mesh) -> FloatArray:
    return np.asarray(mesh.vertices_mm[np.unique(mesh.faces)])


def _rotation(rotate_deg: tuple[float, float, float]) -> FloatArray:
    from scipy.spatial.transform import Rotation

    exact = np.asarray(Rotation.from_euler("xyz", rotate_deg, degrees=True).as_matrix(), dtype=np.float64)
    # Quarter turns are exact: cos(90 deg) is 6e-17 in floating point, which would tilt flat faces by as much.
    return np.where(np.abs(exact - np.rint(exact)) < 1e-15, np.rint(exact), exact)


def _smallest_circle(points: FloatArray) -> _Circle:
    """Return the smallest circle that holds (n, 2) points.

    It is held by two or three of them: starting from any one, the farthest point outside joins those that hold the
    circle, which grows each time, until none is outside.
    """
    scale = float(np.abs(points - points[0]).max()) or 1.0
    support = [points[0]]
    circle = _Circle(float(points[0, 0]), float(points[0, 1]), 0.0)
    while True:
        distance = np.hypot(points[:, 0] - circle.x_mm, points[:, 1] - circle.y_mm)
        farthest = int(distance.argmax())
        if distance[farthest] <= circle.radius_mm + 1e-12 * scale:
            return circle._replace(radius_mm=float(distance[farthest]))
        grown, support = _circle_of_few([*support, points[farthest]])
        if grown.radius_mm <= circle.radius_mm:  # rounding: it cannot grow any more
            return circle._replace(radius_mm=float(distance[farthest]))
        circle = grown


def _circle_of_few(points: list[FloatArray]) -> tuple[_Circle, list[FloatArray]]:
    """Return the smallest circle that holds up to four points, and those that it passes through."""
    best: tuple[_Circle, list[FloatArray]] | None = None
    for count in (2, 3):
        for held in combinations(points, count):
            centre = _equidistant(*held)
            if centre is None:
                continue
            reach = max(math.dist(centre, point) for point in points)
            radius = math.dist(centre, held[0])
            if reach <= radius * (1 + 1e-12) and (best is None or radius < best[0].radius_mm):
                best = _Circle(float(centre[0]), float(centre[1]), radius), list(held)
    assert best is not None  # the circle of one pair or triple holds all
    return best


def _equidistant(one: FloatArray, two: FloatArray, three: FloatArray | None = None) -> FloatArray | None:
    """Return the middle of two points, or the centre of the circle through three; None where they lie in line."""
    if three is None:
        return np.asarray((one + two) / 2)
    sides = np.stack([two - one, three - one])
    doubled_area = float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0])
    if abs(doubled_area) <= 1e-14 * float((sides**2).sum()):
        return None
    return np.asarray(one + np.linalg.solve(sides, (sides**2).sum(axis=1) / 2))


def _largest_scale(points: FloatArray, room: Room, *, centre: bool) -> float:
    """Return the largest factor, about the origin, at which the points fit."""
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    radius = _radius(points)
    limits = [room.radius_mm / radius] if radius else []
    if centre:
        limits += [room.height_mm / (high - low)] if high > low else []
    else:
        limits += [room.top_mm / high] if high > 0 else []
        limits += [room.bottom_mm / low] if low < 0 else []
    return min(limits, default=1.0)


def _check_arguments(rotate_deg: tuple[float, float, float], scale: float | None, *, fit: bool) -> None:
    if len(rotate_deg) != 3 or not np.isfinite(rotate_deg).all():
        raise InputError("--rotate", f"is {rotate_deg}", accepted="three finite angles in degrees, about x, y, z")
    if scale is not None and not (math.isfinite(scale) and scale > 0):
        raise InputError("--scale", f"is {scale}", accepted="a positive factor", remedy="mirror a part in its own file")
    if scale is not None and fit:
        raise InputError("--scale", f"{scale:g} and --fit both set the size", accepted="one of them")


def _check_unit(size_mm: float, room: Room, where: object) -> None:
    """Refuse a size that nobody prints in this room."""
    room_mm = max(2 * room.radius_mm, room.height_mm)
    low, high = _DOUBTFULLY_SMALL * room.radius_mm, _DOUBTFULLY_LARGE * room_mm
    if low <= size_mm <= high:
        return
    likely = [f"{unit}, --scale {in_mm:g}" for unit, in_mm in _UNITS_IN_MM.items() if low <= size_mm * in_mm <= room_mm]
    remedy = f"if it is in {', or in '.join(likely)}; " if likely else "check the unit of the file; "
    raise InputError(
        where, f"its largest dimension is {size_mm:.3g} mm",
        accepted=f"{low:.3g} to {high:.3g} mm in a room of {2 * room.radius_mm:.3g} x {room.height_mm:.3g} mm",
        remedy=f"{remedy}if the size is meant, --scale 1",
    )  # fmt: skip


def _too_large(
    points: FloatArray, room: Room, ratio: float, factor: float, where: object, *, centre: bool
) -> InputError:
    low, high = points[:, 2].min(), points[:, 2].max()
    size = f"radius {_radius(points):.3f} mm about the axis, "
    if centre:
        size += f"height {high - low:.3f} mm"
        accepted = f"radius {room.radius_mm:.3f} mm, height {room.height_mm:.3f} mm"
    else:
        size += f"z from {low:.3f} to {high:.3f} mm"
        accepted = f"radius {room.radius_mm:.3f} mm, z from {room.bottom_mm:.3f} to {room.top_mm:.3f} mm"
    largest = math.floor(1e4 * ratio * factor) / 1e4
    remedy = f"--scale {largest:g} is the largest that fits, which --fit finds" if largest > 0 else "use another unit"
    return InputError(
        where, f"does not fit: {size}", accepted=accepted, remedy=remedy + ("" if centre else "; or centre it")
    )
