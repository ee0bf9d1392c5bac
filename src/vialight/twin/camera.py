"""Light out: what the camera counts of a scattering volume.

Each pixel's ray is traced through glass and resin once; a frame is the integral of the density along it, in the pose
that the object has, by trilinear interpolation at even steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.config import Camera, Optics, Rig
from vialight.core.errors import InputError
from vialight.twin.marching import MARGIN, march
from vialight.twin.poses import Pose, VialPose
from vialight.twin.rays import Rays, trace

BINNINGS = (1, 2, 4, 8)

_NEGLIGIBLE = 1e-6
"""Share of the largest density below which a voxel may be left out of what rays are followed through."""


@dataclass(frozen=True)
class Imager:
    """A camera looking into a vial, made ready to take frames.

    Parameters
    ----------
    rays
        (ray, row, column, 6) float64: where each ray enters the resin, its direction, camera frame; NaN where it
        does not.  A pixel is the mean of its rays.
    camera
        Of the binned pixels.
    optics
        Of the camera.
    binning
        Pixels of the rig along each side of one of these.
    vial
        Where the vial stands, in whose frame the rays are.
    """

    rays: FloatArray
    camera: Camera
    optics: Optics
    binning: int
    vial: VialPose = VialPose()  # noqa: RUF009  frozen

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of a frame."""
        return self.rays.shape[1], self.rays.shape[2]


@dataclass(frozen=True)
class Scene:
    """What scatters, made ready to be looked at any number of times.

    Parameters
    ----------
    density, emission
        (y, x, z) float32, the box that is not empty and `MARGIN` voxels round it: what dims, and what shines.
    relative_rise
        (y, x, z) float32, by which share the index is higher than that of liquid resin; empty where it is not.
    placed
        Edge of a voxel, and y, x, z of the first voxel's centre, mm.
    extinction_mm2
        See `frames_of`.
    """

    density: Float32Array
    emission: Float32Array
    relative_rise: Float32Array
    placed: FloatArray
    extinction_mm2: float


def image_shape(camera: Camera) -> tuple[int, int]:
    """Return the even numbers of rows and columns in whose middle axis and optical axis lie.

    Examples
    --------
    >>> image_shape(Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=87.5, optical_row=59.5))
    (120, 176)
    """
    rows, columns = (max(2, 2 * round(position + 0.5)) for position in (camera.optical_row, camera.axis_column))
    return rows, columns


