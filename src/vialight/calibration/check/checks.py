"""Is a calibration still good? What a recording looks like against what the rig, and a run that was good, say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.calibration.check.appearance import Streaks
from vialight.calibration.edges import EdgeCircle, edge_x_c_mm
from vialight.calibration.scale.edge_scale import STREAK_COLUMNS
from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics, Reference, Rig, ThresholdConditions
from vialight.optics.run_out import vial_centre_mm

SURE = 3.0
"""Standard uncertainties off from which on something has changed."""
LEAST_COLUMNS, LEAST_MM, LEAST_DRIFT = 0.1, 0.015, 0.01
"""Less than this matters to nobody: columns of the axis, mm of run-out, share of the light a turn."""
_BLURRED, _BLURRED_COLUMNS = 0.25, 0.3
"""Share, or columns, by which a streak may be wider: what is more has lost its focus."""
_PART_BLURRED = 0.5
"""Share by which the sharpest edges of a part may be softer: parts differ."""
_DIMMED = 0.1
"""Share by which the light may differ: as much as I_p then does."""
_MOVED_COLUMNS = 0.3


@dataclass(frozen=True)
class Check:
    """One thing that was compared.

    Parameters
    ----------
    what, unit
        In words.
    rig, found
        As it should be, and as it is.
    allowed
        By how much it may differ.
    means
        What has happened where it differs by more.
    """

    what: str
    rig: float
    found: float
    allowed: float
    unit: str
    means: str

    @property
    def good(self) -> bool:
        """Whether it is still as it should be."""
        return bool(abs(self.found - self.rig) <= self.allowed)

    @property
    def told(self) -> str:
        """Say in one line what is wrong."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.means}: {self.what} {self.found:.4g}{unit}, expected {self.rig:.4g} ± {self.allowed:.2g}"


def width_check(circle: EdgeCircle, camera: Camera, optics: Optics, binning: int = 1) -> list[Check]:
    """Compare the vial's width with the rig's, where both edges show; columns of the recording."""
    if not np.isfinite([circle.left, circle.right]).all():
        return []
    expected = 2 * edge_x_c_mm(optics) / camera.pixel_mm
    allowed = SURE * np.sqrt(2) * STREAK_COLUMNS
    return [
        Check("width of the vial", expected * binning, (circle.right - circle.left) * binning, allowed * binning,
              "columns", "another vial, or the camera has moved to or fro")
    ]  # fmt: skip


def run_out_check(found_mm: FloatArray, std_mm: float, rig: Rig) -> Check:
    """Compare where the vial's axis lies with the rig's run-out."""
    off = found_mm - np.array(vial_centre_mm(rig.stage.run_out))
    allowed = max(LEAST_MM, SURE * float(np.hypot(std_mm, stated_std(rig, "stage", "run_out.radius_mm"))))
    return Check("change of the run-out", 0.0, float(np.hypot(*off)), allowed, "mm", "the vial sits differently")


def drift_check(drift: float, std: float = 0.0) -> Check:
    """Compare the light's drift in a turn, as a share, with none."""
    return Check(
        "drift of the light in a turn", 0.0, drift, max(LEAST_DRIFT, SURE * std), "", "the imaging light drifts"
    )


def reference_checks(
    seen: Streaks | None, edge_columns: float | None, conditions: ThresholdConditions, reference: Reference
) -> list[Check]:
    """Compare sharpness and brightness with those of a run that was good.

    Parameters
    ----------
    seen
        The light at the vial's edges, in columns and counts of the recording.
    edge_columns
        How soft the part's sharpest edges are.
    conditions
        What the recording was taken under.
    reference
        The rig's.
    """
    checks = []
    if seen is not None and reference.streak_columns is not None:
        allowed = max(_BLURRED * reference.streak_columns, _BLURRED_COLUMNS)
        checks.append(Check("width of the light at the vial's edges", reference.streak_columns, seen.columns, allowed,
                            "columns", "the camera is out of focus"))  # fmt: skip
    if edge_columns is not None and reference.edge_columns is not None:
        allowed = max(_PART_BLURRED * reference.edge_columns, _BLURRED_COLUMNS)
        checks.append(Check("softness of the part's edges", reference.edge_columns, edge_columns, allowed, "columns",
                            "the camera is out of focus, or the part has no sharp edges"))  # fmt: skip
    if seen is not None and reference.streak_counts is not None:
        expected = reference.streak_counts * _factor(reference.conditions, conditions)
        checks.append(Check("light at the vial's edges", expected, seen.counts, _DIMMED * expected, "counts",
                            "the imaging light has changed, and I_p with it"))  # fmt: skip
    if seen is not None and np.isfinite(seen.middle) and reference.streak_middle_column is not None:
        checks.append(Check("middle between the vial's edges", reference.streak_middle_column, seen.middle,
                            _MOVED_COLUMNS, "column", "the camera or the vial has moved aside"))  # fmt: skip
    return checks


def stated_std(rig: Rig, table: str, key: str) -> float:
    """Return the standard uncertainty that a rig states; 0 where it states none."""
    stated = getattr(rig.uncertainty, table, None) if rig.uncertainty else None
    return float((stated or {}).get(key, 0.0))


def _factor(reference: ThresholdConditions | None, actual: ThresholdConditions) -> float:
    """Return by how much counts should be larger; what is not known of both is taken as equal."""
    if reference is None:
        return 1.0
    known = {key: value for key, value in reference.model_dump().items() if getattr(actual, key) is not None}
    return ThresholdConditions.model_validate(known).factor_to(actual, "")
