"""Frames of ellipsoids in a vial, and their parallel-beam sinogram, both in closed form.

The vial's field, ``2 R / n``, fills 90 % of the columns.  Voxels are as large as the rays' spacing, pixel / n, so that
the grid has as many columns as the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, Grid, IntArray, ParallelBeam
from vialight.core.config import Camera, Optics, Resin, Rig, Vial
from vialight.optics.refraction import camera_to_virtual
from vialight.store import FrameFile
from vialight.tomography.reconstruct import Scan, Settings, open_scan
from vialight.tomography.sinogram import parallel_beam

FRAMES, COLUMNS = 180, 480
FIELD_SHARE = 0.9
OUTER_RADIUS_MM = 12.4
DARK_COUNTS = 100
COUNTS_PER_MM = 1000.0

# Centre x, y, z and half axes along x, y, z as shares of the field's radius; density as a share of COUNTS_PER_MM.
_ELLIPSOIDS = np.array(
    [
        [0.00, 0.00, 0.00, 0.75, 0.65, 4.0, 1.0],
        [0.25, 0.20, 0.00, 0.22, 0.16, 4.0, -0.6],
        [-0.30, -0.15, 0.20, 0.20, 0.28, 0.9, 0.7],
        [0.05, -0.40, -0.20, 0.12, 0.12, 0.8, -1.0],
        [-0.10, 0.40, 0.10, 0.10, 0.07, 0.7, 1.0],
        [0.50, -0.15, 0.00, 0.06, 0.14, 0.6, 0.8],
    ]
)


def rig(rows: int) -> Rig:
    """Return a rig whose vial fills `FIELD_SHARE` of the columns."""
    return Rig(
        vial=Vial(outer_radius_mm=OUTER_RADIUS_MM, wall_mm=1.1, wall_index=1.472),
        resin=Resin(index_imaging=1.48),
        camera=Camera(
            distance_mm=190.0,
            pixel_mm=2 * OUTER_RADIUS_MM / (FIELD_SHARE * COLUMNS),
            axis_column=(COLUMNS - 1) / 2,
            optical_row=(rows - 1) / 2,
        ),
    )


@dataclass(frozen=True)
class Problem:
    """What all methods are given: one object, as frames and as a sinogram, and the voxels to fill."""

    slices: int

    @property
    def camera(self) -> Camera:
        """The camera; its image has as many rows as there are slices, and reaches further, as voxels are smaller."""
        return rig(self.slices).need_camera()

    @property
    def optics(self) -> Optics:
        """The vial, as the camera sees it."""
        optics = rig(self.slices).imaging_optics()
        assert optics is not None
        return optics

    @property
    def angles_rad(self) -> FloatArray:
        """Stage angles of a full turn."""
        return np.arange(FRAMES, dtype=np.float64) * (2 * np.pi / FRAMES)

    @property
    def beam(self) -> ParallelBeam:
        """The rays of the sinogram, those that vialight chooses."""
        return parallel_beam(self.angles_rad, COLUMNS, self.camera, self.optics)

    @property
    def grid(self) -> Grid:
        """The voxels: the whole square, beyond the field too."""
        return Grid((self.slices, COLUMNS, COLUMNS), self.beam.spacing_mm)

    def frames(self) -> NDArray[np.uint16]:
        """Return (frame, row, column) counts along the refracted, climbing rays, over a constant background."""
        camera = self.camera
        x_c = (np.arange(COLUMNS) - camera.axis_column) * camera.pixel_mm
        z_c = (camera.optical_row - np.arange(self.slices)) * camera.pixel_mm
        rays = camera_to_virtual(x_c, z_c[:, None], self.optics)
        counts = np.empty((FRAMES, self.slices, COLUMNS), np.uint16)
        for counts_of_frame, angle in zip(counts, self.angles_rad, strict=True):
            psi = angle + rays.direction_rad
            lengths = _integrals(psi, rays.virtual_x_mm, rays.mid_height_mm, rays.slope, self._ellipsoids())
            counts_of_frame[:] = np.round(DARK_COUNTS + np.nan_to_num(lengths))
        return counts

    def sinogram(self, psi_rad: FloatArray, s_mm: FloatArray, z_mm: FloatArray) -> Float32Array:
        """Return (z, psi, s) exact integrals along level rays; `s_mm` is (s,) or (psi, s)."""
        shape = (len(psi_rad), s_mm.shape[-1])
        psi, s = (np.ascontiguousarray(np.broadcast_to(values, shape)) for values in (psi_rad[:, None], s_mm))
        level = np.zeros(shape)
        return np.stack([_integrals(psi, s, level + z, level, self._ellipsoids()) for z in z_mm]).astype(np.float32)

    def density(self, z_mm: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return (z, y, x) true densities, and which voxels are inside the field and away from any surface."""
        z, y, x = z_mm[:, None, None], self.grid.y_mm[:, None], self.grid.x_mm
        field = self.optics.field_radius_mm
        margin = 6 * self.grid.voxel_mm
        density = np.zeros((len(z_mm), len(self.grid.y_mm), len(x)))
        judged = np.broadcast_to(np.hypot(x, y) < 0.97 * field, density.shape).copy()
        for cx, cy, cz, ax, ay, az, value in self._ellipsoids():
            radius = np.sqrt(((x - cx) / ax) ** 2 + ((y - cy) / ay) ** 2 + ((z - cz) / az) ** 2)
            density += value * (radius < 1)
            judged &= np.abs(radius - 1) * min(ax, ay, az) > margin
        return density, judged

    def scan(self, frames: NDArray[np.uint16]) -> Scan:
        """Return the frames as vialight has them once a recording is open."""
        recording = cast(FrameFile, _FramesInMemory(frames, self.angles_rad))
        return open_scan(recording, rig(self.slices), Settings())

    def _ellipsoids(self) -> FloatArray:
        scale = np.array([*6 * [self.optics.field_radius_mm], COUNTS_PER_MM])
        return np.asarray(_ELLIPSOIDS * scale, dtype=np.float64)


