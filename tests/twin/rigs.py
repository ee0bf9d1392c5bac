"""Rigs and patterns that the twin's tests share."""

from __future__ import annotations

import numpy as np

from vialight.core.config import Projector, Resin, Rig, Vial
from vialight.core.plan import Patterns

PIXEL_MM = 0.065


def printer(absorption_per_mm: float = 0.08, *, distance_mm: float = 119.8, azimuth_deg: float = -90.0) -> Rig:
    """The paper's projector and vial, with DUDMA."""
    return Rig(
        vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472),
        resin=Resin(index_imaging=1.48, index_writing=1.49, absorption_per_mm=absorption_per_mm),
        projector=Projector(
            distance_mm=distance_mm, pixel_mm=PIXEL_MM, columns=1024, rows=768, axis_column=511.5,
            azimuth_deg=azimuth_deg,
        ),
    )  # fmt: skip


def printer_without_glass(absorption_per_mm: float) -> Rig:
    """A telecentric projector and a vial that refracts nothing."""
    return printer(absorption_per_mm, distance_mm=float("inf")).model_copy(
        update={
            "vial": Vial(outer_radius_mm=12.4, wall_mm=0.0),
            "resin": Resin(index_imaging=1.0, index_writing=1.0, absorption_per_mm=absorption_per_mm),
        }
    )


def patterns_of(
    images: np.ndarray, dose_rate_per_level: float = 1.0, *, centre: tuple[int, int] = (384, 512)
) -> Patterns:
    """Patterns, evenly over a turn, whose middle lies at a (row, column) of the projector's image."""
    count, rows, columns = images.shape
    angles = np.arange(count) * 2 * np.pi / count
    return Patterns(
        images.astype(np.uint8), angles, centre[0] - rows // 2, centre[1] - columns // 2, dose_rate_per_level
    )
