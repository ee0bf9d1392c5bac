"""Light out: what the camera counts of a scattering volume.

Each pixel's ray is traced through glass and resin once; a frame is the integral of the density along it, in the pose
that the object has, by trilinear interpolation at even steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from vialight.arrays import FAST_MATH, Float32Array, FloatArray, Grid
from vialight.config import Camera, Optics, Rig
from vialight.errors import InputError
from vialight.twin.poses import Pose
from vialight.twin.rays import trace

BINNINGS = (1, 2, 4, 8)

_NEGLIGIBLE = 1e-6
"""Share of the largest density below which a voxel is left out of the region that rays are followed through."""


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
    """

    rays: FloatArray
    camera: Camera
    optics: Optics
    binning: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of a frame."""
        return self.rays.shape[1], self.rays.shape[2]


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
    traced = [
        trace(x_c + right, z_c[:, None] + up, optics, pupil=(float(a), float(b)), focus_mm=focus_mm)
        for right in aside
        for up in aside
        for a, b in pupil_mm
    ]
    rays = np.stack([np.concatenate([ray.origin_mm, ray.direction], axis=-1) for ray in traced])
    return Imager(rays, camera, optics, binning)


def frames_of(
    density: Float32Array,
    grid: Grid,
    imager: Imager,
    poses: Sequence[Pose],
    *,
    extinction_mm2: float = 0.0,
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
        Of the object, one a frame.
    extinction_mm2
        Light lost per mm, over the density in counts per mm: both the light from above, which what lies higher
        shadows, and the scattered light on its way to the camera.  0: what scatters does not dim.
    step_mm
        Between samples along a ray; by default a voxel.

    Returns
    -------
    numpy.ndarray
        (frame, row, column) float32 counts, summed over binned pixels.

    Examples
    --------
    >>> from vialight.config import Resin, Vial
    >>> rig = Rig(
    ...     vial=Vial(outer_radius_mm=12.4, wall_mm=1.1), resin=Resin(index_imaging=1.48),
    ...     camera=Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=87.5, optical_row=59.5),
    ... )
    >>> grid = Grid((40, 40, 40), 0.25)  # 10 mm
    >>> frames = frames_of(np.full((40, 40, 40), 200, np.float32), grid, imager_for(rig), [Pose(0.0)])
    >>> frames[0, 60, 88].round(-1)
    np.float32(2000.0)
    """
    emission = _lit_from_above(density, grid.voxel_mm, extinction_mm2) if extinction_mm2 > 0 else density
    stood = np.array([pose.seen_from(0.0) for pose in poses])
    frames = np.zeros((len(poses), *imager.shape), np.float32)
    bounds = _occupied(density)
    if bounds is not None and len(poses):
        step = (step_mm or grid.voxel_mm) / grid.voxel_mm
        placed = np.array([grid.voxel_mm, *(grid.origin_mm[axis] for axis in (1, 2, 0))])
        for rays in imager.rays:
            _march(density, emission, placed, bounds, rays, stood, step, extinction_mm2, frames)
        frames *= np.float32(imager.binning**2 / len(imager.rays))
    return frames


@dataclass(frozen=True)
class StrayLight:
    """Light that does not come from the part, in counts of one of the rig's pixels.

    Parameters
    ----------
    base_counts
        Everywhere; assumed, as in the shared cases.
    edge_counts
        At the peak of the reflection at each edge of the vial; assumed.
    edge_width_mm
        Standard deviation of those peaks in the plane of the axis; assumed.
    """

    base_counts: float = 45.0
    edge_counts: float = 60.0
    edge_width_mm: float = 0.3

    def image(self, imager: Imager) -> FloatArray:
        """Return (row, column) expected counts of a frame without a part."""
        rows, columns = imager.shape
        x_c = np.abs(np.arange(columns) - imager.camera.axis_column) * imager.camera.pixel_mm
        # The ray that touches the vial: its distance from the axis is the outer radius.
        tangent = np.arcsin(imager.optics.outer_radius_mm / imager.optics.distance_mm)
        edge = imager.optics.outer_radius_mm / np.cos(tangent)
        line = self.base_counts + self.edge_counts * np.exp(-(((x_c - edge) / self.edge_width_mm) ** 2) / 2)
        return np.broadcast_to(line * imager.binning**2, (rows, columns))


@dataclass(frozen=True)
class Sensor:
    """What turns light into numbers.

    Parameters
    ----------
    read_noise_counts
        Standard deviation of a pixel's read-out.
    electrons_per_count
        So that photon noise is that of as many electrons.
    bits
        Of the converter: where a pixel saturates.
    """

    read_noise_counts: float = 3.0
    electrons_per_count: float = 1.0
    bits: int = 12

    def photograph(
        self, expected: NDArray[np.floating], rng: np.random.Generator, *, binning: int = 1
    ) -> NDArray[np.uint16]:
        """Count photons and read them out.

        Parameters
        ----------
        expected
            Counts, of any shape, summed over binned pixels.
        rng
            Source of noise.
        binning
            Of the frame: read noise and the largest count are those of so many pixels squared.

        Returns
        -------
        numpy.ndarray
            uint16, of the shape of `expected`.
        """
        counted = rng.poisson(np.asarray(expected, dtype=np.float64) * self.electrons_per_count)
        read = rng.normal(0.0, self.read_noise_counts * binning, expected.shape)
        highest = min((2**self.bits - 1) * binning**2, 65535)
        return np.clip(np.rint(counted / self.electrons_per_count + read), 0, highest).astype(np.uint16)


