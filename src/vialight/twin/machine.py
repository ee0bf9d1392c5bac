"""A printer that can be driven: show a pattern, let time pass, take a frame.

`Twin` only keeps time and state; all that happens is computed by the pure pieces of this folder.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.twin.camera import Imager, Scene, frames_of, imager_for, look_at, scene_of
from vialight.twin.chemistry import Cure, cure, fresh
from vialight.twin.exposure import add_dose, exposer_for
from vialight.twin.poses import Pose
from vialight.twin.presets import ResinModel
from vialight.twin.rays import points_on_disk
from vialight.twin.settings import TwinSettings
from vialight.twin.truth import gel_times, gelled_surface, height_map

_LARGEST_TURN_RAD = float(np.radians(1.0))
"""An object that turns further under one image is exposed in several poses."""


class Frame(NamedTuple):
    """What the camera hands over."""

    counts: NDArray[np.uint16]
    """(row, column)."""
    angle_rad: float
    """Stage angle as the rig counts it, at the recorded time."""
    time_s: float
    """Recorded time of the middle of the exposure."""


class Twin:
    """A printer with resin in it, at a point in time; `copy.deepcopy` branches it.

    Parameters
    ----------
    rig
        As the printer is, which need not be what the plan or the reconstruction believes; its resin is replaced.
    resin
        What is in the vial.
    grid
        Voxels in which the resin cures; what lies outside stays liquid.
    settings
        How closely to look.

    Attributes
    ----------
    time_s : float
        Since the start.
    dose_mj_per_cm2 : numpy.ndarray
        (y, x, z) float32, light received so far.
    state : Cure
        Oxygen, radicals and conversion.
    gel_time_s : numpy.ndarray
        (y, x, z) float32, NaN where it has not gelled.

    Raises
    ------
    InputError
        The rig lacks what the twin needs.

    Examples
    --------
    >>> from vialight.twin.presets import find_rig, load_resin
    >>> twin = Twin(find_rig("orth2022-190"), load_resin("DUDMA"), Grid((10, 20, 20), 0.4))
    >>> twin.show(np.full((200, 200), 255, np.uint8), (284, 412))
    >>> twin.advance(1.0)
    >>> twin.frame().counts.shape, twin.time_s
    ((120, 176), 1.0)
    """

    def __init__(self, rig: Rig, resin: ResinModel, grid: Grid, settings: TwinSettings | None = None) -> None:
        self.settings = settings = settings or TwinSettings()
        self.rig, self.resin, self.grid = resin.in_vial_of(rig), resin, grid
        projector = rig.need_projector()
        if projector.irradiance_mw_per_cm2 is None:
            raise InputError(
                f"{rig.source} [projector]", "has no irradiance_mw_per_cm2",
                accepted="that of level 255 in air, in the plane of the axis", remedy="add it",
            )  # fmt: skip
        self._mj_per_level_s = settings.faults.projector_gain * projector.irradiance_mw_per_cm2 / 255
        self._exposer = exposer_for(
            self.rig, float(np.abs(grid.z_mm).max()) + grid.voxel_mm, blur_mm=settings.blur_mm,
            pupil_mm=points_on_disk(settings.projector_pupil_points, settings.projector_pupil_radius_mm),
        )  # fmt: skip
        self._imager = self._imager_at(0.0)
        self._rng = np.random.default_rng(settings.seed)
        self._specks = settings.faults.specks_in(grid, self._rng)
        self.time_s = 0.0
        self.state: Cure = fresh(grid, resin.chemistry)
        self.dose_mj_per_cm2: Float32Array = np.zeros_like(self.state.conversion)
        self.gel_time_s: Float32Array = np.full_like(self.state.conversion, np.nan)
        self._cured_until_s = 0.0
        self._new_dose = np.zeros_like(self.state.conversion)
        self._seen_until_s = -1.0
        self._seen: Scene | None = None
        self._image: NDArray[np.uint8] | None = None
        self._corner = (0, 0)
        self._lit_since_s = 0.0
        self._waiting: list[tuple[NDArray[np.uint8], Pose, float]] = []

    @property
    def image_shape(self) -> tuple[int, int]:
        """(rows, columns) of a frame."""
        return self._imager.shape

    def show(self, image: NDArray[np.uint8] | None, corner: tuple[int, int] = (0, 0)) -> None:
        """Show an image from now on.

        Parameters
        ----------
        image
            (row, column) levels, not to be changed afterwards; None turns the light off.
        corner
            Row and column of its first pixel in the projector's image.
        """
        if image is self._image and corner == self._corner:
            return
        self._expose()
        if corner != self._corner or (self._waiting and image is not None and image.shape != self._waiting[0][0].shape):
            self._gather()
        self._image, self._corner = image, corner

    def advance(self, duration_s: float) -> None:
        """Let time pass: the vial turns, light is received, the resin cures."""
        end = self.time_s + duration_s
        while self.time_s < end - 1e-9:
            step_end = self._cured_until_s + self.settings.chemistry_step_s
            self.time_s = min(end, step_end)
            if self.time_s - self._lit_since_s >= self._longest_pose_s or self.time_s >= step_end - 1e-9:
                self._expose()
            if self.time_s >= step_end - 1e-9:
                self._cure()

    def harden(self, share: Float32Array) -> None:
        """Put a part into the vial: (z, y, x) share of each voxel that lies in it, so that its surface is gelled."""
        conversion = 2 * self.resin.chemistry.gel_conversion * share.transpose(1, 2, 0)
        self.state = replace(self.state, conversion=np.ascontiguousarray(conversion, np.float32))
        self._seen_until_s = -1.0

    def true_angle_rad(self, time_s: float | None = None) -> float:
        """Return by how much the object has turned, counter-clockwise seen from above; now, or at a time."""
        speed = self.rig.stage.direction * np.radians(self.rig.stage.speed_deg_s)
        return self.settings.faults.angle(self.time_s if time_s is None else time_s, speed)

    def frame(self, *, of_the_empty_vial: bool = False) -> Frame | None:
        """Take a frame, in the middle of its exposure now; None where it is dropped.

        Parameters
        ----------
        of_the_empty_vial
            A dark frame: only stray light and noise.
        """
        settings, faults = self.settings, self.settings.faults
        # One place of the vial a frame: it goes less than a hundredth of its run-out in an exposure.
        imager = self._imager_at(self.true_angle_rad()) if faults.run_out_mm else self._imager
        expected = settings.stray.image(imager)
        if not of_the_empty_vial:
            if self._rng.uniform() < faults.dropped_share:
                return None
            offsets = (np.arange(settings.poses_a_frame) + 0.5) / settings.poses_a_frame - 0.5
            angles = [self.true_angle_rad(self.time_s + share * settings.exposure_s) for share in offsets]
            seen = look_at(self._scene(), imager, [faults.pose_in_vial(angle) for angle in angles])
            expected = (seen.mean(axis=0) + expected) * (1 + faults.led_drift_per_s * self.time_s)
        counts = settings.sensor.photograph(np.maximum(expected, 0), self._rng, binning=settings.binning)
        recorded_s = self.time_s + (self._rng.normal(0, faults.timestamp_jitter_s) if faults.timestamp_jitter_s else 0)
        return Frame(counts, self.rig.stage.direction * self.true_angle_rad(recorded_s), recorded_s)

    def fluorescence(self, counts_per_mm_of_white: float, *, lab_voxel_mm: float = 0.2) -> NDArray[np.uint16]:
        """Take a frame, without the camera's filter, of the glow that the shown image makes in the resin.

        Parameters
        ----------
        counts_per_mm_of_white
            Glow of level 255 where it has lost nothing; it fades as the light is absorbed.
        lab_voxel_mm
            Of the grid, at rest in the lab, in which the glow is computed.
        """
        reach = self._exposer.fields[0].reach_mm
        across, high = 2 * int(reach / lab_voxel_mm), 2 * int(np.abs(self.grid.z_mm).max() / lab_voxel_mm + 1)
        lab = Grid((high, across, across), lab_voxel_mm, self.grid.centre_z_mm)
        glow = np.zeros((across, across, high), np.float32)
        if self._image is not None:
            each = np.array([counts_per_mm_of_white / 255 * self.settings.faults.projector_gain])
            add_dose(
                glow, self._exposer, self._image[None], self._shifted_corner(), np.array([0]), [Pose(0.0)], each, lab
            )
        still = imager_for(self.rig, self.settings.image_shape, binning=self.settings.binning)
        expected = frames_of(glow, lab, still, [Pose(0.0)])[0] + self.settings.stray.image(still)
        return self.settings.sensor.photograph(expected, self._rng, binning=self.settings.binning)

    def density(self) -> Float32Array:
        """Return what scatters now, (y, x, z) counts per mm."""
        density = self.resin.scattering.density(self.state.conversion)
        return density if self._specks is None else density + self._specks

    def surface(self) -> Mesh:
        """Return the gelled surface; InputError where nothing has gelled."""
        chemistry = self.resin.chemistry
        return gelled_surface(self.state.conversion, self.grid, chemistry.gel_conversion, shrinkage=self._shrinkage())

    def height_map(
        self, *, pixel_mm: float = 0.05, set_down_at_mm: tuple[float, float] = (0.0, 0.0)
    ) -> NDArray[np.float64]:
        """Return what a profilometer measures of the washed part, see `vialight.twin.truth.height_map`."""
        return height_map(
            self.state.conversion, self._shrunk_grid(), self.resin.chemistry.gel_conversion, pixel_mm=pixel_mm,
            set_down_at_mm=set_down_at_mm,
        )  # fmt: skip

    @property
    def gelled_volume_mm3(self) -> float:
        """Volume of the voxels that have gelled, before shrinkage."""
        return float(np.isfinite(self.gel_time_s).sum() * self.grid.voxel_mm**3)

    @property
    def volume_to_gel_mm3(self) -> float:
        """Volume that will have gelled when the last radicals are trapped, if the light goes off now."""
        chemistry = self.resin.chemistry
        reach = np.float32(chemistry.propagation_m3_per_mol_s / chemistry.radical_decay_per_s)
        coming = 1 - (1 - self.state.conversion) * np.exp(-reach * self.state.radicals)
        return float((coming >= chemistry.gel_conversion).sum() * self.grid.voxel_mm**3)

    def _imager_at(self, angle_rad: float) -> Imager:
        """Return the camera as it sees the vial when the stage has turned by an angle."""
        settings = self.settings
        return imager_for(
            self.rig, settings.image_shape, binning=settings.binning, rays_a_side=settings.rays_a_side,
            pupil_mm=points_on_disk(settings.pupil_points, settings.pupil_radius_mm), focus_mm=settings.focus_mm,
            vial=settings.faults.vial(angle_rad),
        )  # fmt: skip

    @property
    def _longest_pose_s(self) -> float:
        return float(_LARGEST_TURN_RAD / np.radians(self.rig.stage.speed_deg_s))

    def _scene(self) -> Scene | None:
        """Return what the camera looks at, which changes with the cure only."""
        if self._seen_until_s != self._cured_until_s:
            settings = self.settings
            self._seen = scene_of(
                self.density(), self._shrunk_grid(), resin_index=self._imager.optics.resin_index,
                extinction_mm2=settings.extinction_mm2,
                index_rise=np.float32(settings.index_rise) * self.state.conversion if settings.index_rise else None,
            )  # fmt: skip
            self._seen_until_s = self._cured_until_s
        return self._seen

    def _shrinkage(self) -> float:
        if self.resin.chemistry.linear_shrinkage == 0:
            return 0.0
        gelled = self.state.conversion[np.isfinite(self.gel_time_s)]
        return self.resin.chemistry.linear_shrinkage * float(gelled.mean()) if gelled.size else 0.0

    def _shrunk_grid(self) -> Grid:
        return Grid(self.grid.shape, self.grid.voxel_mm * (1 - self._shrinkage()), self.grid.centre_z_mm)

    def _shifted_corner(self) -> tuple[float, float]:
        right, down = self.settings.faults.projector_shift_pixels
        return self._corner[0] + down, self._corner[1] + right

    def _expose(self) -> None:
        """Note that the image has been shown until now."""
        duration = self.time_s - self._lit_since_s
        if self._image is not None and duration > 0:
            pose = self.settings.faults.pose(self.true_angle_rad((self.time_s + self._lit_since_s) / 2))
            self._waiting.append((self._image, pose, duration * self._mj_per_level_s))
        self._lit_since_s = self.time_s

    def _gather(self) -> None:
        """Bring what has been shown to the voxels."""
        if not self._waiting:
            return
        images, poses, shares = zip(*self._waiting, strict=True)
        self._waiting = []
        different = {id(image): image for image in images}
        place = {key: index for index, key in enumerate(different)}
        add_dose(
            self._new_dose, self._exposer, np.stack(list(different.values())), self._shifted_corner(),
            np.array([place[id(image)] for image in images]), poses, np.array(shares), self.grid,
            self.settings.points_a_voxel,
        )  # fmt: skip

    def _cure(self) -> None:
        """Let the light since the last time act."""
        self._gather()
        duration = self.time_s - self._cured_until_s
        before = self.state.conversion
        chemistry, mu = self.resin.chemistry, self.resin.absorption_per_mm
        self.state = cure(self.state, self._new_dose, duration, chemistry, mu, self.grid.voxel_mm)
        self.gel_time_s = gel_times(
            before, self.state.conversion, self._cured_until_s, duration, chemistry.gel_conversion, self.gel_time_s
        )
        self.dose_mj_per_cm2 += self._new_dose
        self._new_dose[...] = 0
        self._cured_until_s = self.time_s
