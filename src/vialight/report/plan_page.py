"""The page of a plan: what its patterns are expected to do, and what they look like."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vialight import __version__
from vialight.core.arrays import Float32Array
from vialight.core.plan import Plan
from vialight.planning.scoring import judged_voxels
from vialight.report.html import MINUS, NONE, TIMES, Image, write_page
from vialight.report.plan_figures import Dosed, dose_histogram_png, filmstrip_png, frame_png, slices_png
from vialight.store import rig_to_toml

_UNITS = {"mm": "mm", "deg": "°", "mj_per_cm2": "mJ/cm²", "s": "s"}
_SCORES = (
    ("jaccard", "Jaccard index", "of the part and what cures, at the best threshold"),
    ("best_threshold", "Best threshold", "dose from which on resin cures, at which that is; 1 is meant in the part"),
    ("process_window", "Process window", "least dose in the part less largest in the void, of the largest in the part"),
    ("in_part_dose_range", "In-part dose range", "largest less least, of the largest"),
    ("voxel_error_rate", "Voxel error rate", "void voxels dosed no less than the part's least, of all judged"),
    ("in_part_mean", "Mean dose in the part", "1 is meant"),
    ("in_part_std", "Standard deviation there", ""),
    ("void_max", "Largest dose in the void", ""),
    ("light_efficiency", "Light efficiency", "mean level of the patterns, of the brightest"),
)
_PERCENT = {"voxel_error_rate", "light_efficiency"}
_EXPOSURE = ("exposure_per_turn_mj_per_cm2", "turns_to_critical_exposure")
_METHODS_WITHOUT_VOID_LIMIT = {"normalised"}


class _Tile(NamedTuple):
    name: str
    value: str
    why: str


def write_plan_page(path: str | Path, plan: Plan, dose: Float32Array) -> None:
    """Write a plan's page as one HTML file that needs nothing but itself.

    No script, no network; pictures are inside.  The same plan and dose give the same file.

    Parameters
    ----------
    path
        The file to make; it appears whole, or not at all.
    plan
        Its settings, metrics and inputs are shown as they are; what is missing there is shown as missing.
    dose
        (z, y, x) float32, on the plan's grid, of one turn; 1 is meant inside the part.

    Raises
    ------
    InputError
        The file cannot be written, or the plan's rig has no projector.
    """
    write_page(path, "plan.html", lambda: _content(plan, dose))


def _content(plan: Plan, dose: Float32Array) -> dict[str, Any]:
    dosed = _dosed(plan, dose)
    believed = plan.metrics.get("believed")
    columns = [plan.metrics] + ([believed] if isinstance(believed, Mapping) else [])
    placement = plan.settings.get("placement")
    _, rows, cols = plan.patterns.levels.shape
    return {
        "part": plan.inputs.get("part", {}).get("file", "Part"),
        "method": str(plan.settings.get("method", "method not recorded")),
        "subtitle": f"{len(plan.patterns.levels)} patterns a turn, {cols} {TIMES} {rows} pixels, for "
        f"{plan.rig.resin.name or 'a resin without a name'}; expected from the finished 8-bit patterns.",
        "tiles": _tiles(plan),
        "figures": [
            (name, why, [_score(key, column.get(key)) for column in columns])
            for key, name, why in _SCORES
        ],
        "believed": len(columns) > 1,
        "images": _images(plan, dosed),
        "tables": [("Settings", _settings(plan)), ("Patterns and placement", _patterns(plan))],
        "matrix": None
        if placement is None
        else [[_minus(f"{float(value) + 0.0:.6f}") for value in row] for row in placement],
        "rig": rig_to_toml(plan.rig),
        "inputs": plan.inputs,
        "version": __version__,
    }  # fmt: skip


def _dosed(plan: Plan, dose: Float32Array) -> Dosed:
    grid, settings = plan.grid, plan.settings
    judged = judged_voxels(grid)
    inside = plan.target >= 0.5
    bounded = settings.get("method") not in _METHODS_WITHOUT_VOID_LIMIT or bool(settings.get("bound_void"))
    return Dosed(
        dose, inside & judged, ~inside & judged, _known(plan.metrics.get("best_threshold")),
        _known(settings.get("void_limit")) if bounded else None,
    )  # fmt: skip


def _tiles(plan: Plan) -> list[_Tile]:
    metrics, rig = plan.metrics, plan.rig
    threshold = _known(metrics.get("best_threshold"))
    tiles = [
        _Tile("Jaccard index", _score("jaccard", metrics.get("jaccard")),
              "no threshold known" if threshold is None else f"at the best threshold, a dose of {threshold:.3f}"),
        _Tile("process window", _score("process_window", metrics.get("process_window")), _window_words(metrics)),
        _Tile("in-part dose range", _score("in_part_dose_range", metrics.get("in_part_dose_range")),
              "of the largest dose in the part"),
        _Tile("voxel error rate", _score("voxel_error_rate", metrics.get("voxel_error_rate")),
              "void dosed like the part, of all voxels"),
        _Tile("light efficiency", _score("light_efficiency", metrics.get("light_efficiency")),
              "mean level of the patterns"),
    ]  # fmt: skip
    exposure, turns = (_known(metrics.get(name)) for name in _EXPOSURE)
    critical = rig.resin.critical_exposure_mj_per_cm2
    no_light = "the rig's projector has no irradiance_mw_per_cm2"
    if exposure is None:
        tiles.append(_Tile("exposure per turn", NONE, no_light))
    else:
        tiles.append(_Tile("exposure per turn", f"{exposure:.3g} mJ/cm²", "where the dose is the best threshold"))
    if turns is None:
        why = no_light if exposure is None else "the rig's resin has no critical_exposure_mj_per_cm2"
        tiles += [_Tile("turns to cure", NONE, why), _Tile("time to cure", NONE, why)]
    else:
        seconds = turns * 360 / rig.stage.speed_deg_s
        goal = "" if critical is None else f"to {critical:g} mJ/cm², the resin's critical exposure"
        tiles += [
            _Tile("turns to cure", f"{turns:.1f}", goal),
            _Tile("time to cure", f"{seconds:.0f} s", f"at {rig.stage.speed_deg_s:g}°/s"),
        ]
    return tiles


def _window_words(metrics: Mapping[str, Any]) -> str:
    window = _known(metrics.get("process_window"))
    if window is None:
        return "not known"
    return "some dose separates part and void" if window > 0 else "no dose separates part and void"


def _images(plan: Plan, dosed: Dosed) -> list[Image]:
    gamma = "On the screen, brightness is proportional to light, as grey levels are at the projector."
    first = f"{np.degrees(plan.patterns.angles_rad[0]):g}°"
    return [
        Image.of(
            dose_histogram_png(dosed), "Dose inside and outside the part",
            "As in Orth et al. 2022, Fig. S6: each histogram is of all voxels of its kind; below, the same with a log "
            "scale, down to a single voxel. The further the two lie apart, the more freedom in when to stop.",
            "Histograms of the dose of voxels in the part and out of it, with the best threshold.",
        ),
        Image.of(
            slices_png(dosed, plan), "Target, dose and outcome",
            "Where the part has most voxels in a slice, and through its middle; the line on the dose is the target's "
            f"outline. {_outcome_words(dosed)}",
            "Target, dose and what cures at the best threshold, in the planes XY, XZ and YZ.",
        ),
        Image.of(
            filmstrip_png(plan), "Patterns over the turn",
            f"Named by stage angle; scale bars in the plane of the axis, in air. {gamma}",
            "Patterns at angles spread evenly over the turn, in the projector's columns and rows.",
        ),
        Image.of(
            frame_png(plan), f"One frame of the projector, at {first}",
            "The whole image that is sent out. The part's outline is that of the body it sweeps as it turns, where "
            "refraction puts it.",
            "A whole projector image with the places of part, vial and rotation axis.",
        ),
    ]  # fmt: skip


def _outcome_words(dosed: Dosed) -> str:
    if dosed.threshold is None or not dosed.part.any():
        return "No threshold is known, so what cures is not shown."
    volume = int(dosed.part.sum())
    cures = dosed.dose >= dosed.threshold
    over, under = int((dosed.void & cures).sum()), int((dosed.part & ~cures).sum())
    return (
        f"At the best threshold, of the part's volume, {_percent(under / volume)} does not cure and "
        f"{_percent(over / volume)} cures outside it, over all heights."
    )


def _settings(plan: Plan) -> list[tuple[str, str]]:
    shown = {
        name: "not set" if value is None else value
        for name, value in plan.settings.items()
        if name not in ("placement", "placed_scale")
    }
    known = {key for key, _, _ in _SCORES} | {"believed", *_EXPOSURE}
    results = {name: value for name, value in plan.metrics.items() if name not in known}
    results = {f"{name} done" if name in shown else name: value for name, value in results.items()}
    return [_worded(name, value) for name, value in (shown | results).items()]


def _patterns(plan: Plan) -> list[tuple[str, str]]:
    patterns, grid = plan.patterns, plan.grid
    _, rows, columns = patterns.levels.shape
    z, y, x = grid.shape
    bounds = plan.reference.bounds_mm
    size = f" {TIMES} ".join(f"{value:.2f}" for value in bounds[1] - bounds[0])
    scale = plan.settings.get("placed_scale")
    return [
        ("patterns", f"{len(patterns.levels)}, one every {np.degrees(patterns.step_rad):g}°"),
        ("columns", f"{patterns.first_column} to {patterns.first_column + columns - 1}"),
        ("rows", f"{patterns.first_row} to {patterns.first_row + rows - 1}"),
        ("dose rate per level", f"{patterns.dose_rate_per_level:.4g} a radian"),
        ("voxels", f"{x} {TIMES} {y} {TIMES} {z} of {grid.voxel_mm:g} mm"),
        ("part as placed", f"{size} mm, z from {_minus(f'{bounds[0, 2]:.2f}')} to {_minus(f'{bounds[1, 2]:.2f}')} mm"),
        ("scale as placed", NONE if scale is None else f"{scale:.6g}"),
    ]


def _worded(name: str, value: Any) -> tuple[str, str]:
    """Return a recorded name without its unit, and the value with it."""
    for suffix, unit in _UNITS.items():
        if name.endswith(f"_{suffix}") and value is not None and not isinstance(value, str):
            gap = "" if unit == "°" else " "
            words = _value(value)
            return _spaced(name.removesuffix(f"_{suffix}")), f"{words}{gap}{unit}"
    return _spaced(name), _value(value)


def _spaced(name: str) -> str:
    return name.replace("_", " ")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return _minus(f"{value:.6g}") if math.isfinite(value) else NONE
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(_value(item) for item in value)
    return NONE if value is None else _minus(str(value)) if isinstance(value, int) else str(value)


def _score(name: str, value: Any) -> str:
    known = _known(value)
    if known is None:
        return NONE
    if name in _PERCENT:
        return _percent(known)
    return _minus(f"{known:.4f}" if name == "jaccard" else f"{known:.3f}")


def _percent(value: float) -> str:
    """Return a share in percent; what is more than nothing does not read as nothing."""
    if 0 < value < 5e-5:
        return "< 0.01 %"
    return f"{100 * value:.2f} %"


def _known(value: Any) -> float | None:
    """Return a number, or None where there is none: files have null for what is not finite."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _minus(text: str) -> str:
    return text.replace("-", MINUS)