def _lit_from_above(density: Float32Array, voxel_mm: float, extinction_mm2: float) -> Float32Array:
    """Return the density times the share of light that comes down to each voxel's middle."""
    above = np.cumsum(density[..., ::-1], axis=2, dtype=np.float64)[..., ::-1] - density / 2
    return np.asarray(density * np.exp(-extinction_mm2 * voxel_mm * above), dtype=np.float32)


def _occupied(density: Float32Array) -> FloatArray | None:
    """Return first and last index along y, x, z of what scatters, one voxel wider; None where nothing does."""
    full = density > _NEGLIGIBLE * max(float(density.max()), 1e-30)
    if not full.any():
        return None
    bounds = []
    for axis in range(3):
        where = np.flatnonzero(full.any(axis=tuple(other for other in range(3) if other != axis)))
        bounds += [where[0] - 1.0, where[-1] + 1.0]
    return np.array(bounds, dtype=np.float64)


@njit(fastmath=FAST_MATH, cache=True)
def _clip(start: float, slope: float, low: float, high: float, enter: float, leave: float) -> tuple[float, float]:
    """Shorten a stretch of a ray to where one coordinate lies within bounds."""
    if abs(slope) < 1e-12:
        return (enter, leave) if low <= start <= high else (1.0, 0.0)
    a, b = (low - start) / slope, (high - start) / slope
    return max(enter, min(a, b)), min(leave, max(a, b))


@njit(fastmath=FAST_MATH, inline="always")
def _sample(volume: Float32Array, y: float, x: float, z: float) -> float:
    """Interpolate linearly between voxel centres; beyond them density falls to 0 within a voxel."""
    j, i, k = int(np.floor(y)), int(np.floor(x)), int(np.floor(z))
    v, u, w = np.float32(y - j), np.float32(x - i), np.float32(z - k)
    total = np.float32(0)
    rows, columns, depth = volume.shape
    if 0 <= j < rows - 1 and 0 <= i < columns - 1 and 0 <= k < depth - 1:
        a = volume[j, i, k] + w * (volume[j, i, k + 1] - volume[j, i, k])
        b = volume[j, i + 1, k] + w * (volume[j, i + 1, k + 1] - volume[j, i + 1, k])
        c = volume[j + 1, i, k] + w * (volume[j + 1, i, k + 1] - volume[j + 1, i, k])
        d = volume[j + 1, i + 1, k] + w * (volume[j + 1, i + 1, k + 1] - volume[j + 1, i + 1, k])
        a, c = a + u * (b - a), c + u * (d - c)
        return float(a + v * (c - a))
    for dj in range(2):
        for di in range(2):
            for dk in range(2):
                if 0 <= j + dj < rows and 0 <= i + di < columns and 0 <= k + dk < depth:
                    weight = (v if dj else 1 - v) * (u if di else 1 - u) * (w if dk else 1 - w)
                    total += weight * volume[j + dj, i + di, k + dk]
    return float(total)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _march(
    density: Float32Array, emission: Float32Array, placed: FloatArray, bounds: FloatArray, rays: FloatArray,
    stood: FloatArray, step: float, extinction: float, frames: Float32Array,
) -> None:  # fmt: skip
    voxel, first_y, first_x, first_z = placed
    rows, columns, _ = rays.shape
    for job in prange(len(stood) * rows):
        f, row = job // rows, job % rows
        cosine, sine = np.cos(stood[f, 0]), np.sin(stood[f, 0])
        shift_x, shift_y, tilt_x, tilt_y = stood[f, 1], stood[f, 2], stood[f, 3], stood[f, 4]
        for column in range(columns):
            if np.isnan(rays[row, column, 0]):
                continue
            # Into the object: back by shift, tilt and turn; then in voxels.
            x, y, z = rays[row, column, 0] - shift_x, rays[row, column, 1] - shift_y, rays[row, column, 2]
            dx, dy, dz = rays[row, column, 3], rays[row, column, 4], rays[row, column, 5]
            x, y, z = x - tilt_x * z, y - tilt_y * z, z + tilt_x * x + tilt_y * y
            dx, dy, dz = dx - tilt_x * dz, dy - tilt_y * dz, dz + tilt_x * dx + tilt_y * dy
            x, y = cosine * x + sine * y, cosine * y - sine * x
            dx, dy = cosine * dx + sine * dy, cosine * dy - sine * dx
            x, y, z = (x - first_x) / voxel, (y - first_y) / voxel, (z - first_z) / voxel
            enter, leave = _clip(y, dy, bounds[0], bounds[1], 0.0, 1e9)
            enter, leave = _clip(x, dx, bounds[2], bounds[3], enter, leave)
            enter, leave = _clip(z, dz, bounds[4], bounds[5], enter, leave)
            if leave <= enter:
                continue
            count = int(np.ceil((leave - enter) / step))
            length = (leave - enter) / count
            total, passed = 0.0, 0.0
            for n in range(count):
                t = enter + (n + 0.5) * length
                at_y, at_x, at_z = y + t * dy, x + t * dx, z + t * dz
                if extinction > 0:
                    thick = extinction * length * voxel * _sample(density, at_y, at_x, at_z)
                    total += _sample(emission, at_y, at_x, at_z) * np.exp(-passed - thick / 2)
                    passed += thick
                else:
                    total += _sample(emission, at_y, at_x, at_z)
            frames[f, row, column] += np.float32(total * length * voxel)
