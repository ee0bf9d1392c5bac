"""Calibrate the gelation threshold I_p with standard cylinders, or with a print whose surface is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vialight.calibration.findings import Finding, Findings
from vialight.calibration.threshold.by_rim import RimThreshold, overhead, radius_at, rim_threshold, weighted_mean
from vialight.calibration.threshold.by_surface import SurfaceThreshold, surface_threshold
from vialight.calibration.threshold.circles import Circle
from vialight.calibration.threshold.standards import (
    Standard,
    StandardOptions,
    pixel_std_share,
    profile_circle,
    reconstructed,
)
from vialight.calibration.writing import Calibrated, check_out, shown_where_refused
from vialight.core.arrays import Volume
from vialight.core.config import Rig, ThresholdConditions
from vialight.core.drawing import Picture
from vialight.core.mesh import Mesh
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Progress

MESHES = (".stl", ".ply", ".obj", ".3mf")


@dataclass(frozen=True)
class _Found:
    """A standard's threshold under the conditions of its own recording."""

    standard: Standard
    result: RimThreshold | SurfaceThreshold
    conditions: ThresholdConditions
    figures: Sequence[Picture]


def calibrate_threshold(
    standards: Sequence[Standard],
    rig_path: str | Path,
    out: str | Path,
    *,
    options: StandardOptions | None = None,
    validate: Sequence[Standard] = (),
    progress: Progress | None = None,
) -> Calibrated:
    """Find I_p from recordings of prints whose size is known.

    Parameters
    ----------
    standards
        The prints; of several, the weighted mean is taken.
    rig_path
        The rig to change.
    out
        The new rig.
    options
        How.
    validate
        Other cylinders, whose diameters at the I_p found are compared with their profiles.
    progress
        Called with slices done and to do of one reconstruction after the other.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        Nothing has cured, what was printed or measured is no cylinder, the conditions of several recordings cannot be
        compared, or `out` cannot be written.
    """
    check_out(rig_path, out)
    options, rig = options or StandardOptions(), load_rig(rig_path)
    found = [_find(standard, rig, options, out, progress) for standard in standards]
    # In the conditions of the first, in which the new rig states it.
    factors = [one.conditions.factor_to(found[0].conditions, str(one.standard.frames)) for one in found]
    threshold, std = weighted_mean(
        [one.result.threshold * factor for one, factor in zip(found, factors, strict=True)],
        [one.result.std * factor for one, factor in zip(found, factors, strict=True)],
    )
    rows = [
        _validated(standard, rig, options, out, progress, (threshold, std, found[0].conditions))
        for standard in validate
    ]
    findings = _findings(found, factors, (threshold, std), rows)
    inputs = {f"known_{k}": one.standard.known for k, one in enumerate(found, 1)}
    inputs |= {f"frames_{k}": one.standard.frames for k, one in enumerate(found[1:], 2)}
    inputs |= {f"validation_{k}": standard.frames for k, standard in enumerate(validate, 1)}
    figures = [figure for one in found for figure in one.figures]
    return Calibrated(findings, rig_path, standards[0].frames, out, figures=figures, inputs=inputs)


def _find(standard: Standard, rig: Rig, options: StandardOptions, out: str | Path, progress: Progress | None) -> _Found:
    from vialight.calibration.threshold.figures import view_from_above_png

    if standard.known.suffix.lower() in MESHES:
        surface = load_mesh(standard.known)
        volume, conditions = reconstructed(standard.frames, rig, options, out, progress)
        with shown_where_refused(out, lambda: view_from_above_png(volume.density.mean(axis=0), volume.grid)):
            fitted = surface_threshold(volume, surface, standard.frames)
        return _Found(standard, fitted, conditions, _surface_figures(standard, fitted, volume, surface))
    profile, draw_profile = profile_circle(standard.known, options, out)
    result, conditions = _rim(standard, profile, rig, options, out, progress)
    return _Found(standard, result, conditions, _figures(standard, result, profile, draw_profile))


