"""Check whether the calibration of a run is still good."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vialight.calibration.axis.command import axis_of
from vialight.calibration.axis.estimator import AxisFit
from vialight.calibration.check.appearance import Streaks, sharpest_edges, streaks_of
from vialight.calibration.check.checks import (
    LEAST_COLUMNS,
    SURE,
    Check,
    drift_check,
    reference_checks,
    run_out_check,
    stated_std,
    width_check,
)
from vialight.calibration.findings import Finding, Findings
from vialight.calibration.opposite_sums import AXIS, DRIFT, OUT_X, OUT_Y
from vialight.calibration.turns import CalibrationTurn, calibration_turn
from vialight.calibration.writing import Calibrated, check_out
from vialight.core.config import Rig, ThresholdConditions
from vialight.core.drawing import Picture
from vialight.store.provenance import inputs_json, versions
from vialight.store.rig_files import load_rig
from vialight.system import file_in

PAGE = "check.html"


@dataclass(frozen=True)
class Checked:
    """What a check has found, and what is to be written of it.

    Parameters
    ----------
    page
        The page, HTML; ``.json`` of the same name comes beside it.
    result
        What that ``.json`` holds.
    figures
        For the page.
    kept
        The new rig that keeps what this run looked like; None where none is wanted.
    """

    page: Path
    result: dict[str, Any]
    figures: list[Picture]
    kept: Calibrated | None


def check_calibration(
    run: str | Path, rig_path: str | Path | None = None, *, turn: int | None = None, out: str | Path | None = None
) -> Checked:
    """Compare what a run's frames say of axis, run-out, vial, focus and light with what its rig says.

    Parameters
    ----------
    run
        A run's folder, or frames (then with a rig).
    rig_path
        By default the run's.
    turn
        By default the last full one.
    out
        A new rig that keeps how sharp and bright this run is, for later ones to be compared with.

    Returns
    -------
    Checked
        Its result has ``checks``: what, the rig's value, what is found, by how much it may differ, whether it does, and
        what that means; ``page``, which lies beside the frames.

    Raises
    ------
    InputError
        The frames cannot be used, or `out` cannot be written.
    """
    run = Path(run)
    frames = file_in(run, "frames.h5") if run.is_dir() else run
    rig_path = Path(rig_path) if rig_path else file_in(run, "rig.toml")
    page = file_in(run, PAGE) if run.is_dir() else run.with_name(f"{run.stem}.{PAGE}")
    if out is not None:
        check_out(rig_path, out)
    rig = load_rig(rig_path)
    with calibration_turn(frames, rig, page if out is None else out, turn) as taken:
        found = axis_of(taken, rig)
        conditions = rig.imaged_under(taken.scan.frames.settings)
        streaks, edges = _appearance(taken)
        checks = [_axis(found, taken, rig), *_others(found, taken, rig)]
        if rig.reference is not None:
            checks += reference_checks(streaks, edges, conditions, rig.reference)
        figures = _figures(found, taken, rig)
    result = {
        "run": str(run),
        "rig": str(rig_path),
        "page": str(page),
        "good": all(check.good for check in checks),
        "checks": [asdict(check) | {"good": check.good} for check in checks],
        "notes": _notes(rig),
        "inputs": inputs_json(frames=frames, rig=rig_path),
        "versions": versions(),
    }
    kept = None
    if out is not None:
        kept = Calibrated(_kept(streaks, edges, conditions), rig_path, frames, out, figures=figures)
    return Checked(page, result, figures, kept)


def _appearance(taken: CalibrationTurn) -> tuple[Streaks | None, float | None]:
    """Return the light at the vial's edges, and the softness of the part's, in pixels of the recording."""
    scan, binning = taken.scan, taken.scan.binning
    edges = sharpest_edges(taken.counts)
    seen = None if scan.optics is None else streaks_of(taken.profiles, scan.camera, scan.optics)
    if seen is not None:
        seen = Streaks(seen.columns * binning, seen.counts / binning**2, taken.column_of(seen.middle))
    return seen, None if edges is None else edges * binning


def _axis(found: AxisFit, taken: CalibrationTurn, rig: Rig) -> Check:
    std = np.hypot(found.fit.std[AXIS] * taken.scan.binning, stated_std(rig, "camera", "axis_column"))
    column = taken.column_of(float(found.fit.parameters[AXIS]))
    allowed = max(LEAST_COLUMNS, SURE * float(std))
    return Check("axis", rig.need_camera().axis_column, column, allowed, "column", "the camera has moved aside")


def _others(found: AxisFit, taken: CalibrationTurn, rig: Rig) -> list[Check]:
    value, std = found.fit.parameters, found.fit.std
    checks = [drift_check(float(value[DRIFT]), float(std[DRIFT]))]
    if taken.scan.optics is not None:
        checks.append(run_out_check(value[[OUT_X, OUT_Y]], float(std[OUT_X]), rig))
        if found.circle is not None:
            checks += width_check(found.circle, taken.scan.camera, taken.scan.optics, taken.scan.binning)
    if found.direction not in (None, rig.stage.direction):
        means = "the stage turns the other way: what is measured is mirrored"
        checks.append(Check("turning sense", rig.stage.direction, float(found.direction or 0), 0.0, "", means))
    return checks


def _notes(rig: Rig) -> list[str]:
    if rig.reference is not None:
        return []
    return [
        "Focus and brightness are not compared: the rig has no [reference]. After a run that is good, "
        "`vialight calibrate check RUN --out NEW_RIG.toml` keeps what it looked like."
    ]


def _kept(streaks: Streaks | None, edges: float | None, conditions: ThresholdConditions) -> Findings:
    found: dict[str, float | None] = {
        "streak_columns": None, "streak_counts": None, "streak_middle_column": None, "edge_columns": edges,
    }  # fmt: skip
    if streaks is not None:
        middle = streaks.middle if np.isfinite(streaks.middle) else None
        found |= {"streak_columns": streaks.columns, "streak_counts": streaks.counts, "streak_middle_column": middle}
    said = {
        "streak_columns": "width of the light at the vial's edges", "streak_counts": "its sum across",
        "streak_middle_column": "midway between the two", "edge_columns": "softness of the part's sharpest edges",
    }  # fmt: skip
    values = [
        Finding("reference", key, None if value is None else float(f"{value:.5g}"), None, said[key])
        for key, value in found.items()
    ]
    values += [
        Finding("reference.conditions", key, value, None, "of the recording")
        for key, value in conditions.model_dump().items()
    ]
    return Findings("reference", "what a run looked like that was good", values)


def _figures(found: AxisFit, taken: CalibrationTurn, rig: Rig) -> list[Picture]:
    from vialight.calibration.axis.figure import axis_round_png
    from vialight.calibration.figures import frame_png, mirror_png

    scan, value = taken.scan, found.fit.parameters
    seen = scan.camera.model_copy(update={"axis_column": float(value[AXIS])})
    before = scan.camera if abs(scan.camera.axis_column - seen.axis_column) > LEAST_COLUMNS else None
    return [
        Picture("frame", "A frame, with the axis as found",
                "Axis and vial as they are seen now; where the rig has the axis elsewhere, that is shown too.",
                frame_png(taken.frame, seen, scan.optics, before=before)),
        Picture("mirror", "Opposite views",
                "One row of the sinogram less its mirror image: as the rig has the axis, and as it is found. Where the "
                "calibration is good, the two are alike.",
                mirror_png(found.before, found.fit.comparison, np.degrees(taken.angles_rad))),
        Picture("round", "The vial as it turns", "Its edges, and each frame's own axis, about the stage's angle.",
                axis_round_png(found)),
    ]  # fmt: skip
