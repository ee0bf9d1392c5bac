"""Calibrate the axis: where it is, how it leans, how the vial goes round it, which way the stage turns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vialight.calibration.axis.estimator import AxisFit, find_axis
from vialight.calibration.findings import Finding, Findings
from vialight.calibration.opposite_sums import AXIS, DRIFT, OUT_X, OUT_Y, TILT
from vialight.calibration.turns import CalibrationTurn, calibration_turn
from vialight.calibration.writing import Calibrated, check_out
from vialight.core.config import Rig
from vialight.core.drawing import Picture
from vialight.store.rig_files import load_rig

_ZERO_MATTERS_DEG = 0.05
"""A turn; at the rim of the field, 8 mm from the axis, 7 um."""

_SURE = 2.0
"""Standard uncertainties that a run-out, or a drift, must have to be more than none."""


def calibrate_axis(
    frames_path: str | Path, rig_path: str | Path, out: str | Path, *, turn: int | None = None
) -> Calibrated:
    """Find the rotation axis, its tilt, the vial's run-out and the turning sense from the frames of any print.

    Parameters
    ----------
    frames_path
        Data Exchange HDF5, a full turn or more.
    rig_path
        The rig to change; its axis may be some columns off.
    out
        The new rig.
    turn
        Which turn of the recording, from 1; by default the last full one.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        The frames cannot be used, or `out` cannot be written.
    """
    check_out(rig_path, out)
    rig = load_rig(rig_path)
    with calibration_turn(frames_path, rig, out, turn) as taken:
        found = axis_of(taken, rig)
        findings = _with_zero(_findings(found, taken, rig), taken)
        return Calibrated(findings, rig_path, frames_path, out, figures=_figures(found, taken))


def axis_of(taken: CalibrationTurn, rig: Rig) -> AxisFit:
    """Find the axis in a turn, starting from a rig."""
    scan = taken.scan
    return find_axis(
        taken.counts, taken.rows.start, taken.angles_rad, scan.camera, scan.optics, direction=rig.stage.direction,
        profiles=taken.profiles,
    )  # fmt: skip


def _findings(found: AxisFit, taken: CalibrationTurn, rig: Rig) -> Findings:
    value, std = found.fit.parameters, found.fit.std
    binning = taken.scan.binning
    values, notes = [], []
    if found.determined[AXIS]:
        values.append(Finding("camera", "axis_column", taken.column_of(float(value[AXIS])), float(std[AXIS]) * binning,
                              "opposite views agree best"))  # fmt: skip
    if found.determined[TILT]:
        values.append(Finding("camera", "axis_tilt_deg", float(np.degrees(value[TILT])), float(np.degrees(std[TILT])),
                              "to the right, about the optical row"))  # fmt: skip
    for place, name in ((AXIS, "axis_column"), (TILT, "axis_tilt_deg")):
        if not found.determined[place]:
            notes.append(f"{name} is left alone: the frames hardly depend on it.")
    if taken.scan.optics is not None:
        if found.determined[OUT_X] and found.determined[OUT_Y]:
            values += _run_out(found)
        else:
            notes.append("The run-out is left alone: the frames hardly depend on it.")
    if found.direction is not None:
        how = f"the other sense makes opposite views {found.ratio_of_directions:.1f} times as unlike"
        values.append(Finding("stage", "direction", found.direction, None, how))
        if found.direction != rig.stage.direction:
            notes.append("The stage turns the other way than the rig had it: prints so far are mirrored.")
    else:
        notes.append("The turning sense is left alone: what is seen looks the same turned either way.")
    if found.circle is None and taken.scan.optics is not None:
        notes.append("The vial's edges do not show; all is from opposite views.")
    return Findings(
        "axis", f"opposite views of {len(taken.angles_rad)} frames, rows {taken.rows.start} to {taken.rows.stop - 1}"
        + (", and the vial's edges" if found.circle else ""),
        values, notes, _details(found, taken),
    )  # fmt: skip


def _with_zero(findings: Findings, taken: CalibrationTurn) -> Findings:
    """Add by how much the angle zero moves from turn to turn, where there are several."""
    turns = taken.zero_by_turn()
    if not turns:
        return findings
    moved = np.degrees([turned.rad for _, turned in turns])
    std = np.degrees([turned.std_rad for _, turned in turns])
    drift, uncertainty = float(moved.mean()), float(np.sqrt((std**2).sum()) / len(std))
    rows = [
        (f"{turn - 1} to {turn}", f"{by:.3f} ± {within:.3f}".replace("-", "\u2212"))
        for (turn, _), by, within in zip(turns, moved, std, strict=True)
    ]
    notes = list(findings.notes)
    if abs(drift) > max(_SURE * uncertainty, _ZERO_MATTERS_DEG):
        notes.append(
            f"The part stands {drift:.2f} deg farther on with every turn, at the same angle of the stage: the stage's "
            "own angle is off, or the part slips in its vial."
        )
    details = dict(findings.details) | {
        "angle_zero_moved_deg": {str(turn): float(by) for (turn, _), by in zip(turns, moved, strict=True)},
        "angle_zero_moved_deg_std": {str(turn): float(by) for (turn, _), by in zip(turns, std, strict=True)},
        "angle_zero_drift_deg_a_turn": drift,
        "angle_zero_drift_deg_a_turn_std": uncertainty,
    }
    table = ("The angle zero, from turn to turn", ("turns", "farther on, deg"), rows)
    return replace(findings, notes=notes, details=details, tables=[*findings.tables, table])


def _run_out(found: AxisFit) -> list[Finding]:
    out, covariance = found.fit.parameters[[OUT_X, OUT_Y]], found.fit.covariance[OUT_X:DRIFT, OUT_X:DRIFT]
    radius = float(np.hypot(*out))
    along = out / max(radius, 1e-12)
    std, across = (float(np.sqrt(v @ covariance @ v)) for v in (along, np.array([-along[1], along[0]])))
    if radius < _SURE * max(std, across):
        how = "no more than its uncertainty: taken as none"
        return [Finding("stage.run_out", "radius_mm", 0.0, max(std, across), how),
                Finding("stage.run_out", "phase_deg", 0.0, None, how)]  # fmt: skip
    how = "the vial's edges, and opposite views" if found.circle else "opposite views"
    return [
        Finding("stage.run_out", "radius_mm", radius, std, how),
        Finding("stage.run_out", "phase_deg", float(np.degrees(np.arctan2(out[1], out[0]))),
                float(np.degrees(across / radius)), how),
    ]  # fmt: skip


def _details(found: AxisFit, taken: CalibrationTurn) -> dict[str, Any]:
    circle, binning = found.circle, taken.scan.binning
    return {
        "rms_of_opposite_views_before_counts": found.before.rms,
        "rms_of_opposite_views_after_counts": found.fit.comparison.rms,
        "light_drift_a_turn": float(found.fit.parameters[DRIFT]),
        "light_drift_a_turn_std": float(found.fit.std[DRIFT]),
        "angle_jitter_deg": float(np.degrees(found.jitter.std_rad)),
        "angle_jitter_deg_std": float(np.degrees(found.jitter.uncertainty_rad)),
        "ratio_of_turning_senses": found.ratio_of_directions,
        "edge_columns": None if circle is None else [taken.column_of(edge) for edge in (circle.left, circle.right)],
        "edge_scatter_columns": None if circle is None else circle.scatter * binning,
        "rows": [taken.rows.start * binning, taken.rows.stop * binning],
        "binning": binning,
    }


def _figures(found: AxisFit, taken: CalibrationTurn) -> list[Picture]:
    from vialight.calibration.axis.figure import axis_round_png
    from vialight.calibration.figures import frame_png, mirror_png

    scan, value = taken.scan, found.fit.parameters
    calibrated = scan.camera.model_copy(
        update={"axis_column": float(value[AXIS]), "axis_tilt_deg": float(np.degrees(value[TILT]))}
    )
    return [
        Picture(
            "mirror", "Opposite views",
            "One row of the sinogram less its own mirror image from the other side of the turn, before and after. "
            "After, only noise and faint outlines may be left; edges in red and blue side by side mean that the axis "
            "is still off.", mirror_png(found.before, found.fit.comparison, np.degrees(found.views.angles_rad)),
        ),
        Picture(
            "frame", "A frame, with axis and edges",
            "Dashed: the axis as the rig had it, and as found. The outer lines must lie on the vial's own edges, where "
            "they show.", frame_png(taken.frame, calibrated, scan.optics, before=scan.camera),
        ),
        Picture(
            "round", "Against the stage's angle",
            "Above: midway between the vial's edges, frame by frame, with the run-out that was found; it must follow. "
            "Below: by how much each frame's own axis is off after all; no wave may be left.", axis_round_png(found),
        ),
    ]  # fmt: skip