def _rim(
    standard: Standard, profile: Circle, rig: Rig, options: StandardOptions, out: str | Path, progress: Progress | None
) -> tuple[RimThreshold, ThresholdConditions]:
    from vialight.calibration.threshold.figures import view_from_above_png

    volume, conditions = reconstructed(standard.frames, rig, options, out, progress)
    std_mm = float(np.hypot(profile.radius_std_mm, profile.radius_mm * pixel_std_share(rig)))
    with shown_where_refused(out, lambda: view_from_above_png(volume.density.mean(axis=0), volume.grid)):
        seen = overhead(volume.density, volume.grid, standard.frames, like_mm=profile.radius_mm)
        return rim_threshold(seen, profile.radius_mm, std_mm, standard.frames), conditions


def _figures(
    standard: Standard, result: RimThreshold, profile: Circle, draw_profile: Callable[[Circle | None], bytes]
) -> list[Picture]:
    from vialight.calibration.threshold.figures import rim_png, view_from_above_png

    seen = result.overhead
    above = view_from_above_png(seen.density, seen.grid, (seen.circle.x_mm, seen.circle.y_mm, result.radius_mm))
    return [
        Picture(
            "profile", f"{standard.known.name}: the profile",
            "The circle must lie on the rim all round. Grey: where nothing was measured.", draw_profile(profile),
        ),
        Picture(
            "above", f"{standard.frames.name}: seen from above",
            f"Mean density from z = {seen.bottom_mm:.2f} to {seen.top_mm:.2f} mm, a tenth left out at either end, with "
            "the profile's circle where the cylinder is. Object frame: x to the right, y upwards.", above,
        ),
        Picture(
            "rim", f"{standard.frames.name}: density along the circle",
            "Around the circle the density must be even: a wave of one period says that the circle is off the "
            "cylinder's centre, and makes a histogram with two humps, as in the paper; orange is what whole voxels do. "
            "Outwards, the density falls through I_p at the profile's radius.", rim_png(result),
        ),
    ]  # fmt: skip


def _surface_figures(standard: Standard, result: SurfaceThreshold, volume: Volume, surface: Mesh) -> list[Picture]:
    from vialight.calibration.threshold.figures import surface_threshold_png

    placed = surface.moved(np.asarray(np.linalg.inv(result.registration.matrix), np.float64))
    return [
        Picture(
            "surface", f"{standard.frames.name}: density on the surface of {standard.known.name}",
            "Two slices through the middle with the given surface where the print lies: it must follow the steep flank "
            "all round, but for places where the two differ. The histogram must have one hump, with I_p in its middle.",
            surface_threshold_png(result, volume, placed),
        )
    ]  # fmt: skip


def _validated(
    standard: Standard, rig: Rig, options: StandardOptions, out: str | Path, progress: Progress | None,
    calibrated: tuple[float, float, ThresholdConditions],
) -> tuple[str, float, float, float, float]:  # fmt: skip
    """Return name, diameter and its uncertainty by profile, and by OST at the threshold found, mm."""
    threshold, std, conditions = calibrated
    profile, _ = profile_circle(standard.known, options, out)
    result, its_own = _rim(standard, profile, rig, options, out, progress)
    factor = conditions.factor_to(its_own, str(standard.frames))
    circle = radius_at(result.overhead, threshold * factor)
    seen_std = 2 * float(np.hypot(circle.radius_std_mm, std * factor / result.slope_per_mm))
    return standard.frames.name, profile.diameter_mm, 2 * profile.radius_std_mm, circle.diameter_mm, seen_std