@dataclass(frozen=True)
class _FramesInMemory:
    """The part of a `FrameFile` that a scan reads."""

    counts: NDArray[np.uint16]
    angles_rad: FloatArray

    @property
    def shape(self) -> tuple[int, ...]:
        return self.counts.shape

    def read(self, frames: IntArray, rows: slice) -> NDArray[Any]:
        return self.counts[frames, rows]

    def dark(self, rows: slice) -> FloatArray:
        return np.full(self.counts[0, rows].shape, float(DARK_COUNTS))

    def white(self, rows: slice) -> None:
        del rows


@njit(parallel=True, cache=True)
def _integrals(
    psi: FloatArray, s: FloatArray, mid_height: FloatArray, slope: FloatArray, ellipsoids: FloatArray
) -> FloatArray:
    """Integrate along lines that pass the axis at distance s and height mid_height and climb by slope."""
    out = np.zeros(psi.shape)
    for row in prange(psi.shape[0]):
        for column in range(psi.shape[1]):
            sine, cosine = np.sin(psi[row, column]), np.cos(psi[row, column])
            rise, distance, height = slope[row, column], s[row, column], mid_height[row, column]
            stretch = np.sqrt(1 + rise * rise)
            for cx, cy, cz, ax, ay, az, value in ellipsoids:
                px, py, pz = (distance * cosine - cx) / ax, (-distance * sine - cy) / ay, (height - cz) / az
                dx, dy, dz = sine / ax, cosine / ay, rise / az
                a, b, c = dx * dx + dy * dy + dz * dz, px * dx + py * dy + pz * dz, px * px + py * py + pz * pz - 1
                if b * b > a * c:
                    out[row, column] += value * stretch * 2 * np.sqrt(b * b - a * c) / a
    return out
