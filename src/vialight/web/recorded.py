"""What camera and projector saw and showed at a moment that is over, as the run has recorded it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from vialight.core.errors import InputError
from vialight.core.messages import CameraImage
from vialight.store import open_frames


def recorded_image(folder: Path, number: int) -> CameraImage:
    """Return a frame of a recording, also of one that grows.

    Parameters
    ----------
    folder
        The run's.
    number
        Of the frame, from 0.

    Raises
    ------
    InputError
        There is no such frame, or the recording cannot be read.
    """
    with open_frames(folder / "frames.h5") as frames:
        if not 0 <= number < frames.shape[0]:
            raise InputError("frames.h5", f"has no frame {number}", accepted=f"0 to {frames.shape[0] - 1}")
        counts = frames.read(slice(number, number + 1))[0]
        time_s = 0.0 if frames.time_s is None else float(frames.time_s[number])
        return CameraImage(number, counts, time_s, float(np.rad2deg(frames.angles_rad[number])))


def pattern_shown(folder: Path, time_s: float) -> int | None:
    """Return the pattern that the projector's log says was shown at a time of the print; None where it was black.

    Raises
    ------
    InputError
        The run holds no such log, or it cannot be read.
    """
    shown = -1
    try:
        with (folder / "projector.csv").open(newline="") as file:
            for change in csv.DictReader(file):
                if not change["shown_s"] or change["shown"] is None:  # a refresh that was missed; a line half-written
                    continue
                if float(change["shown_s"]) > time_s:
                    break
                shown = int(change["shown"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError("projector.csv", "is not there, or cannot be read") from error
    return None if shown < 0 else shown
