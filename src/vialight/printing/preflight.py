"""What is checked before the first light, so that no print fails in its middle for what was known at its start."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.devices import Devices
from vialight.printing.recorder import room_for

_SATURATED = 0.98
"""Share of the full level from which a pixel counts as saturated."""
_SATURATED_SHARE = 1e-4
"""Of the pixels: a few hot ones are no fault."""


def check_rig(rig: Rig, image_shape: tuple[int, int]) -> None:
    """Refuse a rig that lacks what imaging and projecting need, or whose axis lies outside the camera's image.

    Raises
    ------
    InputError
        Says what is missing.
    """
    camera = rig.need_camera()
    rig.need_projector()
    rig.imaging_optics()
    rig.writing_optics()
    rig.need_threshold()
    if not 0 <= camera.axis_column <= image_shape[1] - 1:
        raise InputError(
            f"{rig.source} [camera]", f"axis_column {camera.axis_column} lies outside the camera's image",
            accepted=f"0 to {image_shape[1] - 1}", remedy="correct it, or the camera's binning",
        )  # fmt: skip


def check_exposure(image: NDArray[np.uint16], full_level: int) -> None:
    """Refuse a camera that is saturated before anything scatters.

    Raises
    ------
    InputError
        Says how many pixels are.
    """
    share = float((image >= _SATURATED * full_level).mean())
    if share > _SATURATED_SHARE:
        raise InputError(
            "camera", f"{100 * share:.3g} % of the pixels are saturated at {full_level} counts before the print",
            accepted=f"less than {100 * _SATURATED_SHARE:g} %", remedy="shorten the exposure or lower gain or light",
        )  # fmt: skip


def check_room(run: Path, image: NDArray[np.uint16], frames: int, others: int = 0) -> None:
    """Refuse a disk that cannot hold the longest print: frames, and bytes of all else that is kept.

    Raises
    ------
    InputError
        Says what is needed and what is free.
    """
    needed, free = room_for(run, image, frames)
    if free < needed + others:
        raise InputError(
            run, f"has {free / 1e9:.2f} GB free; {frames} frames may take {needed / 1e9:.2f} GB, volumes and all else "
            f"that is kept over time {others / 1e9:.2f} GB",
            remedy="free space, choose another disk, or --longest or --every-deg",
        )  # fmt: skip


def check_dark(devices: Devices) -> None:
    """Refuse a projector that is not black.

    Raises
    ------
    InputError
        It shows a pattern.
    """
    pattern = devices.projector.shown().pattern
    if pattern is not None:
        raise InputError("projector", f"shows pattern {pattern} before the print", accepted="black")
