"""Check whether the calibration of a run is still good."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vialight.calibrate import AXIS, DRIFT, OUT_X, OUT_Y, AxisFit
from vialight.calibrate.edges import edge_x_c_mm
from vialight.calibrate.scale import STREAK_COLUMNS
from vialight.commands.calibrating.axis import axis_of
from vialight.commands.calibrating.turns import CalibrationTurn, calibration_turn
from vialight.config import Rig, load_rig
from vialight.wobble import vial_centre_mm

_SURE = 3.0
"""Standard uncertainties off from which on something has changed."""

_LEAST_COLUMNS, _LEAST_MM, _LEAST_DRIFT = 0.1, 0.015, 0.01
"""Less than this matters to nobody: columns of the axis, mm of run-out, share of the light a turn."""


def check_calibration(
    run: str | Path, rig_path: str | Path | None = None, *, turn: int | None = None
) -> dict[str, Any]:
    """Compare what a run's frames say of axis, run-out, vial and light with what its rig says.

    Parameters
    ----------
    run
        A run's folder, or frames (then with a rig).
    rig_path
        By default the run's.
    turn
        By default the last full one.

    Returns
    -------
    dict
        ``checks``: what, the rig's value, what is found, by how much it may differ, and whether it does.

    Raises
    ------
    InputError
        The frames cannot be used.
    """
    run = Path(run)
    frames = run / "frames.h5" if run.is_dir() else run
    rig_path = Path(rig_path) if rig_path else run / "rig.toml"
    rig = load_rig(rig_path)
    with calibration_turn(frames, rig, frames.with_name("calibration.toml"), turn) as taken:
        found = axis_of(taken, rig)
        checks = [_axis(found, taken, rig), _light(found)]
        if taken.scan.optics is not None:
            checks += [_run_out(found, rig), *_width(found, taken)]
        if found.direction not in (None, rig.stage.direction):
            checks.append(_check("turning sense", rig.stage.direction, found.direction, 0.0, ""))
    return {"run": str(run), "rig": str(rig_path), "good": all(check["good"] for check in checks), "checks": checks}


def _check(what: str, rig: float, found: float | None, allowed: float, unit: str) -> dict[str, Any]:
    good = found is not None and abs(found - rig) <= allowed
    return {"what": what, "rig": rig, "found": found, "allowed": allowed, "unit": unit, "good": bool(good)}


def _stated(rig: Rig, table: str, key: str) -> float:
    stated = getattr(rig.uncertainty, table, None) if rig.uncertainty else None
    return float((stated or {}).get(key, 0.0))


def _axis(found: AxisFit, taken: CalibrationTurn, rig: Rig) -> dict[str, Any]:
    std = np.hypot(found.fit.std[AXIS] * taken.scan.binning, _stated(rig, "camera", "axis_column"))
    column = taken.column_of(float(found.fit.parameters[AXIS]))
    return _check("axis", rig.need_camera().axis_column, column, max(_LEAST_COLUMNS, _SURE * float(std)), "column")


def _light(found: AxisFit) -> dict[str, Any]:
    allowed = max(_LEAST_DRIFT, _SURE * float(found.fit.std[DRIFT]))
    return _check("drift of the light in a turn", 0.0, float(found.fit.parameters[DRIFT]), allowed, "")


def _run_out(found: AxisFit, rig: Rig) -> dict[str, Any]:
    off = found.fit.parameters[[OUT_X, OUT_Y]] - np.array(vial_centre_mm(rig.stage.run_out))
    std = np.hypot(float(found.fit.std[OUT_X]), _stated(rig, "stage", "run_out.radius_mm"))
    return _check("change of the run-out", 0.0, float(np.hypot(*off)), max(_LEAST_MM, _SURE * float(std)), "mm")


def _width(found: AxisFit, taken: CalibrationTurn) -> list[dict[str, Any]]:
    """Compare the vial's width with the rig's, where both edges show."""
    scan, circle = taken.scan, found.circle
    if scan.optics is None or circle is None or not np.isfinite([circle.left, circle.right]).all():
        return []
    expected = 2 * edge_x_c_mm(scan.optics) / scan.camera.pixel_mm
    width = circle.right - circle.left
    allowed = _SURE * np.sqrt(2) * STREAK_COLUMNS
    return [
        _check("width of the vial", expected * scan.binning, width * scan.binning, allowed * scan.binning, "columns")
    ]
