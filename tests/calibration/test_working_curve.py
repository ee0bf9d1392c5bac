from __future__ import annotations

import numpy as np
import pytest

from vialight.calibration.resin.working_curve import fit_working_curve
from vialight.core.errors import InputError


def test_stated_uncertainties_cover_the_truth_in_most_of_many_draws() -> None:
    rng = np.random.default_rng(0)
    exposure = np.geomspace(40.0, 600.0, 12)
    curves = [fit_working_curve(exposure, 12.0 * np.log(exposure / 30.0) + rng.normal(0, 0.4, 12)) for _ in range(400)]
    # Student's t with 10 degrees of freedom: 95 % within 2.23 standard uncertainties.
    for off in (
        [(curve.penetration_mm - 12.0) / curve.penetration_std_mm for curve in curves],
        [(curve.critical_mj_per_cm2 - 30.0) / curve.critical_std_mj_per_cm2 for curve in curves],
    ):
        assert 0.92 < np.mean(np.abs(off) < 2.23) < 0.98


@pytest.mark.parametrize(
    ("exposure", "depth", "told"),
    [
        ([50.0, 100.0], [3.0, 6.0], "2 depths"),
        ([50.0, 50.0, 50.0], [3.0, 3.1, 2.9], "1 exposures"),
        ([50.0, 100.0, 200.0], [6.0, 3.0, 1.0], "rise"),
    ],
)
def test_what_is_no_working_curve_is_refused(exposure: list[float], depth: list[float], told: str) -> None:
    with pytest.raises(InputError, match=told):
        fit_working_curve(np.array(exposure), np.array(depth), "depths.csv")
