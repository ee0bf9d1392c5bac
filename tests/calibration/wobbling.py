"""Recordings of a part in a vial whose axis is not the stage's, by the twin's camera."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_parts import soft_density
from vialight.calibration.axis.estimator import AxisFit, find_axis
from vialight.calibration.usable_frames import rows_to_compare
from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.config import Camera, Resin, Rig, Vial
from vialight.twin import Faults
from vialight.twin.camera import imager_for, look_at, scene_of
from vialight.twin.sensor import Sensor, StrayLight

RIG = Rig(
    vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472),
    resin=Resin(index_imaging=1.48),
    camera=Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=87.3, optical_row=19.5),
)
SHAPE = (40, 176)
FRAMES = 180
PIXEL_MM = 0.155
AXIS_COLUMN = 87.3 + 0.3 / PIXEL_MM
"""Where the axis is in the recording with faults: 0.3 mm to the right."""


Posts = tuple[tuple[float, float, float], ...]

THREE: Posts = ((3.0, 1.5, 1.3), (-3.2, -2.8, 0.8), (-2.0, 3.5, 1.0))
"""x, y and radius of posts within 5 mm of the axis."""

WIDE: Posts = ((6.0, 1.5, 1.0), (-5.0, -4.2, 0.8), (-2.0, 3.5, 1.0), (1.0, -6.2, 0.7), (2.0, 0.5, 0.6))
"""Out to 7.3 mm of the 8.4 mm that can be seen."""


def part(x: Any, y: Any, z: Any, posts: Posts = THREE) -> Any:
    """Signed distance to posts off the axis, which nothing maps onto themselves."""
    beside = functools.reduce(np.minimum, (np.hypot(x - a, y - b) - r for a, b, r in posts))
    beyond = np.abs(z) - 2.2
    return np.minimum(np.maximum(beside, beyond), 0) + np.hypot(np.maximum(beside, 0), np.maximum(beyond, 0))


def rig_with(radius: float, index: float, distance: float, wall: float, wall_index: float, pixel: float) -> Rig:
    """Return `RIG` with other values, mm, of all that bends rays."""
    camera = RIG.need_camera().model_copy(update={"distance_mm": distance, "pixel_mm": pixel})
    vial = Vial(outer_radius_mm=radius, wall_mm=wall, wall_index=wall_index)
    return RIG.model_copy(update={"vial": vial, "resin": Resin(index_imaging=index), "camera": camera})


class Recorded(NamedTuple):
    """A turn, without noise."""

    part: Float32Array
    stray: Float32Array
    angles_rad: FloatArray

    def counts(self, seed: int) -> NDArray[np.uint16]:
        """Draw (frame, row, column) counts, background and all."""
        return Sensor().photograph(self.part + self.stray, np.random.default_rng(seed))

    def dark(self, seed: int) -> NDArray[np.uint16]:
        """Draw (8, row, column) counts without the part."""
        still = np.broadcast_to(self.stray[0], (8, *self.stray[0].shape))
        return Sensor().photograph(still, np.random.default_rng(1000 + seed))


def recorded(
    faults: Faults, *, voxel_mm: float = 0.1, rig: Rig = RIG, frames: int = FRAMES, posts: Posts = THREE
) -> Recorded:
    """Turn the part before the twin's camera, with faults."""
    across = int((11 if posts is THREE else 16) / voxel_mm)
    grid = Grid((int(5.2 / voxel_mm), across, across), voxel_mm)
    scene = scene_of(soft_density(functools.partial(part, posts=posts), grid), grid)
    angles = np.arange(frames, dtype=np.float64) * (2 * np.pi / frames)
    seen, stray = [], []
    imager = imager_for(rig, SHAPE, vial=faults.vial(0.0))
    for angle in angles:
        if faults.run_out_mm:
            imager = imager_for(rig, SHAPE, vial=faults.vial(float(angle)))
        seen.append(look_at(scene, imager, [faults.pose_in_vial(float(angle))])[0])
        stray.append(StrayLight().image(imager))
    return Recorded(np.array(seen), np.array(stray, dtype=np.float32), angles)


def axis_found(
    recording: Recorded, *, off: float = 0.0, sense: int = 1, seed: int = 0, edges: bool = True, rig: Rig = RIG
) -> AxisFit:
    """Find the axis from a rig that is some columns off `AXIS_COLUMN`, in a stage that turns either way."""
    camera, optics = rig.need_camera().model_copy(update={"axis_column": AXIS_COLUMN + off}), rig.imaging_optics()
    raw = recording.counts(seed).astype(np.float32)
    counts = raw - recording.dark(seed).mean(axis=0, dtype=np.float32)
    rows = rows_to_compare(counts.mean(axis=(0, 2), dtype=np.float64), camera, optics)
    return find_axis(
        counts[:, rows], rows.start, sense * recording.angles_rad, camera, optics,
        profiles=raw.mean(axis=1, dtype=np.float64) if edges else None,
    )  # fmt: skip
