"""The volume of the latest turn, renewed with every frame.

What it holds is the reconstruction of the frames of one turn up to the newest: frames are interpolated onto evenly
spaced virtual angles as `vialight.tomography.sinogram.resample` does it, and what a frame changes of a virtual angle is
filtered and backprojected into the volume.  `turn` knows which frames count, `schedule` which virtual angles are due.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import TURN_RAD, BoolArray, Float32Array, FloatArray, Grid, IntArray, ParallelBeam
from vialight.core.compiling import aligned_zeros, padded_depth
from vialight.core.config import Camera, Optics, Rig
from vialight.core.errors import InputError
from vialight.core.messages import Sums
from vialight.tomography.radon import FilterName, ramp_filter
from vialight.tomography.radon.filters import filter_few, padded_filter
from vialight.tomography.radon.updating import AxisSums, add_projections
from vialight.tomography.radon.workers import Workers
from vialight.tomography.reconstruct import SLICES_A_BLOCK, field_radius_mm, grid_of_view
from vialight.tomography.sinogram import bin_frames, parallel_beam, straightening
from vialight.tomography.sinogram.streaming import LOST, NEVER, fold_changes, ray_taps, read_view, renew_rays
from vialight.tomography.sliding.schedule import Schedule
from vialight.tomography.sliding.turn import LatestTurn
from vialight.tomography.volume import DEFAULT_FILTER


@dataclass(frozen=True)
class WindowState:
    """What the window holds.

    Parameters
    ----------
    density
        Sums of the density along each axis: counts per mm, times mm.
    cured
        Those of the cured volume: mm of path above the threshold.
    cured_volume_mm3
        Volume of the voxels above the threshold.
    provisional_share
        Of all rays, those that the newest turn does not know for good: any of the following three.
    incomplete_share
        Rays of virtual angles that the stage is passing: some columns are newer than others.
    older_share
        Rays known only from an older turn, for frames are missing.
    never_share
        Rays not seen yet, from neither side.
    frames_used
        Frames that have gone in, with those that took another's place; not those that `add` left out.
    frames_in_turn
        Frames that the volume is made of.
    newest_angle_rad
        Angle of the object in the newest of them, without wrapping.
    """

    density: Sums
    cured: Sums
    cured_volume_mm3: float
    provisional_share: float
    incomplete_share: float
    older_share: float
    never_share: float
    frames_used: int
    frames_in_turn: int
    newest_angle_rad: float


class SlidingWindow:
    """A volume that follows the frames of a turning object.

    Parameters
    ----------
    rig
        Vial, camera and the stage's direction.
    frame_shape
        (rows, columns) of the frames.
    frames_per_turn
        At the stage's usual speed; even, as virtual angles are as many and have opposites.
    dark
        (row, column) counts without the object; None where there are none.
    threshold
        Density, counts per mm of (binned) pixels, above which a voxel counts as cured.
    voxel_mm, filter_name, binning
        See `vialight.tomography.reconstruct.Settings`.
    grid
        The voxels wanted; by default `vialight.tomography.reconstruct.grid_of_view`.
    threads
        That share the work of `renew`.

    Raises
    ------
    InputError
        The rig lacks what imaging needs, or shapes and counts do not fit.
    """

    def __init__(
        self,
        rig: Rig,
        frame_shape: tuple[int, int],
        frames_per_turn: int,
        *,
        dark: NDArray[Any] | None,
        threshold: float,
        voxel_mm: float | None = None,
        filter_name: FilterName = DEFAULT_FILTER,
        binning: int = 1,
        grid: Grid | None = None,
        threads: int = 2,
    ) -> None:
        shape = _checked_shape(frame_shape, frames_per_turn, dark, binning)
        camera, optics = rig.need_camera().binned(binning), rig.imaging_optics()
        self.beam: ParallelBeam = beam_of(camera, optics, shape, frames_per_turn)
        self.grid: Grid = grid or grid_of_view(shape[0], camera, optics, self.beam, voxel_mm)
        psi = self.beam.psi_rad
        self.threshold = threshold
        self._direction, self._binning, self._frame_shape = rig.stage.direction, binning, frame_shape
        self._dark = None if dark is None else bin_frames(dark, binning)
        self._straight = straightening(camera, optics, rig.stage.run_out)
        centre = (0.0, 0.0) if self._straight is None else self._straight.centre_mm
        self._x_mm, self._y_mm = self.grid.x_mm - centre[0], self.grid.y_mm - centre[1]
        self._taps = ray_taps(shape, camera, optics, self.beam, self.grid.z_mm, SLICES_A_BLOCK)
        self._middle = len(self._taps.columns) // 2
        self._turn = LatestTurn(frames_per_turn)
        self._schedule = Schedule(psi, self._taps.directions_rad[self._middle], self._turn.step_rad)
        # Full turn: every ray is there twice, so half the angular step counts.
        scale = np.float32(np.pi / frames_per_turn)
        ramp = ramp_filter(filter_name, len(self.beam.virtual_x_mm), self.beam.spacing_mm)
        self._filter = padded_filter(ramp * scale)
        self._inside = _disk(self._x_mm, self._y_mm, field_radius_mm(self.beam, optics))
        self._workers = Workers(threads)
        self._frames_used = self._frames_new = 0
        self._allocate()

    def _allocate(self) -> None:
        depth, rays, angles = padded_depth(self.grid.shape[0]), len(self.beam.virtual_x_mm), len(self.beam.psi_rad)
        self._views = aligned_zeros((self._turn.capacity, rays, depth))
        self._sinogram = aligned_zeros((angles, rays, depth))
        self._states = np.zeros((len(self._taps.columns), angles, rays), np.uint8)
        self._folded = aligned_zeros((angles // 2, rays, depth))
        self._volume = aligned_zeros((*self.grid.shape[1:], depth))
        self._sums = self._counts = _no_sums(*self._volume.shape)

    def keep_in(self, memory: Float32Array) -> None:
        """Keep the volume in other memory from now on, which others may see.

        Parameters
        ----------
        memory
            (y, x, z) float32, in C order, z as deep as `vialight.core.compiling.padded_depth` says.
        """
        memory[...] = self._volume
        self._volume = memory

    @property
    def lags_rad(self) -> FloatArray:
        """How far the stage has gone past a virtual angle when it is brought into the volume: each time.

        With a vial on the axis, at half the field, and complete: the delay that refraction imposes, at the stage's
        speed.
        """
        return self._schedule.lags_rad.copy()

    @property
    def volume(self) -> Float32Array:
        """(z, y, x) density, counts per mm: a view that changes with `renew`, not to be written."""
        view = self._volume[:, :, : self.grid.shape[0]].transpose(2, 0, 1)
        view.flags.writeable = False
        return view

    @property
    def sinogram(self) -> Float32Array:
        """(psi, x_v, z) copy of all that is known of the rays; after ``renew(everything=True)`` the volume is of this.

        Where one of a ray and its opposite is known better, it stands for both.
        """
        opposite = np.roll(self._states, len(self.beam.psi_rad) // 2, axis=1)[:, :, ::-1] > self._states
        depth = self.grid.shape[0]
        by_slice = np.repeat(opposite, SLICES_A_BLOCK, axis=0)[:depth].transpose(1, 2, 0)
        known = self._sinogram[:, :, :depth]
        return np.where(by_slice, np.roll(known, len(known) // 2, axis=0)[:, ::-1], known)

    def add(self, counts: NDArray[Any], angle_rad: float) -> bool:
        """Take in a frame, in order of arrival: it may be late, out of order, or there already.

        Parameters
        ----------
        counts
            (row, column) as the camera has them.
        angle_rad
            The stage's angle, counting turns or not.

        Returns
        -------
        bool
            Whether it is used: not if it is more than a turn late, or between frames that are close enough.

        Raises
        ------
        InputError
            The frame has another shape, or its angle is not a number.
        """
        if counts.shape != self._frame_shape or not np.isfinite(angle_rad):
            raise InputError(
                "frame",
                f"has shape {counts.shape} and angle {angle_rad}",
                accepted=f"{self._frame_shape}, a finite angle",
            )
        angle_rad *= self._direction
        if self._straight is not None:
            angle_rad = float(self._straight.angles(np.array(angle_rad)))
        placing = self._turn.place(angle_rad)
        if placing is None:
            return False
        frame = bin_frames(counts, self._binning)
        frame = frame - self._dark if self._dark is not None else frame.copy()
        if self._straight is not None:
            frame = self._straight.frames(frame[None], 0, np.array([angle_rad]))[0]
        read_view(frame, self._taps, self._views[placing.slot])
        renew_rays(
            self._sinogram, self._states, self._schedule.touched, self._views, self._taps.directions_rad,
            SLICES_A_BLOCK, placing.angle_rad, placing.offsets_rad, placing.slots, self._turn.step_rad,
        )  # fmt: skip
        self._frames_used += 1
        self._frames_new += 1
        return True

    def renew(self, *, everything: bool = False) -> WindowState:
        """Bring into the volume what has come since the last time and is due.

        Parameters
        ----------
        everything
            Also what is not due yet, so that the volume is that of `sinogram`.
        """
        turn = self._turn
        due = self._schedule.take_due(turn.newest_rad, turn.sense, self._frames_new)
        rows = np.union1d(due, self._schedule.take_all()) if everything else due
        self._frames_new = 0
        if len(rows):
            self._bring_in(rows)
        return self._state()

    def _bring_in(self, rows: IntArray) -> None:
        changes = aligned_zeros((len(rows), self._filter.shape[1], self._folded.shape[2]))
        fold_changes(self._sinogram, self._states, SLICES_A_BLOCK, self._folded, rows, changes)
        self._sums, self._counts = add_projections(
            self._volume, filter_few(self._filter, changes, self._workers), self.beam.psi_rad[rows],
            float(self.beam.virtual_x_mm[0]), self.beam.spacing_mm, self._x_mm, self._y_mm,
            self._inside, self.threshold, self._workers,
        )  # fmt: skip

    def _state(self) -> WindowState:
        voxel = self.grid.voxel_mm
        incomplete, older, never = self.provisional_rays()
        seen = np.isfinite(self._taps.directions_rad[self._middle])
        seen |= seen[::-1]

        def share(rays: BoolArray) -> float:
            return float(np.count_nonzero(rays[:, seen]) / (len(rays) * np.count_nonzero(seen)))

        return WindowState(
            density=_pictures(self._sums, self.grid, voxel),
            cured=_pictures(self._counts, self.grid, voxel),
            cured_volume_mm3=float(self._counts.xy.sum(dtype=np.float64)) * voxel**3,
            provisional_share=share(incomplete | older | never),
            incomplete_share=share(incomplete),
            older_share=share(older),
            never_share=share(never),
            frames_used=self._frames_used,
            frames_in_turn=len(self._turn),
            newest_angle_rad=self._turn.newest_rad,
        )

    def provisional_rays(self) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Return, as (psi, x_v), which rays are incomplete, known only from an older turn, and never seen."""
        states = self._states[self._middle]
        best = np.maximum(states, np.roll(states, len(states) // 2, axis=0)[:, ::-1])
        passing = self._schedule.incomplete(self._turn.newest_rad, self._turn.sense)
        older, never = best == LOST, best == NEVER
        return np.asarray(passing[:, None] & ~(older | never)), older, never


def beam_of(camera: Camera, optics: Optics | None, frame_shape: tuple[int, int], frames_per_turn: int) -> ParallelBeam:
    """Return the rays of a window's sinogram."""
    psi = np.arange(frames_per_turn, dtype=np.float64) * (TURN_RAD / frames_per_turn)
    return parallel_beam(psi, frame_shape[1], camera, optics)


def compile_kernels() -> None:
    """Compile, or load from the cache, all that a window runs, so that a print's first frame need not wait for it."""
    camera = Camera(pixel_mm=1.0, axis_column=3.5, optical_row=1.5)
    made = SlidingWindow(Rig(geometry="parallel", camera=camera), (4, 8), 4, dark=None, threshold=1.0)
    made.add(np.ones((4, 8), np.uint16), 0.0)
    made.renew(everything=True)


def _checked_shape(
    shape: tuple[int, int], frames_per_turn: int, dark: NDArray[Any] | None, binning: int
) -> tuple[int, int]:
    """Return (rows, columns) of binned frames."""
    if binning < 1 or min(shape) < binning:
        raise InputError("--bin", f"is {binning} for {shape[0]} x {shape[1]} pixels", accepted="1 to the image's size")
    if frames_per_turn < 4 or frames_per_turn % 2:
        raise InputError("frames per turn", f"{frames_per_turn}", accepted="an even number, 4 or more")
    if dark is not None and dark.shape != shape:
        raise InputError("dark frame", f"has shape {dark.shape}", accepted=f"{shape}")
    return shape[0] // binning, shape[1] // binning


def _disk(x_mm: FloatArray, y_mm: FloatArray, radius_mm: float) -> tuple[IntArray, IntArray]:
    """Return, for each y, the first x within the radius and the one after the last."""
    outside = np.hypot(x_mm, y_mm[:, None]) > radius_mm
    inside = (~outside).sum(axis=1)
    begin = np.where(inside > 0, outside.argmin(axis=1), 0).astype(np.int64)
    return begin, begin + inside


def _no_sums(rows: int, columns: int, depth: int) -> AxisSums:
    return AxisSums(*(np.zeros(shape, np.float32) for shape in ((rows, columns), (columns, depth), (rows, depth))))


def _pictures(sums: AxisSums, grid: Grid, scale: float) -> Sums:
    depth, factor = grid.shape[0], np.float32(scale)
    return Sums(sums.xy * factor, sums.xz[:, :depth].T * factor, sums.yz[:, :depth].T * factor)