def imager_for(
    rig: Rig,
    shape: tuple[int, int] | None = None,
    *,
    binning: int = 1,
    rays_a_side: int = 1,
    pupil_mm: Sequence[tuple[float, float]] | FloatArray = ((0.0, 0.0),),
    focus_mm: float = 0.0,
    vial: VialPose | None = None,
) -> Imager:
    """Trace a rig's camera.

    Parameters
    ----------
    rig
        With vial, camera, and the resin's index at the imaging wavelength.
    shape
        (rows, columns) of the rig's pixels; by default `image_shape`.
    binning
        Sum squares of so many pixels a side.
    rays_a_side
        Rays along each side of a (binned) pixel; 1 is one thin ray through its middle.
    pupil_mm, focus_mm
        Points of the pupil, see `vialight.twin.rays.trace`; a pinhole by default.
    vial
        Where the vial stands; by default on the rig's axis.

    Raises
    ------
    InputError
        The rig lacks what imaging needs, or a pixel cannot be binned so.
    """
    optics = rig.imaging_optics()
    if optics is None:
        raise InputError(
            rig.source, 'geometry is "parallel"', accepted="a rig with a vial", remedy="the twin looks into vials only"
        )
    rows, columns = shape or image_shape(rig.need_camera())
    if binning not in BINNINGS or min(rows, columns) < binning:
        raise InputError(
            "binning", f"is {binning} for {rows} x {columns} pixels", accepted=", ".join(map(str, BINNINGS))
        )
    camera = rig.need_camera().binned(binning)
    x_c = (np.arange(columns // binning) - camera.axis_column) * camera.pixel_mm
    z_c = (camera.optical_row - np.arange(rows // binning)) * camera.pixel_mm
    aside = (np.arange(rays_a_side) - (rays_a_side - 1) / 2) * camera.pixel_mm / rays_a_side
    vial = vial or VialPose()
    traced = [
        _trace_into(vial, x_c + right, z_c[:, None] + up, optics, (float(a), float(b)), focus_mm)
        for right in aside
        for up in aside
        for a, b in pupil_mm
    ]
    rays = np.stack([np.concatenate([ray.origin_mm, ray.direction], axis=-1) for ray in traced])
    return Imager(rays, camera, optics, binning, vial)


def _trace_into(
    vial: VialPose, x_c: FloatArray, z_c: FloatArray, optics: Optics, pupil: tuple[float, float], focus_mm: float
) -> Rays:
    """Trace pixels' rays into a vial that stands off the axis: in its frame, it is the camera that is displaced."""
    if vial == VialPose():
        return trace(x_c, z_c, optics, pupil=pupil, focus_mm=focus_mm)
    x_c, z_c = np.broadcast_arrays(x_c, z_c)
    distance, (right, up) = optics.distance_mm, pupil
    if np.isinf(distance):
        through = vial.from_lab(np.stack([x_c, np.zeros(x_c.shape), z_c], axis=-1))
        course = vial.turned(np.array([right, 1.0, up]))
        start = (float(course[0] / course[1]), float(course[2] / course[1]))
    else:
        stretch = 1 + focus_mm / distance
        through = vial.from_lab(np.stack([x_c * stretch, np.full(x_c.shape, focus_mm), z_c * stretch], axis=-1))
        eye = vial.from_lab(np.array([right, -distance, up]))
        course, distance, start = through - eye, -float(eye[1]), (float(eye[0]), float(eye[2]))
    at_axis = through - course * (through[..., 1] / course[..., 1])[..., None]
    return trace(at_axis[..., 0], at_axis[..., 2], replace(optics, distance_mm=distance), pupil=start)


def frames_of(
    density: Float32Array,
    grid: Grid,
    imager: Imager,
    poses: Sequence[Pose],
    *,
    extinction_mm2: float = 0.0,
    index_rise: Float32Array | None = None,
    step_mm: float | None = None,
) -> Float32Array:
    """Integrate a density along every pixel's ray, without noise.

    Parameters
    ----------
    density
        (y, x, z) float32, counts per mm of the rig's pixels; nothing scatters outside the grid.
    grid
        Where its voxels lie, object frame.
    imager
        The camera.
    poses
        Of the object in the vial's frame, one a frame.
    extinction_mm2
        Light lost per mm, over the density in counts per mm: both the light from above, which what lies higher
        shadows, and the scattered light on its way to the camera.  0: what scatters does not dim.
    index_rise
        (y, x, z) float32, the resin's index over that of liquid resin: rays bend.  None: they are straight.
    step_mm
        Between samples along a ray; by default a voxel.

    Returns
    -------
    numpy.ndarray
        (frame, row, column) float32 counts, summed over binned pixels.

    Raises
    ------
    InputError
        Both extinction and an index that rises are asked for.

    Examples
    --------
    >>> from vialight.core.config import Resin, Vial
    >>> rig = Rig(
    ...     vial=Vial(outer_radius_mm=12.4, wall_mm=1.1), resin=Resin(index_imaging=1.48),
    ...     camera=Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=87.5, optical_row=59.5),
    ... )
    >>> grid = Grid((40, 40, 40), 0.25)  # 10 mm
    >>> frames = frames_of(np.full((40, 40, 40), 200, np.float32), grid, imager_for(rig), [Pose(0.0)])
    >>> frames[0, 60, 88].round(-1)
    np.float32(2000.0)
    """
    scene = scene_of(
        density, grid, resin_index=imager.optics.resin_index, extinction_mm2=extinction_mm2, index_rise=index_rise
    )
    return look_at(scene, imager, poses, step_mm=step_mm)


def scene_of(
    density: Float32Array,
    grid: Grid,
    *,
    resin_index: float = 1.0,
    extinction_mm2: float = 0.0,
    index_rise: Float32Array | None = None,
) -> Scene | None:
    """Make a density ready to be looked at; None where nothing scatters.

    Parameters
    ----------
    resin_index
        Of liquid resin; needed where `index_rise` is given.
    density, grid, extinction_mm2, index_rise
        See `frames_of`.

    Raises
    ------
    InputError
        Both extinction and an index that rises are asked for.
    """
    if index_rise is not None and extinction_mm2 > 0:
        raise InputError(
            "extinction_mm2", f"is {extinction_mm2} while rays bend", accepted="0", remedy="choose one of the two"
        )
    box = _occupied(density if index_rise is None else density + index_rise)
    if box is None:
        return None
    first = [
        grid.origin_mm[axis] + (part.start - MARGIN) * grid.voxel_mm for axis, part in zip((1, 2, 0), box, strict=True)
    ]
    seen = np.pad(density[box], MARGIN)
    emission = _lit_from_above(seen, grid.voxel_mm, extinction_mm2) if extinction_mm2 > 0 else seen
    rise = np.empty((0, 0, 0), np.float32)
    if index_rise is not None:
        rise = np.pad(index_rise[box] / np.float32(resin_index), MARGIN)
    return Scene(seen, emission, rise, np.array([grid.voxel_mm, *first]), extinction_mm2)


def look_at(
    scene: Scene | None, imager: Imager, poses: Sequence[Pose], *, step_mm: float | None = None
) -> Float32Array:
    """Integrate a scene along every pixel's ray, without noise; see `frames_of`."""
    frames = np.zeros((len(poses), *imager.shape), np.float32)
    if scene is None or not len(poses):
        return frames
    voxel_mm = float(scene.placed[0])
    stood = np.array([pose.seen_from(0.0) for pose in poses])
    step = 1.0 if step_mm is None else step_mm / voxel_mm
    for rays in imager.rays:
        march(
            scene.density, scene.emission, scene.relative_rise, scene.placed, rays, stood, step,
            scene.extinction_mm2 * voxel_mm, frames,
        )  # fmt: skip
    frames *= np.float32(imager.binning**2 / len(imager.rays))
    return frames


def _lit_from_above(density: Float32Array, voxel_mm: float, extinction_mm2: float) -> Float32Array:
    """Return the density times the share of light that comes down to each voxel's middle."""
    above = np.cumsum(density[..., ::-1], axis=2, dtype=np.float64)[..., ::-1] - density / 2
    return np.asarray(density * np.exp(-extinction_mm2 * voxel_mm * above), dtype=np.float32)


def _occupied(density: Float32Array) -> tuple[slice, slice, slice] | None:
    """Return the box along y, x, z that holds all that scatters; None where nothing does."""
    full = density > _NEGLIGIBLE * max(float(density.max()), 1e-30)
    if not full.any():
        return None
    y, x, z = (np.flatnonzero(full.any(axis=tuple(other for other in range(3) if other != axis))) for axis in range(3))
    return slice(y[0], y[-1] + 1), slice(x[0], x[-1] + 1), slice(z[0], z[-1] + 1)
