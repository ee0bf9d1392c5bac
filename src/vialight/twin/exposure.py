"""Light in: what patterns bring to the turning resin.

Every pixel of the projector sends power in proportion to its level and its area; refraction and absorption share it
out over the rays' course (`LightField`), and each place of the object gathers, for every angle of the stage, from the
point of the image that lights it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.config import Optics, Rig
from vialight.core.errors import InputError
from vialight.core.plan import Patterns
from vialight.twin.gathering import gather
from vialight.twin.lightfield import LightField, light_field
from vialight.twin.poses import Pose

_PATTERNS_A_BLOCK = 32
_BORDER = 2
"""Black pixels round a pattern, so that interpolation ends in darkness."""


@dataclass(frozen=True)
class Exposer:
    """A projector lighting a vial, made ready to expose.

    Parameters
    ----------
    fields
        One for each point of the projector's pupil, of equal weight.
    pixel_mm, axis_column, optical_row
        Of the projector.
    azimuth_rad
        Of the projector.
    blur_mm
        Standard deviation of the projector's point spread in air, in the plane of the axis.
    """

    fields: tuple[LightField, ...]
    pixel_mm: float
    axis_column: float
    optical_row: float
    azimuth_rad: float
    blur_mm: float = 0.0


def exposer_for(
    rig: Rig,
    height_mm: float,
    *,
    blur_mm: float = 0.0,
    pupil_mm: Sequence[tuple[float, float]] | FloatArray = ((0.0, 0.0),),
    focus_mm: float = 0.0,
) -> Exposer:
    """Trace a rig's projector.

    Parameters
    ----------
    rig
        With vial, projector, and the resin's index and absorption at the writing wavelength.
    height_mm
        Largest ``|z|`` that will be exposed.
    blur_mm
        See `Exposer`.
    pupil_mm, focus_mm
        Points of the pupil, see `vialight.twin.rays.points_on_disk`; a pinhole by default.

    Raises
    ------
    InputError
        The rig lacks what printing needs.
    """
    optics, camera = writing_optics(rig), rig.need_projector().as_camera()
    if rig.resin.absorption_per_mm is None:
        raise InputError(
            f"{rig.source} [resin]", "has no absorption_per_mm", accepted="mu at 460 nm, per mm", remedy="add it"
        )
    fields = tuple(
        light_field(
            optics, rig.resin.absorption_per_mm, height_mm=height_mm, pupil=(float(right), float(up)),
            focus_mm=focus_mm,
        )
        for right, up in pupil_mm
    )  # fmt: skip
    azimuth = float(np.radians(rig.need_projector().azimuth_deg))
    return Exposer(fields, camera.pixel_mm, camera.axis_column, camera.optical_row, azimuth, blur_mm)


def writing_optics(rig: Rig) -> Optics:
    """Return what the projector's rays pass through, or say that the twin needs a vial."""
    optics = rig.writing_optics()
    if optics is None:
        raise InputError(
            rig.source, 'geometry is "parallel"', accepted="a rig with a vial", remedy="the twin prints in vials only"
        )
    return optics


