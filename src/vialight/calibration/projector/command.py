"""Calibrate the projector by the glow of lines that it sweeps through the resin."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vialight.calibration.findings import Finding, Findings
from vialight.calibration.projector.estimator import ProjectorFit, Sweep, fit_projector, line_columns
from vialight.calibration.projector.sweeping import SweepFrames, record_sweep
from vialight.calibration.writing import Calibrated, check_out
from vialight.core.arrays import TURN_RAD, FloatArray, Grid
from vialight.core.config import Optics, Rig
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns, Plan
from vialight.devices.opening import RealPrinter, names_devices
from vialight.store import open_frames, write_frames, write_plan
from vialight.store.rig_files import load_rig
from vialight.twin import FaultsFile, Twin, TwinSettings, load_faults, load_resin

LINES = 32
WIDTH_MM = 1.5
"""Of a line, in air."""
BAND_MM = 1.0
"""Above and below the optical row, within which rays are taken as level."""
_GLOW = 500.0
"""Counts per mm of the twin where white light has lost nothing."""


@dataclass(frozen=True)
class SweepOptions:
    """Where the sweep comes from, if not from the rig's own devices.

    Parameters
    ----------
    frames
        A recorded sweep.
    resin, faults
        Of the twin: the resin's name or TOML, and what is wrong with the printer, TOML.
    seed
        Of the twin's noise.
    """

    frames: Path | None = None
    resin: str | Path = "DUDMA"
    faults: Path | None = None
    seed: int = 0


def calibrate_projector(
    rig_path: str | Path, out: str | Path, *, options: SweepOptions | None = None,
    progress: Callable[[int, int], None] | None = None, keep_going: Callable[[], bool] = lambda: True,
) -> Calibrated:  # fmt: skip
    """Find where the projector stands and how large its pixels are.

    A vertical line goes through the field, on the devices that the rig names or else on the twin; what the camera sees
    is kept beside the new rig.

    Parameters
    ----------
    rig_path
        The rig to change.
    out
        The new rig; ``.sweep.h5`` of the same name keeps the sweep.
    options
        A recorded sweep, or the twin's.
    progress
        Called with lines done and to do, on the twin.
    keep_going
        Asked while devices sweep; False ends it.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        The rig lacks what both need, the file is no sweep, or no line glows.
    DeviceError
        A device fails.
    """
    from vialight.calibration.projector.figure import sweep_png

    check_out(rig_path, out)
    options, rig = options or SweepOptions(), load_rig(rig_path)
    if options.frames is None:
        path = Path(out).with_suffix(".sweep.h5")
        rig = _record(rig, options, path, progress, keep_going)
    else:
        path = options.frames
    camera, optics = rig.need_camera(), _optics(rig)
    sweep = read_sweep(path, rig)
    fit = fit_projector(
        sweep, camera, optics[0], rig.need_projector(), optics[1], rig.resin.absorption_per_mm or 0.05, path
    )
    figure = Picture(
        "sweep", "What each line looks like to the camera",
        "Brightness along the image, line by line: as seen, as expected of the projector that was found, and what is "
        "left over, which must be noise without a pattern. Lines are brighter on the side from which the light comes.",
        sweep_png(fit),
    )  # fmt: skip
    return Calibrated(_findings(fit, rig, sweep), rig_path, path, out, figures=[figure])


def read_sweep(path: Path, rig: Rig) -> Sweep:
    """Read a recorded sweep: frames, which line each shows, and where the lines are.

    Raises
    ------
    InputError
        The file is no sweep, or has no frames without light.
    """
    camera = rig.need_camera()
    with open_frames(path) as frames:
        told = frames.settings.get("sweep")
        if not isinstance(told, dict) or set(told) != {"first_columns", "width_columns", "line_of_frame"}:
            raise InputError(
                path, "is no sweep: /process settings has no sweep", accepted="a recording of this command",
                remedy="leave FRAMES out to sweep now",
            )  # fmt: skip
        half = max(1, round(BAND_MM / camera.pixel_mm))
        middle = round(camera.optical_row)
        rows = slice(max(0, middle - half), min(frames.shape[1], middle + half + 1))
        dark = frames.dark(rows)
        if dark is None:
            raise InputError(path, "has no data_dark", accepted="frames without light", remedy="record some")
        seen = frames.read(slice(None), rows).astype(np.float64) - dark
    line_of_frame = np.asarray(told["line_of_frame"])
    lines = np.unique(line_of_frame)
    counts = np.stack([seen[line_of_frame == line].mean(axis=(0, 1)) for line in lines])
    return Sweep(counts, np.asarray(told["first_columns"], dtype=np.float64)[lines], int(told["width_columns"]))


def _optics(rig: Rig) -> tuple[Optics, Optics]:
    seen, lit = rig.imaging_optics(), rig.writing_optics()
    if seen is None or lit is None:
        raise InputError(rig.source, 'geometry is "parallel"', accepted="a rig with a vial")
    return seen, lit


def _record(
    rig: Rig, options: SweepOptions, path: Path, progress: Callable[[int, int], None] | None,
    keep_going: Callable[[], bool],
) -> Rig:  # fmt: skip
    """Record a sweep; return the rig, on the twin with its resin in the vial."""
    is_real = names_devices(rig)
    wrong = FaultsFile() if options.faults is None else load_faults(options.faults)
    if not is_real and rig.resin.index_writing is None:
        rig = load_resin(options.resin).in_vial_of(rig)
    projector = rig.need_projector()
    width = max(1, round(WIDTH_MM / projector.pixel_mm))
    columns = line_columns(projector, _optics(rig)[1], LINES, width)
    patterns = _line_patterns(rig, columns, width)
    if is_real:
        swept = _sweep_devices(rig, patterns, keep_going)
    else:
        settings = TwinSettings(faults=wrong.faults, seed=options.seed)
        twin = Twin(rig, load_resin(options.resin), Grid((8, 24, 24), 0.3), settings)
        swept = _sweep_twin(twin, patterns, progress)
        rig = wrong.rig_as_believed(rig)
    told = {
        "first_columns": columns.tolist(), "width_columns": width, "line_of_frame": swept.pattern.tolist(),
    }  # fmt: skip
    angles = swept.pattern * (TURN_RAD / len(columns))
    write_frames(path, swept.counts, angles, dark=swept.dark, settings={"sweep": told})
    return rig


def _line_patterns(rig: Rig, columns: FloatArray, width: int) -> Patterns:
    projector, camera = rig.need_projector(), rig.need_camera()
    # The camera's image may be higher than the projector's, and the other way round: all of what both reach.
    half = min(projector.rows / 2, 8 * BAND_MM / projector.pixel_mm, camera.optical_row * camera.pixel_mm * 16)
    middle = (projector.rows - 1) / 2 if projector.optical_row is None else projector.optical_row
    first_row, rows = max(0, int(middle - half)), int(2 * half)
    first, last = int(columns.min()), int(columns.max()) + width
    levels = np.zeros((len(columns), rows, last - first), np.uint8)
    for level, column in zip(levels, columns.astype(int), strict=True):
        level[:, column - first : column - first + width] = 255
    angles = np.arange(len(columns), dtype=np.float64) * (TURN_RAD / len(columns))
    return Patterns(levels, angles, first_row, first, 1.0)


def _sweep_twin(twin: Twin, patterns: Patterns, progress: Callable[[int, int], None] | None) -> SweepFrames:
    darks = [twin.frame(of_the_empty_vial=True) for _ in range(8)]
    seen = []
    for k, levels in enumerate(patterns.levels):
        twin.show(levels, (patterns.first_row, patterns.first_column))
        seen.append(twin.fluorescence(_GLOW, lab_voxel_mm=0.06))
        if progress:
            progress(k + 1, len(patterns.levels))
    return SweepFrames(np.stack(seen), np.arange(len(seen)), np.stack([dark.counts for dark in darks if dark]))


def _sweep_devices(rig: Rig, patterns: Patterns, keep_going: Callable[[], bool]) -> SweepFrames:
    folder = Path(tempfile.mkdtemp(prefix="vialight-sweep-"))
    try:
        corners = np.vstack([np.zeros(3), np.eye(3)])
        tetrahedron = Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int64))
        plan = Plan(patterns, tetrahedron, np.zeros((1, 2, 2), np.float32), Grid((1, 2, 2), 1.0), rig, {})
        write_plan(folder / "sweep.h5", plan)
        with RealPrinter(rig, folder / "sweep.h5", patterns.angles_rad, folder / "projector.csv") as printer:
            return record_sweep(
                printer.devices, direction=rig.stage.direction, speed_rad_s=float(np.radians(rig.stage.speed_deg_s)),
                keep_going=keep_going,
            )  # fmt: skip
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _findings(fit: ProjectorFit, rig: Rig, sweep: Sweep) -> Findings:
    projector = rig.need_projector()
    column_std, pixel_std, azimuth_std, absorption_std = (float(std) for std in fit.stds)
    notes = [
        f"With the projector on the camera's other side, the squares left over are {fit.other_side:.0f} times as large."
    ]
    if np.sign(fit.azimuth_deg) != np.sign(projector.azimuth_deg):
        notes.append(
            f"The rig had the projector on the other side of the camera ({projector.azimuth_deg:g} deg): parts printed "
            "with it are mirrored."
        )
    return Findings(
        "projector", f"glow of {len(sweep.counts)} vertical lines, {sweep.width_columns} columns wide",
        [
            Finding("projector", "axis_column", fit.axis_column, column_std, "whose light passes through the axis"),
            Finding("projector", "pixel_mm", fit.pixel_mm, pixel_std, "in the plane of the axis, at its distance_mm"),
            Finding("projector", "azimuth_deg", fit.azimuth_deg, azimuth_std, "of its pupil; 0 at the camera"),
            Finding("resin", "absorption_per_mm", fit.absorption_per_mm, absorption_std, "from how the glow fades"),
        ],
        notes, {"other_side": fit.other_side, "lines": len(sweep.counts)},
    )  # fmt: skip
