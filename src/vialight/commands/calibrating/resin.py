"""Calibrate the resin: how much light gels it, and how deep light reaches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vialight.arrays import FloatArray
from vialight.calibrate import Finding, Findings, WorkingCurve, fit_working_curve
from vialight.commands.calibrating.writing import check_out, write_calibrated
from vialight.config import load_rig
from vialight.diagnostics import Picture
from vialight.errors import InputError
from vialight.store import read_table

EXPOSURE, DEPTH = "exposure_mj_per_cm2", "depth_mm"


def calibrate_resin(table_path: str | Path, rig_path: str | Path, out: str | Path) -> dict[str, Any]:
    """Find critical exposure and absorption from a table of exposures and cured depths.

    Parameters
    ----------
    table_path
        CSV with the columns ``exposure_mj_per_cm2`` and ``depth_mm``.
    rig_path
        The rig to change.
    out
        The new rig.

    Returns
    -------
    dict
        What the ``.json`` beside it holds.

    Raises
    ------
    InputError
        The table cannot be used, or `out` cannot be written.
    """
    from vialight.report import working_curve_png

    check_out(rig_path, out)
    load_rig(rig_path)
    exposure, depth = _read_depths(table_path)
    curve = fit_working_curve(exposure, depth, table_path)
    figure = Picture(
        "working_curve", "Working curve",
        "Depth against the logarithm of the exposure: on a line where the resin follows Beer and Lambert. Where the "
        "points bend away from it, at high exposures say, leave those out.",
        working_curve_png(curve),
    )  # fmt: skip
    return write_calibrated(_findings(curve), rig_path, table_path, out, figures=[figure])


def _read_depths(path: str | Path) -> tuple[FloatArray, FloatArray]:
    columns = read_table(path, (EXPOSURE, DEPTH))
    exposure, depth = columns[EXPOSURE], columns[DEPTH]
    for name, values in columns.items():
        if len(values) and not (np.isfinite(values) & (values > 0)).all():
            bad = values[~(np.isfinite(values) & (values > 0))][0]
            raise InputError(path, f"{name} is {bad:g}", accepted="positive numbers", remedy="leave that row out")
    return exposure, depth


def _findings(curve: WorkingCurve) -> Findings:
    return Findings(
        "resin", f"working curve of {len(curve.depth_mm)} cured depths",
        [
            Finding("resin", "critical_exposure_mj_per_cm2", curve.critical_mj_per_cm2, curve.critical_std_mj_per_cm2,
                    "exposure at which the line meets depth 0"),
            Finding("resin", "absorption_per_mm", curve.absorption_per_mm, curve.absorption_std_per_mm,
                    "1 / penetration depth, the line's slope"),
        ],
        details={
            "penetration_mm": curve.penetration_mm,
            "penetration_std_mm": curve.penetration_std_mm,
            "scatter_mm": curve.scatter_mm,
        },
    )  # fmt: skip