def dose_of(
    patterns: Patterns,
    rig: Rig,
    grid: Grid,
    *,
    turns: float = 1.0,
    angles_a_pattern: int = 1,
    points_a_voxel: tuple[int, int, int] = (1, 1, 1),
    blur_mm: float = 0.0,
) -> Float32Array:
    """Compute the dose that whole turns of a plan's patterns bring.

    Parameters
    ----------
    patterns
        What is shown, each while the stage is nearest to its angle.
    rig
        Printer and resin as they are, which need not be those of the plan.
    grid
        The voxels, object frame.
    turns
        How often each pattern is shown.
    angles_a_pattern
        Stage angles at which each pattern is evaluated while the stage moves on under it.
    points_a_voxel
        (z, y, x) points over which a voxel's dose is averaged.
    blur_mm
        See `Exposer`.

    Returns
    -------
    numpy.ndarray
        (z, y, x) float32, in the plan's unit: 1 is the dose meant in the part after one turn.  It is the light that
        passes, across the ray, per area; what the resin takes out of it per volume is this times its absorption.  0
        outside `SHARE_OF_FIELD` of the field.

    Raises
    ------
    InputError
        The rig lacks what printing needs.
    """
    exposer = exposer_for(rig, float(np.abs(grid.z_mm).max()) + grid.voxel_mm, blur_mm=blur_mm)
    within = (np.arange(angles_a_pattern) - (angles_a_pattern - 1) / 2) * patterns.step_rad / angles_a_pattern
    dose = np.zeros((grid.shape[1], grid.shape[2], grid.shape[0]), np.float32)
    for start in range(0, len(patterns.levels), _PATTERNS_A_BLOCK):
        block = slice(start, start + _PATTERNS_A_BLOCK)
        images = patterns.levels[block]
        angles = patterns.angles_rad[block, None] + within
        poses = [Pose(float(angle)) for angle in angles.ravel()]
        shown = np.repeat(np.arange(len(images)), angles_a_pattern)
        share = patterns.dose_rate_per_level * patterns.step_rad * turns / angles_a_pattern
        corner = (patterns.first_row, patterns.first_column)
        add_dose(dose, exposer, images, corner, shown, poses, np.full(len(poses), share), grid, points_a_voxel)
    return np.ascontiguousarray(np.moveaxis(dose, 2, 0))


def add_dose(
    dose: Float32Array,
    exposer: Exposer,
    images: NDArray[np.uint8],
    corner: tuple[float, float],
    shown: NDArray[np.int64],
    poses: Sequence[Pose],
    shares: FloatArray,
    grid: Grid,
    points_a_voxel: tuple[int, int, int] = (1, 1, 1),
) -> None:
    """Add what a few images bring to an object that stands in as many poses.

    Parameters
    ----------
    dose
        (y, x, z) float32, changed in place.
    exposer
        The projector.
    images
        (image, row, column) levels.
    corner
        Row and column of the images' first pixel in the projector's image; need not be whole.
    shown
        (pose,) the image shown in each pose.
    poses
        Of the object.
    shares
        (pose,) dose per level.
    grid
        Of `dose`.
    points_a_voxel
        See `dose_of`.
    """
    light = _as_light(images, exposer.blur_mm / exposer.pixel_mm)
    stood = np.array([pose.seen_from(exposer.azimuth_rad) for pose in poses])
    subs = _points_in_voxel(points_a_voxel, grid.voxel_mm)
    border = (light.shape[2] - images.shape[1]) // 2
    scale = np.array([
        1 / exposer.pixel_mm, exposer.axis_column - corner[1] + border, exposer.optical_row - corner[0] + border,
    ])  # fmt: skip
    each = shares.astype(np.float64) / (len(subs) * len(exposer.fields))
    for field in exposer.fields:
        gather(
            light, shown, stood, each, scale, field.coefficients, field.lattice_mm, field.reach_mm,
            grid.x_mm, grid.y_mm, grid.z_mm.astype(np.float32), subs, dose,
        )  # fmt: skip


def _as_light(images: NDArray[np.uint8], blur_pixels: float) -> Float32Array:
    """Return (image, column, row) float32, blurred, with a black border as wide as the blur needs."""
    border = _BORDER + int(np.ceil(4 * blur_pixels))
    light = np.pad(images, ((0, 0), (border, border), (border, border))).astype(np.float32)
    light = np.ascontiguousarray(light.transpose(0, 2, 1))
    if blur_pixels > 0:
        for axis in (1, 2):
            light = gaussian_filter1d(light, blur_pixels, axis=axis, mode="constant")
    return light


def _points_in_voxel(points: tuple[int, int, int], voxel_mm: float) -> FloatArray:
    z, y, x = ((np.arange(count) - (count - 1) / 2) * voxel_mm / count for count in points)
    return np.stack([axis.ravel() for axis in np.meshgrid(z, y, x, indexing="ij")], axis=1)
