"""How closely the twin looks, and what it adds to the ideal."""

from __future__ import annotations

from dataclasses import dataclass

from vialight.twin.faults import Faults
from vialight.twin.sensor import Sensor, StrayLight


@dataclass(frozen=True)
class TwinSettings:
    """How closely to look, and what to add.

    Parameters
    ----------
    chemistry_step_s
        Between updates of the cure, and so of what the camera sees.
    blur_mm
        Standard deviation of the projector's point spread, in air, in the plane of the axis; assumed.
    points_a_voxel
        (z, y, x) points at which the dose is evaluated.
    binning, rays_a_side, image_shape
        Of the camera, see `vialight.twin.camera.imager_for`.
    exposure_s, poses_a_frame
        Of the camera; 1 pose freezes the motion, more blur it.
    pupil_radius_mm, pupil_points, focus_mm
        Of the camera's aperture; 1 point is a pinhole.
    projector_pupil_radius_mm, projector_pupil_points
        Of the projector's aperture, focused on the axis in air.
    extinction_mm2
        See `vialight.twin.camera.frames_of`.
    index_rise
        By which the resin's index would be higher at full conversion: bends the camera's rays; 0 leaves them straight.
    stray, sensor, faults
        What is added to the ideal.
    seed
        Of all that is random.
    """

    chemistry_step_s: float = 1.0
    blur_mm: float = 0.05
    points_a_voxel: tuple[int, int, int] = (1, 1, 1)
    binning: int = 1
    rays_a_side: int = 1
    image_shape: tuple[int, int] | None = None
    exposure_s: float = 0.02
    poses_a_frame: int = 1
    pupil_radius_mm: float = 0.0
    pupil_points: int = 1
    focus_mm: float = 0.0
    projector_pupil_radius_mm: float = 0.0
    projector_pupil_points: int = 1
    extinction_mm2: float = 0.0
    index_rise: float = 0.0
    stray: StrayLight = StrayLight()  # noqa: RUF009  frozen
    sensor: Sensor = Sensor()  # noqa: RUF009  frozen
    faults: Faults = Faults()  # noqa: RUF009  frozen
    seed: int = 0
