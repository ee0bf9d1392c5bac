"""One turn of a recording, read and checked for calibration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vialight.calibration.figures import frame_png
from vialight.calibration.usable_frames import check_something_cured, check_turn, check_unsaturated, rows_to_compare
from vialight.calibration.writing import shown_where_refused
from vialight.calibration.zero import Turned, turned_since
from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.store import open_frames
from vialight.tomography.reconstruct import Scan, Settings, open_scan
from vialight.tomography.sinogram import bin_frames, count_turns, select_turn
from vialight.tomography.sinogram.turns import sorted_turn

MOST_TURNS = 8
"""That the angle zero is followed over."""

MOST_COLUMNS = 640
"""Wider images are binned first: a few hundredths of a column need no more."""


@dataclass(frozen=True)
class CalibrationTurn:
    """One turn, as calibrations take it.

    Parameters
    ----------
    scan
        The turn, binned, with nothing straightened.
    rows
        Those compared.
    counts
        (frame, row, column) above the background, of these rows.
    angles_rad
        (frame,) as the file has them.
    profiles
        (frame, column) as recorded, mean over these rows.
    frame
        (row, column) the first frame, as recorded.
    """

    scan: Scan
    rows: slice
    counts: Float32Array
    angles_rad: FloatArray
    profiles: FloatArray
    frame: Float32Array

    def column_of(self, binned: float) -> float:
        """Return a column of the recording."""
        return (binned + 0.5) * self.scan.binning - 0.5

    def zero_by_turn(self) -> list[tuple[int, Turned]]:
        """Return, for the last turns in which something had cured, by how much the part had turned on since the last.

        Each with its number, from 1; what was compared is that turn and the one before.
        """
        scan = self.scan
        every = scan.frames.angles_rad
        last = count_turns(every)
        found, before = [], None
        for turn in range(max(1, last - MOST_TURNS), last + 1):
            chosen = select_turn(every, turn)
            order, angles = sorted_turn(every[chosen])
            later = replace(scan, chosen=chosen[order], angles_rad=angles).as_recorded(self.rows)
            try:
                check_turn(angles)
                check_something_cured(later, "")
            except InputError:
                before = None
                continue
            if before is not None:
                found.append((turn, turned_since(*before, later, angles)))
            before = (later, angles)
        return found


@contextmanager
def calibration_turn(frames_path: str | Path, rig: Rig, out: str | Path, turn: int | None) -> Iterator[CalibrationTurn]:
    """Read a turn, and let what cannot be used leave a picture.

    Parameters
    ----------
    frames_path
        Data Exchange HDF5.
    rig
        To start from.
    out
        The new rig, whose ``.refused.png`` shows what was refused.
    turn
        See `vialight.tomography.reconstruct.Settings`.

    Raises
    ------
    InputError
        The frames cannot be used.
    """
    upright = rig.need_camera().model_copy(update={"axis_tilt_deg": None})
    plain = rig.model_copy(
        update={"camera": upright, "stage": rig.stage.model_copy(update={"run_out": None, "direction": 1})}
    )
    with open_frames(frames_path) as frames:
        binning = 1
        while frames.shape[2] / binning > MOST_COLUMNS:
            binning *= 2
        scan = open_scan(frames, plain, Settings(binning=binning, turn=turn))
        first = bin_frames(frames.read(scan.chosen[:1]), binning)[0]
        with shown_where_refused(out, lambda: frame_png(first, scan.camera, scan.optics)):
            check_turn(scan.angles_rad)
            few = scan.chosen[:: max(1, len(scan.chosen) // 20)]
            check_unsaturated(frames.read(few), frames_path)
            whole = scan.as_recorded(slice(0, scan.shape[0]))
            check_something_cured(whole, frames_path)
            rows = rows_to_compare(np.asarray(whole.mean(axis=(0, 2)), np.float64), scan.camera, scan.optics)
            raw = bin_frames(frames.read(scan.chosen, slice(rows.start * binning, rows.stop * binning)), binning)
            # Of frames at one angle the last stays, as in a reconstruction.
            kept = np.sort(sorted_turn(scan.angles_rad)[0])
            yield CalibrationTurn(
                scan, rows, whole[kept][:, rows], scan.angles_rad[kept], raw[kept].mean(axis=1, dtype=np.float64), first
            )
