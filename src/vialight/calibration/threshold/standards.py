"""Standards: recordings of prints whose size is known from elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vialight.calibration.threshold.circles import Circle
from vialight.calibration.threshold.height_maps import circle_in_heights
from vialight.calibration.usable_frames import check_unsaturated
from vialight.calibration.writing import shown_where_refused
from vialight.core.arrays import Volume
from vialight.core.config import Rig, ThresholdConditions
from vialight.core.errors import InputError
from vialight.store import open_frames, read_heights
from vialight.tomography.reconstruct import Progress, Settings, open_scan, reconstruct

_LOOKED_AT = 20
"""Frames in which saturated pixels are looked for."""


@dataclass(frozen=True)
class Standard:
    """A recording and what the print is known to be.

    Parameters
    ----------
    frames
        Data Exchange HDF5.
    known
        A height map of the cylinder's top, or a mesh of the print's surface.
    """

    frames: Path
    known: Path


@dataclass(frozen=True)
class StandardOptions:
    """How to look at standards.

    Parameters
    ----------
    profile_pixel_mm
        Pitch of the height maps' pixels.
    settings
        Of the reconstruction.
    stated
        Conditions that neither recordings nor rig say.
    """

    profile_pixel_mm: float | None = None
    settings: Settings = Settings()  # noqa: RUF009  frozen
    stated: ThresholdConditions = ThresholdConditions()  # noqa: RUF009  frozen


def profile_circle(
    path: Path, options: StandardOptions, out: str | Path
) -> tuple[Circle, Callable[[Circle | None], bytes]]:
    """Return the rim in a height map, and what draws both; leave a picture where there is none."""
    from vialight.calibration.threshold.figures import heights_png

    pixel_mm = options.profile_pixel_mm
    if pixel_mm is None or not (np.isfinite(pixel_mm) and pixel_mm > 0):
        raise InputError(
            "--profile-pixel-mm", "is not given" if pixel_mm is None else f"is {pixel_mm}",
            accepted="the pitch of the height map's pixels", remedy="see the profilometer's export",
        )  # fmt: skip
    heights = read_heights(path)
    with shown_where_refused(out, lambda: heights_png(heights, pixel_mm)):
        circle = circle_in_heights(heights, pixel_mm, path)
    return circle, lambda found: heights_png(heights, pixel_mm, found)


def reconstructed(
    frames_path: Path, rig: Rig, options: StandardOptions, out: str | Path, progress: Progress | None
) -> tuple[Volume, ThresholdConditions]:
    """Reconstruct a recording; return with it the conditions that it was taken under; leave a picture of a bad one."""
    from vialight.calibration.figures import frame_png

    with open_frames(frames_path) as frames:
        first = frames.read(slice(0, 1))[0]
        with shown_where_refused(out, lambda: frame_png(first, rig.need_camera(), rig.imaging_optics())):
            scan = open_scan(frames, rig, options.settings)
            check_unsaturated(frames.read(scan.chosen[:: max(1, len(scan.chosen) // _LOOKED_AT)]), frames_path)
            volume = reconstruct(scan, options.settings, progress=progress)
        recorded = options.stated.model_dump(exclude_none=True) | dict(frames.settings)
    return volume, rig.imaged_under(recorded, options.settings.binning)


def pixel_std_share(rig: Rig) -> float:
    """Return the uncertainty of the camera's pixel, as a share of it: of every length in the volume."""
    known = rig.uncertainty.camera if rig.uncertainty is not None else None
    return (known or {}).get("pixel_mm", 0.0) / rig.need_camera().pixel_mm
