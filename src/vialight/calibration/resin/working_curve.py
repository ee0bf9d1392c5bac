"""Critical exposure and penetration depth from cured depths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError

FEWEST = 3
"""Depths that a line and its scatter are had from."""


@dataclass(frozen=True)
class WorkingCurve:
    """Depth = penetration depth * ln(exposure / critical exposure).

    Parameters
    ----------
    penetration_mm, penetration_std_mm
        Depth at which the light has fallen to 1/e.
    critical_mj_per_cm2, critical_std_mj_per_cm2
        Exposure at the surface from which on resin gels there.
    scatter_mm
        Standard deviation of the depths about the line.
    exposure_mj_per_cm2, depth_mm
        What it was fitted to.
    """

    penetration_mm: float
    penetration_std_mm: float
    critical_mj_per_cm2: float
    critical_std_mj_per_cm2: float
    scatter_mm: float
    exposure_mj_per_cm2: FloatArray
    depth_mm: FloatArray

    @property
    def absorption_per_mm(self) -> float:
        """Napierian absorption."""
        return 1 / self.penetration_mm

    @property
    def absorption_std_per_mm(self) -> float:
        """Standard uncertainty of the absorption."""
        return self.penetration_std_mm / self.penetration_mm**2

    def depth_at(self, exposure_mj_per_cm2: FloatArray) -> FloatArray:
        """Return how deep an exposure cures, mm."""
        return np.asarray(self.penetration_mm * np.log(exposure_mj_per_cm2 / self.critical_mj_per_cm2))


def fit_working_curve(exposure_mj_per_cm2: FloatArray, depth_mm: FloatArray, where: object = "") -> WorkingCurve:
    """Fit the working curve of Jacobs (Rapid Prototyping & Manufacturing, 1992) by least squares.

    Parameters
    ----------
    exposure_mj_per_cm2
        (n,) at the resin's surface.
    depth_mm
        (n,) cured.
    where
        Named in errors.

    Raises
    ------
    InputError
        There are fewer than `FEWEST` depths, of fewer than two exposures, or they do not rise with the exposure.

    Examples
    --------
    >>> exposure = np.array([50.0, 100.0, 200.0, 400.0])
    >>> curve = fit_working_curve(exposure, 12.0 * np.log(exposure / 30.0))
    >>> round(curve.penetration_mm, 6), round(curve.critical_mj_per_cm2, 6)
    (12.0, 30.0)
    """
    if len(depth_mm) < FEWEST or np.ptp(exposure_mj_per_cm2) == 0:
        raise InputError(
            where, f"has {len(depth_mm)} depths of {len(np.unique(exposure_mj_per_cm2))} exposures",
            accepted=f"{FEWEST} or more depths, of two exposures or more", remedy="cure and measure more",
        )  # fmt: skip
    log = np.log(exposure_mj_per_cm2)
    centre = log.mean()
    spread = float(((log - centre) ** 2).sum())
    slope = float(((log - centre) * depth_mm).sum() / spread)
    if slope <= 0:
        raise InputError(
            where, f"depths change by {slope:.4g} mm for each factor e in exposure",
            accepted="depths that rise with the exposure", remedy="check the columns and their units",
        )  # fmt: skip
    mean = float(np.mean(depth_mm))
    left = depth_mm - mean - slope * (log - centre)
    variance = float((left**2).sum() / (len(depth_mm) - 2))
    # ln Ec = centre - mean/slope; at the centre, mean and slope are independent.
    log_critical = centre - mean / slope
    log_std = np.sqrt(variance * (1 / len(depth_mm) + (mean / slope) ** 2 / spread)) / slope
    critical = float(np.exp(log_critical))
    return WorkingCurve(
        slope, float(np.sqrt(variance / spread)), critical, float(critical * log_std), float(np.sqrt(variance)),
        exposure_mj_per_cm2, depth_mm,
    )  # fmt: skip
