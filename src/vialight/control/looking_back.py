"""A recording seen again, by the window that measured it live: density over time at places, and when matter gelled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from vialight.control.history import StopHistory, fresh_history, observe, places, sample
from vialight.control.stop_model import StopModel
from vialight.core.arrays import Float32Array, FloatArray, Grid, IntArray
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.metrology import signed_distance
from vialight.metrology.kinetics import GelTimes, InsideHistory
from vialight.store import FrameFile
from vialight.tomography.reconstruct import field_radius_mm, grid_of_view
from vialight.tomography.sinogram import frames_a_turn
from vialight.tomography.sliding.window import SlidingWindow, beam_of

LOOKS_A_TURN = 36
_FRAMES_A_READ = 64
_CUBE_VOXELS = 2
_MOST_CUBES = 30_000


@dataclass(frozen=True)
class Place:
    """Where to look.

    Parameters
    ----------
    at_mm
        (x, y, z) object frame.
    radius_mm
        Of the ball over which density and dose are averaged; 0 for the point.
    """

    at_mm: tuple[float, float, float]
    radius_mm: float = 0.0


@dataclass(frozen=True)
class SeenAgain:
    """What was seen, look by look.

    Parameters
    ----------
    grid
        Of the volume.
    points_mm
        (point, xyz) that make up the place.
    time_s, lit_s
        (look,) when, and for how long light had been on.
    density
        (look,) mean over the place, counts per mm.
    gel_time_s
        (z, y, x) when each voxel gelled for a turn or more, or until the end; NaN where none did.
    inside
        Density inside the part; None without a part that has an inside.
    history
        Of the places of a rehearsal; None without one.
    """

    grid: Grid
    points_mm: FloatArray
    time_s: FloatArray
    lit_s: FloatArray
    density: FloatArray
    gel_time_s: Float32Array
    inside: InsideHistory | None
    history: StopHistory | None


def see_again(
    frames: FrameFile,
    rig: Rig,
    place: Place,
    lit_s: FloatArray,
    threshold: float,
    *,
    voxel_mm: float | None = None,
    part: Mesh | None = None,
    model: StopModel | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SeenAgain:
    """Read a recording from its beginning, and look a few times a turn.

    Parameters
    ----------
    frames, rig
        The recording, and the rig of its pixels.
    place
        Where to look.
    lit_s
        (frame,) for how long light had been on.
    threshold
        I_p, counts per mm.
    voxel_mm
        By default a pixel.
    part
        What is meant.
    model
        The rehearsal.
    progress
        Called with frames done and to do.

    Raises
    ------
    InputError
        The place lies outside what the camera sees, or the frames cannot be used.
    """
    a_turn, shape = frames_a_turn(frames.angles_rad), (frames.shape[1], frames.shape[2])
    camera, optics = rig.need_camera(), rig.imaging_optics()
    beam = beam_of(camera, optics, shape, a_turn)
    grid = grid_of_view(shape[0], camera, optics, beam, voxel_mm or camera.pixel_mm)
    points_mm = _points_of(place, grid, field_radius_mm(beam, optics))
    window = SlidingWindow(rig, shape, a_turn, dark=frames.dark(), threshold=threshold, grid=grid)
    at, time_s = _indices(points_mm, grid), times_of(frames, rig)
    every = max(1, a_turn // LOOKS_A_TURN)
    gelled = GelTimes(grid.shape, threshold, 360 / rig.stage.speed_deg_s)
    cubes = np.empty((0, 3), np.int64) if part is None else _cubes_inside(part, grid)
    history, watched = (None, None) if model is None else (fresh_history(model), places(model, grid))
    looked: list[int] = []
    density: list[float] = []
    inside: list[Float32Array] = []
    for number in _looks(frames, window, every, progress):
        volume = window.volume
        looked.append(number)
        density.append(float(map_coordinates(volume, at, order=1).mean()))
        gelled.note(volume, float(time_s[number]))
        inside.append(_means(volume, cubes))
        if model is not None and history is not None and watched is not None and lit_s[number] > 0:
            history = observe(history, sample(volume, watched), float(lit_s[number]), model.gel_share * threshold)
    when, lit = time_s[looked], lit_s[looked]
    cubes_seen = InsideHistory(
        cubes, _middles(cubes, grid), _CUBE_VOXELS * grid.voxel_mm, np.array(inside, np.float32), when, lit,
        max(1, round(a_turn / every)),
    )  # fmt: skip
    return SeenAgain(
        grid, points_mm, when, lit, np.array(density), gelled.lasting(), cubes_seen if len(cubes) else None, history
    )


def _looks(
    frames: FrameFile, window: SlidingWindow, every: int, progress: Callable[[int, int], None] | None
) -> Iterator[int]:
    """Feed the window; yield the number of the newest frame whenever it is to be looked at, and at the end."""
    count = frames.shape[0]
    for start in range(0, count, _FRAMES_A_READ):
        for number, counts in enumerate(frames.read(slice(start, min(start + _FRAMES_A_READ, count))), start):
            window.add(counts, float(frames.angles_rad[number]))
            is_last = number + 1 == count
            if is_last or (number + 1) % every == 0:
                window.renew(everything=is_last)
                yield number
        if progress is not None:
            progress(min(start + _FRAMES_A_READ, count), count)


def times_of(frames: FrameFile, rig: Rig) -> FloatArray:
    """Return (frame,) times; where none are recorded, those of a stage at its usual speed."""
    if frames.time_s is not None:
        return frames.time_s
    turned = np.abs(np.unwrap(frames.angles_rad) - frames.angles_rad[0])
    return np.asarray(turned / np.radians(rig.stage.speed_deg_s), dtype=np.float64)


def _points_of(place: Place, grid: Grid, radius_mm: float) -> FloatArray:
    """Return (point, xyz): the voxels of a ball, or the point alone."""
    x, y, z = place.at_mm
    if not (np.hypot(x, y) + place.radius_mm < radius_mm and grid.z_mm[0] <= z <= grid.z_mm[-1]):
        raise InputError(
            "--at", f"{x:g},{y:g},{z:g} mm lies outside what the camera sees",
            accepted=f"within {radius_mm:.2f} mm of the axis, z of {grid.z_mm[0]:.2f} to {grid.z_mm[-1]:.2f}",
        )  # fmt: skip
    if not place.radius_mm > 0:
        return np.array([place.at_mm], dtype=np.float64)
    axes = np.meshgrid(grid.x_mm, grid.y_mm, grid.z_mm, indexing="ij")
    points = np.stack([axis.ravel() for axis in axes], axis=1)
    near = points[np.linalg.norm(points - np.array(place.at_mm), axis=1) <= place.radius_mm]
    return near if len(near) else np.array([place.at_mm], dtype=np.float64)


def _indices(points_mm: FloatArray, grid: Grid) -> FloatArray:
    """Return (zyx, point) where points lie among voxels."""
    return np.asarray(((points_mm[:, ::-1] - np.array(grid.origin_mm)) / grid.voxel_mm).T)


def _cubes_inside(part: Mesh, grid: Grid) -> IntArray:
    """Return (cube, zyx) those cubes of voxels that lie inside a part."""
    cells = np.stack(
        [axis.ravel() for axis in np.meshgrid(*(np.arange(n // _CUBE_VOXELS) for n in grid.shape), indexing="ij")],
        axis=1,
    )
    middles, edge = _middles(cells, grid), _CUBE_VOXELS * grid.voxel_mm
    low, high = part.bounds_mm
    near = ((middles > low + edge / 2) & (middles < high - edge / 2)).all(axis=1)
    cells, middles = cells[near], middles[near]
    if len(cells):
        cells = cells[signed_distance(middles, part) < -edge / 2]
    return np.asarray(cells[:: -(-len(cells) // _MOST_CUBES)] if len(cells) else cells, dtype=np.int64)


def _middles(cells: IntArray, grid: Grid) -> FloatArray:
    at = (cells * _CUBE_VOXELS + (_CUBE_VOXELS - 1) / 2) * grid.voxel_mm + np.array(grid.origin_mm)
    return np.asarray(at[:, ::-1])


def _means(volume: Float32Array, cells: IntArray) -> Float32Array:
    """Return (cube,) mean density."""
    first = cells * _CUBE_VOXELS
    total = np.zeros(len(cells), np.float32)
    for corner in np.ndindex(*(_CUBE_VOXELS,) * 3):
        z, y, x = (first + np.array(corner)).T
        total += volume[z, y, x]
    return total / np.float32(_CUBE_VOXELS**3)
