"""The way from camera frames to the measured surface, in order: start reading here.

frames -> line integrals -> parallel-beam sinogram -> volume -> isosurface -> comparison with what was meant.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray, Grid, IntArray, ParallelBeam, Volume
from vialight.core.config import Camera, Optics, Rig
from vialight.core.errors import InputError
from vialight.optics.viewing import heights_seen, ray_tilt
from vialight.store import FrameFile
from vialight.tomography.radon import FilterName
from vialight.tomography.sinogram import (
    Straightening,
    attenuation,
    bin_frames,
    parallel_beam,
    resample,
    rows_seen,
    select_turn,
    straightening,
    warn_of_unseen_rays,
)
from vialight.tomography.volume import DEFAULT_FILTER, reconstruct_climbing, reconstruct_slices

Progress = Callable[[int, int], None]
"""Called with what is done and what there is to do."""

SLICES_A_BLOCK = 64
"""Slices that go through the pipeline together: enough to fill vectors, few enough to stay in cache."""

FRAME_BYTES = 256 * 2**20
"""Frames held in memory at a time."""

MEMORY_SHARE = 0.5
"""Share of the machine's memory that a volume may take."""


@dataclass(frozen=True)
class Settings:
    """How to reconstruct.

    Parameters
    ----------
    voxel_mm
        Edge of a voxel; by default half a (binned) pixel with a vial, where the resin's index makes rays lie closer
        than pixels, and a pixel without.
    binning
        Sum this many by this many pixels first.
    turn
        Which turn of the recording, from 1; by default the one that ends with the last frame.
    accurate
        Backproject along the rays' climb in z too.
    filter_name
        See `vialight.tomography.radon.ramp_filter`.
    """

    voxel_mm: float | None = None
    binning: int = 1
    turn: int | None = None
    accurate: bool = False
    filter_name: FilterName = DEFAULT_FILTER

    def __post_init__(self) -> None:
        if self.voxel_mm is not None and not (np.isfinite(self.voxel_mm) and self.voxel_mm > 0):
            raise InputError("--voxel", f"is {self.voxel_mm}", accepted="a positive length in mm")
        if self.binning < 1:
            raise InputError("--bin", f"is {self.binning}", accepted="1 or more")


@dataclass(frozen=True)
class Scan:
    """One turn of a recording, with all that says where its rays run.

    Parameters
    ----------
    frames
        The open recording.
    chosen
        Indices of the turn's frames.
    angles_rad
        (frame,) angles of the object, counter-clockwise seen from above, of the chosen frames.
    camera
        For binned pixels.
    optics
        What the rays pass through; None without a vial.
    binning
        Pixels summed along rows and along columns.
    shape
        (rows, columns) of a binned frame.
    straight
        What a leaning axis or the vial's run-out ask of the frames; None where all stands straight.
    """

    frames: FrameFile
    chosen: IntArray
    angles_rad: FloatArray
    camera: Camera
    optics: Optics | None
    binning: int
    shape: tuple[int, int]
    straight: Straightening | None = None

    @property
    def beam(self) -> ParallelBeam:
        """Rays of the sinogram that suits these frames."""
        return parallel_beam(self.angles_rad, self.shape[1], self.camera, self.optics)

    @property
    def centre_mm(self) -> tuple[float, float]:
        """X and y of the vial's axis, about which the rays of `beam` are, in the object's frame."""
        return (0.0, 0.0) if self.straight is None else self.straight.centre_mm

    def line_integrals(self, rows: slice) -> Float32Array:
        """Read (frame, row, column): counts above the background, or attenuation, of binned rows, straightened."""
        if self.straight is None:
            return self.as_recorded(rows)
        margin = self.straight.margin(self.shape[1])
        more = slice(max(0, rows.start - margin), min(self.shape[0], rows.stop + margin))
        straight = self.straight.frames(self.as_recorded(more), more.start, self.angles_rad)
        return straight[:, rows.start - more.start : rows.stop - more.start]

    def as_recorded(self, rows: slice) -> Float32Array:
        """Read (frame, row, column): counts above the background, or attenuation, of binned rows."""
        raw_rows = slice(rows.start * self.binning, rows.stop * self.binning)
        counts = bin_frames(self.frames.read(self.chosen, raw_rows), self.binning)
        dark, white = (
            None if still is None else bin_frames(still, self.binning)
            for still in (self.frames.dark(raw_rows), self.frames.white(raw_rows))
        )
        if white is not None:
            return attenuation(counts, white, dark)
        if dark is not None:
            counts -= dark
        return counts


