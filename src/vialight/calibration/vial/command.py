"""Calibrate the vial: outer radius, index and distance, as far as frames determine them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vialight.calibration.axis.command import axis_of
from vialight.calibration.findings import Finding, Findings
from vialight.calibration.turns import CalibrationTurn, calibration_turn
from vialight.calibration.vial.bending import usual_widths
from vialight.calibration.vial.estimator import DETERMINED, FEWEST_SIGMAS, MOST_MISFIT, VialFit, find_vial
from vialight.calibration.writing import Calibrated, check_out
from vialight.core.arrays import FloatArray
from vialight.core.config import Rig
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.store.rig_files import load_rig

_KEYS = (
    ("vial", "outer_radius_mm"), ("resin", "index_imaging"), ("camera", "distance_mm"), ("vial", "wall_mm"),
    ("vial", "wall_index"), ("camera", "pixel_mm"),
)  # fmt: skip


def calibrate_vial(
    frames_path: str | Path, rig_path: str | Path, out: str | Path, *, turn: int | None = None
) -> Calibrated:
    """Refine the vial's outer radius, the resin's index and the camera's distance from the frames of any print.

    Parameters
    ----------
    frames_path, rig_path, out, turn
        See `calibrate_axis`.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        The frames cannot be used, or determine none of the three, or `out` cannot be written.
    """
    check_out(rig_path, out)
    rig = load_rig(rig_path)
    optics = rig.imaging_optics()
    if optics is None or not np.isfinite(optics.distance_mm):
        seen = 'geometry is "parallel"' if optics is None else "[camera] distance_mm is inf"
        raise InputError(rig_path, seen, accepted="a rig with a vial, and a camera at a finite distance")
    with calibration_turn(frames_path, rig, out, turn) as taken:
        found = find_vial(axis_of(taken, rig), _widths(rig, taken.scan.binning))
        if not found.free.any():
            raise InputError(
                frames_path, "opposite views hardly depend on radius, index and distance "
                f"(singular values {_listed(found.singular)})", accepted=f"one of {DETERMINED:g} or more",
                remedy="print a part whose sides change with the angle out to where the vial bends rays",
            )  # fmt: skip
        return Calibrated(_findings(found, taken), rig_path, frames_path, out, figures=_figures(found))


def _widths(rig: Rig, binning: int) -> FloatArray:
    """Return the standard uncertainties that the rig states of its values, or else the usual ones."""
    known = rig.model_dump()
    values = np.array([float(known[table][key]) for table, key in _KEYS])
    stated = known["uncertainty"] or {}
    widths = [
        usual if (width := (stated.get(table) or {}).get(key)) is None else width
        for (table, key), usual in zip(_KEYS, usual_widths(values), strict=True)
    ]
    exact = 1e-5 * np.maximum(values, 0.1)
    binned = np.where([key == "pixel_mm" for _, key in _KEYS], binning, 1)
    return np.asarray(np.maximum(widths, exact) * binned, dtype=np.float64)


def _findings(found: VialFit, taken: CalibrationTurn) -> Findings:
    others = "opposite views" + (" and the vial's edges" if found.edges else "")
    values = [
        Finding(table, key, float(value), float(std), others)
        for (table, key), value, std, free in zip(_KEYS, found.values, found.std, found.free, strict=False)
        if free
    ]
    return Findings(
        "vial", f"{others} of {len(found.views.angles_rad)} frames, rows {taken.rows.start} to {taken.rows.stop - 1}",
        values, _notes(found), _details(found), _tables(found),
    )  # fmt: skip


def _notes(found: VialFit) -> list[str]:
    notes = [
        f"{key} is left alone: of the three only {int(found.free.sum())} can be told apart, and it least. If it is "
        "off, the others make up for it; their uncertainties say by how much."
        for (_, key), free in zip(_KEYS[:3], found.free, strict=True)
        if not free
    ]
    if not found.edges:
        notes.append("The vial's edges do not show; all is from opposite views.")
    far = np.abs(found.values - found.before) > FEWEST_SIGMAS * found.widths[:3]
    notes += [
        f"Look again: {key} is more than {FEWEST_SIGMAS:g} standard uncertainties from the rig's."
        for (_, key), off in zip(_KEYS[:3], far, strict=True)
        if off
    ]
    if found.misfit > MOST_MISFIT:
        notes.append(
            f"Look again: opposite views differ by {found.misfit:.1f} times their noise. Matter that dims light or "
            "bends it, or that moved, does that; it can shift what is found beyond its uncertainty."
        )
    return notes


def _details(found: VialFit) -> dict[str, Any]:
    return {
        "rms_of_opposite_views_before_counts": found.compared_before.rms,
        "rms_of_opposite_views_after_counts": found.compared.rms,
        "misfit_over_noise": found.misfit,
        "singular_values": found.singular.tolist(),
        "directions": found.directions.tolist(),
        "least_singular_value": DETERMINED,
        "left_alone": [key for (_, key), free in zip(_KEYS[:3], found.free, strict=True) if not free],
        "assumed_uncertainties": {key: float(width) for (_, key), width in zip(_KEYS, found.widths, strict=True)},
        "edges_used": found.edges,
    }


def _tables(found: VialFit) -> list[tuple[str, list[str], list[list[str]]]]:
    names = ["outer radius", "index", "distance"]
    told = [
        [f"{value:.2f}", *(f"{part:+.2f}" for part in direction), "determined" if value >= DETERMINED else "left alone"]
        for value, direction in zip(found.singular, found.directions, strict=True)
    ]
    assumed = [[f"[{table}] {key}", f"{width:.3g}"] for (table, key), width in zip(_KEYS, found.widths, strict=True)]
    return [
        (f"Combinations, in assumed uncertainties; those below {DETERMINED:g} are left alone",
         ["singular value", *names, ""], told),
        ("Assumed standard uncertainties of what the rig has", ["value", "uncertainty"], assumed),
    ]  # fmt: skip


def _figures(found: VialFit) -> list[Picture]:
    from vialight.calibration.figures import mirror_png
    from vialight.calibration.vial.figure import bend_png

    return [
        Picture(
            "mirror", "Opposite views",
            "One row of the sinogram less its own mirror image from the other side of the turn, before and after. "
            "After, only noise may be left.",
            mirror_png(found.compared_before, found.compared, np.degrees(found.views.angles_rad)),
        ),
        Picture(
            "bend", "How far rays turn, by how far beside the axis they are",
            "Dots: what each column by itself says of its rays' bend, less what the rig had. The line is that of the "
            "values found; it must go through the dots. Below, what is left: no slope or curve may be.",
            bend_png(found),
        ),
    ]  # fmt: skip


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{value:.2g}" for value in values)
