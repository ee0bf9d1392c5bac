"""What makes the calibration doubtful before there is light: told, but no reason not to print."""

from __future__ import annotations

import math
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from vialight.calibration.check.appearance import streaks_of
from vialight.calibration.check.checks import Check, drift_check, reference_checks, run_out_check, width_check
from vialight.calibration.edges import fit_circle, track_edges
from vialight.core.arrays import TURN_RAD, FloatArray
from vialight.core.config import Rig

_OLD_DAYS = 90.0
_BAND_MM = 2.0
"""About the optical row, whose rows are averaged."""


def doubts_of_rig(rig: Rig, now: datetime) -> list[str]:
    """Say what is doubtful of a rig by itself: calibrations that are old, conditions other than the threshold's.

    Parameters
    ----------
    rig
        As it was calibrated.
    now
        With its time zone.
    """
    told = []
    for name, calibration in (rig.calibration or {}).items():
        try:
            age_days = (now - datetime.fromisoformat(calibration.date).astimezone()).total_seconds() / 86400
        except ValueError:
            continue  # a date in somebody's own words
        if age_days > _OLD_DAYS:
            told.append(f"[calibration.{name}] is {age_days:.0f} days old")
    stated, actual = rig.resin.threshold_conditions, rig.imaged_under()
    if rig.resin.threshold is not None and stated is not None:
        factor = stated.factor_to(actual, rig.source)
        if not math.isclose(factor, 1.0, rel_tol=1e-6):
            changed = [
                f"{key} {value:g} instead of {getattr(stated, key):g}"
                for key, value in actual.model_dump(exclude_none=True).items()
                if getattr(stated, key) not in (None, value)
            ]
            told.append(f"the threshold is of other conditions, and is taken {factor:.3g} times as large: "
                        + ", ".join(changed))  # fmt: skip
    return told


def doubts_of_background(rig: Rig, counts: NDArray[np.uint16], angles_rad: FloatArray) -> list[str]:
    """Say what a turn in the dark shows: another vial, one that sits differently, lost focus, other light.

    Parameters
    ----------
    rig
        Of the recorded pixels.
    counts
        (frame, row, column) before there is light.
    angles_rad
        (frame,) of the stage.
    """
    try:
        return [check.told for check in _checks(rig, counts, angles_rad) if not check.good]
    except np.linalg.LinAlgError:  # an image that is no vial's: what it shows is for the operator, and no reason to end
        return ["the background does not look like a vial"]


def _checks(rig: Rig, counts: NDArray[np.uint16], angles_rad: FloatArray) -> list[Check]:
    camera, optics = rig.need_camera(), rig.imaging_optics()
    half, middle = max(2, round(_BAND_MM / camera.pixel_mm)), round(camera.optical_row)
    rows = slice(max(0, middle - half), max(1, middle + half))
    profiles = counts[:, rows].mean(axis=1, dtype=np.float64)
    if len(profiles) < 8 or not np.isfinite(profiles).all():
        return []
    level = profiles.mean(axis=1)
    turned = np.abs(angles_rad - angles_rad[0]) / TURN_RAD
    checks = [drift_check(float(np.polyfit(turned, level, 1)[0] / max(level.mean(), 1.0)))]
    if optics is None:
        return checks
    circle = fit_circle(track_edges(profiles, camera, optics), rig.stage.direction * angles_rad, camera, optics)
    if circle is not None:
        checks += width_check(circle, camera, optics)
        std_mm = float(np.sqrt(np.trace(circle.covariance_mm2)))
        checks.append(run_out_check(circle.run_out_mm, std_mm, rig))
    if rig.reference is not None:
        checks += reference_checks(streaks_of(profiles, camera, optics), None, rig.imaged_under(), rig.reference)
    return checks