def _findings(
    found: Sequence[_Found], factors: Sequence[float], mean: tuple[float, float],
    rows: Sequence[tuple[str, float, float, float, float]],
) -> Findings:  # fmt: skip
    (threshold, std), conditions = mean, found[0].conditions
    kinds = "the rim of a cylinder" if isinstance(found[0].result, RimThreshold) else "the surface of a print"
    method = f"density on {kinds}, from {len(found)} recording{'s' if len(found) > 1 else ''}"
    how = "mean along the profile's circle" if isinstance(found[0].result, RimThreshold) else "median on the surface"
    values = [Finding("resin", "threshold", threshold, std, f"{how}, counts per mm")]
    values += [
        Finding("resin.threshold_conditions", key, value, None, "of the recording")
        for key, value in conditions.model_dump().items()
    ]
    details = [_details(one, factor) for one, factor in zip(found, factors, strict=True)]
    names = ("frames", "profile_diameter_mm", "profile_std_mm", "ost_diameter_mm", "ost_std_mm")
    tables = [_standards_table(found, factors)]
    if rows:
        tables.append((
            "Validation", ("Cylinder", "profile, mm", "at I_p, mm", "difference, mm"),
            [(name, f"{a:.3f} ± {u:.3f}", f"{b:.3f} ± {v:.3f}", f"{b - a:+.3f}") for name, a, u, b, v in rows],
        ))  # fmt: skip
    return Findings(
        "threshold", method, values, _notes(found, conditions),
        {"standards": details, "validation": [dict(zip(names, row, strict=True)) for row in rows]}, tables,
    )  # fmt: skip


def _details(one: _Found, factor: float) -> dict[str, Any]:
    result = one.result
    details: dict[str, Any] = {
        "frames": one.standard.frames.name,
        "known": one.standard.known.name,
        "threshold": result.threshold,
        "std": result.std,
        "factor_to_first": factor,
        "slope_per_mm": result.slope_per_mm,
        "spread": result.spread,
    }
    if isinstance(result, RimThreshold):
        circle = result.overhead.circle
        details |= {
            "profile_diameter_mm": 2 * result.radius_mm,
            "profile_radius_std_mm": result.radius_std_mm,
            "centre_mm": [circle.x_mm, circle.y_mm],
            "bottom_mm": result.overhead.bottom_mm,
            "top_mm": result.overhead.top_mm,
            "share_of_contrast": result.level,
            "taper_mm": result.overhead.taper_mm,
            "diameter_std_mm": result.diameter_std_mm,
            "diameter_spread_mm": result.diameter_spread_mm,
            "spread_at_whole_voxels": float(result.decentred.std()),
            "blur_std_mm": result.blur_std_mm,
        }
    else:
        details["transform"] = result.registration.matrix.tolist()
    return details


def _standards_table(
    found: Sequence[_Found], factors: Sequence[float]
) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
    rows = []
    for one, factor in zip(found, factors, strict=True):
        result = one.result
        size = (
            f"{2 * result.radius_mm:.3f} ± {2 * result.radius_std_mm:.3f}" if isinstance(result, RimThreshold) else ""
        )
        rows.append((
            one.standard.frames.name, size, f"{result.threshold * factor:.2f} ± {result.std * factor:.2f}",
            f"{result.spread * factor:.2f}", f"{result.slope_per_mm * factor:.0f}",
            f"{2 * result.std / result.slope_per_mm:.4f}", f"{2 * result.spread / result.slope_per_mm:.4f}",
        ))  # fmt: skip
    heads = ("Standard", "diameter, mm", "I_p", "spread", "falls by, per mm", "diameter error of I_p, mm",
             "of the spread, mm")  # fmt: skip
    return "Standards", heads, rows


def _notes(found: Sequence[_Found], conditions: ThresholdConditions) -> list[str]:
    notes = []
    unknown = [key for key, value in conditions.model_dump().items() if value is None]
    if unknown:
        notes.append(
            f"Not known of the recording: {', '.join(unknown)}. The threshold is taken to hold for any; state them if "
            "they may change."
        )
    for one in found:
        # Gelled resin scatters more than liquid, and less than cured: far off the middle, a size may be wrong.
        if isinstance(one.result, RimThreshold) and not 0.3 < one.result.level < 0.7:
            half_mm = one.result.overhead.circle.diameter_mm
            notes.append(
                f"{one.standard.frames.name}: I_p lies at {one.result.level:.0%} of the contrast. At half of it the "
                f"cylinder is {half_mm:.3f} mm wide, in the profile {2 * one.result.radius_mm:.3f} mm: if gelling does "
                "not explain that, check --profile-pixel-mm and the rig's pixel_mm."
            )
    if len(found) == 1:
        notes.append(
            "From one standard: what makes prints differ from each other is not in the uncertainty. Calibrate with "
            "three or more to have it in."
        )
    return notes
