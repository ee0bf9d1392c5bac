"""Calibrate the resin: how much light gels it, and how deep light reaches."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vialight.calibration.findings import Finding, Findings
from vialight.calibration.resin.gelling import gel_doses, gelling_findings
from vialight.calibration.resin.index import index_from_cylinders
from vialight.calibration.resin.working_curve import WorkingCurve, fit_working_curve
from vialight.calibration.threshold.by_rim import overhead
from vialight.calibration.threshold.standards import (
    Standard,
    StandardOptions,
    pixel_std_share,
    profile_circle,
    reconstructed,
)
from vialight.calibration.writing import Calibrated, check_out, shown_where_refused
from vialight.core.arrays import FloatArray
from vialight.core.config import Rig
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.store import read_table
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Progress

EXPOSURE, DEPTH = "exposure_mj_per_cm2", "depth_mm"


def calibrate_resin(
    table_path: str | Path | None,
    rig_path: str | Path,
    out: str | Path,
    *,
    runs: Sequence[str | Path] = (),
    plan_path: str | Path | None = None,
    cylinders: Sequence[Standard] = (),
    options: StandardOptions | None = None,
    progress: Progress | None = None,
) -> Calibrated:
    """Find critical exposure and absorption from cured depths, or the former from when a print gelled, and the index.

    Parameters
    ----------
    table_path
        CSV with the columns ``exposure_mj_per_cm2`` and ``depth_mm``, or None.
    rig_path
        The rig to change.
    out
        The new rig.
    runs, plan_path
        Folders of runs, whose gel times tell the critical exposure in place of depths, and the plan that was printed,
        by default in them.
    cylinders
        Recordings of cylinders with their profiles, which tell the index.
    options
        How to look at them.
    progress
        Called with slices, or frames, done and to do.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        Table, run, recordings or profiles cannot be used, or `out` cannot be written.
    """
    check_out(rig_path, out)
    rig, found, figures = load_rig(rig_path), [], []
    if table_path is not None and runs:
        raise InputError("--run", "is given, and a table of depths too", accepted="one of them, or both apart",
                         remedy="compare what the two say")  # fmt: skip
    if table_path is not None:
        findings, figure = _working_curve(table_path)
        found.append(findings)
        figures.append(figure)
    if runs:
        findings, pictures = _gelling([Path(run) for run in runs], plan_path, options, progress)
        found.append(findings)
        figures += pictures
    if cylinders:
        found.append(_index(cylinders, rig, options or StandardOptions(), out, progress))
    if not found:
        raise InputError("calibrate resin", "has neither depths, a run nor cylinders", accepted="one of them, or more")
    data = table_path or (Path(runs[0]) / "frames.h5" if runs else cylinders[0].frames)
    inputs: dict[str, str | Path] = {f"run_{k}": Path(run) / "frames.h5" for k, run in enumerate(runs, 1)}
    inputs |= {f"frames_{k}": one.frames for k, one in enumerate(cylinders, 1)}
    inputs |= {f"profile_{k}": one.known for k, one in enumerate(cylinders, 1)}
    return Calibrated(_together(found), rig_path, data, out, figures=figures, inputs=inputs)


def _gelling(
    runs: Sequence[Path], plan_path: str | Path | None, options: StandardOptions | None, progress: Progress | None
) -> tuple[Findings, list[Picture]]:
    from vialight.calibration.resin.figures import gel_doses_png

    voxel_mm = None if options is None else options.settings.voxel_mm
    found = [gel_doses(run, plan_path, voxel_mm=voxel_mm, progress=progress) for run in runs]
    figures = [
        Picture(
            "gelling", f"{run.name}: how much light places had got when they gelled",
            "If the dose alone decided, all places would lie on one level, whenever they gelled. A slope says that "
            "slow light counts for less (what inhibits comes back), a wide histogram that light is not where it should "
            "be.",
            gel_doses_png(one.gel_time_s, one.dose_mj_per_cm2, one.critical_mj_per_cm2),
        )
        for one, run in zip(found, runs, strict=True)
    ]  # fmt: skip
    return gelling_findings(found, runs), figures


def _together(found: Sequence[Findings]) -> Findings:
    details: dict[str, Any] = {}
    for one in found:
        details |= one.details
    values, notes = [value for one in found for value in one.values], [note for one in found for note in one.notes]
    return Findings("resin", "; ".join(one.method for one in found), values, notes, details)


def _working_curve(table_path: str | Path) -> tuple[Findings, Picture]:
    from vialight.calibration.resin.figures import working_curve_png

    exposure, depth = _read_depths(table_path)
    curve = fit_working_curve(exposure, depth, table_path)
    figure = Picture(
        "working_curve", "Working curve",
        "Depth against the logarithm of the exposure: on a line where the resin follows Beer and Lambert. Where the "
        "points bend away from it, at high exposures say, leave those out.",
        working_curve_png(curve),
    )  # fmt: skip
    return _findings(curve), figure


def _index(
    cylinders: Sequence[Standard], rig: Rig, options: StandardOptions, out: str | Path, progress: Progress | None
) -> Findings:
    from vialight.calibration.threshold.figures import view_from_above_png

    index = rig.resin.index_imaging
    if rig.imaging_optics() is None or index is None:
        raise InputError(
            rig.source, "has no vial that refracts", accepted="a rig with a vial and [resin] index_imaging"
        )
    apparent, true, std, edge = [], [], [], []
    for one in cylinders:
        profile, _ = profile_circle(one.known, options, out)
        volume, _ = reconstructed(one.frames, rig, options, out, progress)
        with shown_where_refused(out, partial(view_from_above_png, volume.density.mean(axis=0), volume.grid)):
            seen = overhead(volume.density, volume.grid, one.frames, like_mm=profile.radius_mm)
        apparent.append(seen.circle.radius_mm)
        true.append(profile.radius_mm)
        std.append(float(np.hypot(seen.circle.radius_std_mm, profile.radius_std_mm)))
        edge.append(seen.edge_std_mm)
    fit = index_from_cylinders(
        np.array(apparent), np.array(true), np.array(std), max(edge), index, pixel_std_share(rig)
    )  # fmt: skip
    notes = [] if len(cylinders) > 1 else [
        "From one cylinder, the softness of its edge decides how well the index is known: take two of different size."
    ]  # fmt: skip
    return Findings(
        "resin", f"apparent size of {len(cylinders)} known cylinder{'s' if len(cylinders) > 1 else ''}",
        [Finding("resin", "index_imaging", fit.index, fit.std, "at which they are as large as their profiles say")],
        notes, {"edge_mm": fit.edge_mm, "apparent_radii_mm": apparent, "profile_radii_mm": true},
    )  # fmt: skip


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