def open_scan(frames: FrameFile, rig: Rig, settings: Settings) -> Scan:
    """Choose the turn and the geometry for a recording.

    Raises
    ------
    InputError
        The recording has no such turn, or the rig lacks what imaging needs.

    Warns
    -----
    VialightWarning
        Parallel rays of half a turn leave some of the image's width out.
    """
    camera = rig.need_camera().binned(settings.binning)
    _, rows, columns = frames.shape
    shape = (rows // settings.binning, columns // settings.binning)
    if 0 in shape:
        raise InputError(
            "--bin", f"is {settings.binning} for {rows} x {columns} pixels", accepted="less than the image"
        )
    angles = rig.stage.direction * frames.angles_rad
    chosen = select_turn(angles, settings.turn)
    optics, angles = rig.imaging_optics(), angles[chosen]
    if optics is None:
        warn_of_unseen_rays(angles, shape[1], camera)
    straight = straightening(camera, optics, rig.stage.run_out)
    if straight is not None:
        angles = straight.angles(angles)
    return Scan(frames, chosen, angles, camera, optics, settings.binning, shape, straight)


def grid_for(scan: Scan, beam: ParallelBeam, voxel_mm: float | None) -> Grid:
    """Return the grid that holds all that the camera sees of the resin; see `grid_of_view`."""
    return grid_of_view(scan.shape[0], scan.camera, scan.optics, beam, voxel_mm)


def grid_of_view(
    rows: int, camera: Camera, optics: Optics | None, beam: ParallelBeam, voxel_mm: float | None = None
) -> Grid:
    """Return the grid that holds all that a camera sees of the resin.

    Parameters
    ----------
    rows
        Of a (binned) frame.
    camera, optics
        As the rig has them, for binned pixels; no optics for data without a vial.
    beam
        The rays of the sinogram.
    voxel_mm
        See `Settings`.

    Raises
    ------
    InputError
        The volume would not fit into memory.
    """
    if voxel_mm is None:
        voxel_mm = camera.pixel_mm if optics is None else camera.pixel_mm / 2
    across = max(2, 2 * int(field_radius_mm(beam, optics) / voxel_mm))
    bottom, top = heights_seen(rows, camera, optics)
    grid = Grid((int((top - bottom) / voxel_mm + 1e-6) + 1, across, across), voxel_mm, (bottom + top) / 2)
    size = 4 * np.prod(grid.shape, dtype=np.float64)
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if size > MEMORY_SHARE * memory:
        raise InputError(
            "--voxel", f"{voxel_mm:g} mm makes {' x '.join(map(str, grid.shape))} voxels, {size / 1e9:.1f} GB",
            accepted=f"volumes up to {MEMORY_SHARE * memory / 1e9:.1f} GB here",
            remedy="choose a larger --voxel or --bin",
        )  # fmt: skip
    return grid


def reconstruct(
    scan: Scan, settings: Settings, *, grid: Grid | None = None, progress: Progress | None = None
) -> Volume:
    """Reconstruct the scattering density, block by block of slices.

    Parameters
    ----------
    scan
        One turn of frames.
    settings
        How.
    grid
        The voxels wanted; by default `grid_for` the scan.
    progress
        Called with slices done and to do.

    Returns
    -------
    Volume
        Density in counts per mm; zero where no ray of the field passes.

    Raises
    ------
    InputError
        The frames do not support an answer.
    """
    beam = scan.beam
    grid = grid or grid_for(scan, beam, settings.voxel_mm)
    density = np.empty(grid.shape, np.float32)
    x_mm, y_mm = (axis - centre for axis, centre in zip((grid.x_mm, grid.y_mm), scan.centre_mm, strict=True))
    read = _row_window(scan)
    for start in range(0, grid.shape[0], SLICES_A_BLOCK):
        block = slice(start, min(start + SLICES_A_BLOCK, grid.shape[0]))
        _reconstruct_block(scan, beam, (x_mm, y_mm), grid.voxel_mm, grid.z_mm[block], settings, read, density[block])
        if progress:
            progress(block.stop, grid.shape[0])
    return Volume(density, grid)


def _reconstruct_block(
    scan: Scan,
    beam: ParallelBeam,
    plan_mm: tuple[FloatArray, FloatArray],
    voxel_mm: float,
    z_mm: FloatArray,
    settings: Settings,
    read: RowReader,
    density: Float32Array,
) -> None:
    heights, tilt, radius = z_mm, None, field_radius_mm(beam, scan.optics)
    if settings.accurate and scan.optics is not None:
        tilt = ray_tilt(beam.virtual_x_mm, scan.optics)
        heights = _heights_of_climbing_rays(z_mm, voxel_mm, float(tilt.max()) * radius)
    rows = rows_seen(heights, scan.shape[0], scan.camera, scan.optics)
    sinogram = resample(read(rows), rows.start, scan.angles_rad, scan.camera, scan.optics, beam, heights)
    if tilt is None:
        reconstruct_slices(sinogram, beam, *plan_mm, filter_name=settings.filter_name, radius_mm=radius, out=density)
    else:
        density[:] = reconstruct_climbing(
            sinogram, beam, heights, tilt, *plan_mm, z_mm, radius, filter_name=settings.filter_name
        )


def _heights_of_climbing_rays(z_mm: FloatArray, voxel_mm: float, largest_climb: float) -> FloatArray:
    """Return the heights of slices about a stack, twice as far as rays that pass it climb in the field."""
    margin = int(np.ceil(np.abs(z_mm).max() * 2 * largest_climb * (1 + largest_climb) / voxel_mm)) + 2
    return np.asarray(z_mm[0] + np.arange(-margin, len(z_mm) + margin) * voxel_mm, dtype=np.float64)


RowReader = Callable[[slice], Float32Array]


def _row_window(scan: Scan) -> RowReader:
    """Return a reader that keeps as many rows of all frames in memory as `FRAME_BYTES` allows.

    Slices are asked for from the bottom up, rows count from the top down: a new window ends where it is asked to.
    """
    # All that is summed into a binned row is there at once, in single precision.
    capacity = FRAME_BYTES // (4 * len(scan.chosen) * scan.shape[1] * scan.binning**2)
    held, rows_held = np.empty((0, 0, 0), np.float32), slice(0, 0)

    def read(rows: slice) -> Float32Array:
        nonlocal held, rows_held
        if rows.start < rows_held.start or rows.stop > rows_held.stop:
            rows_held = slice(max(0, min(rows.start, rows.stop - capacity)), rows.stop)
            held = scan.line_integrals(rows_held)
        return held[:, rows.start - rows_held.start : rows.stop - rows_held.start]

    return read


def field_radius_mm(beam: ParallelBeam, optics: Optics | None) -> float:
    """Return the distance from the axis within which every ray is seen."""
    return float(beam.virtual_x_mm[-1]) if optics is None else optics.field_radius_mm
