"""Recordings that the tests of calibration share."""

from __future__ import annotations

import pytest

from calibration.wobbling import Recorded, axis_found, recorded
from vialight.calibration.axis.estimator import AxisFit
from vialight.twin import Faults


@pytest.fixture(scope="session")
def wobbling() -> Recorded:
    """An axis that is off and leans, and a vial that goes round it."""
    return recorded(Faults(axis_offset_mm=(0.3, 0.0), run_out_mm=0.15, tilt_rad=(0.005, 0.0)))


@pytest.fixture(scope="session")
def still() -> Recorded:
    """The same part where nothing is wrong."""
    return recorded(Faults())


@pytest.fixture(scope="session")
def wobbling_axis(wobbling: Recorded) -> AxisFit:
    """Found from a rig that is four columns off and has the stage turn the wrong way."""
    return axis_found(wobbling, off=-4.0, sense=-1)
