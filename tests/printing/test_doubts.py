"""What is told before there is light: old calibrations, other conditions, and what a turn in the dark shows."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
import pytest

from calibration.wobbling import PIXEL_MM, RIG, SHAPE
from vialight.core.arrays import FloatArray
from vialight.core.config import Reference, Rig
from vialight.printing.doubts import doubts_of_background, doubts_of_rig
from vialight.store.rig_files import changed_rig
from vialight.twin import Faults
from vialight.twin.camera import imager_for
from vialight.twin.sensor import Sensor, StrayLight

NOW = datetime(2026, 11, 26, tzinfo=UTC)
LIGHT = 60.0 * np.sqrt(2 * np.pi) * 0.3 / PIXEL_MM
"""Of the twin's stray light at an edge, summed across it."""
GOOD = Reference(streak_columns=0.3 / PIXEL_MM, streak_counts=LIGHT, streak_middle_column=RIG.need_camera().axis_column)


class Dark(NamedTuple):
    """A turn in the dark, without noise."""

    stray: FloatArray
    angles_rad: FloatArray


def dark(faults: Faults) -> Dark:
    """Return what the twin's camera sees of an empty vial that turns once."""
    angles = np.arange(60, dtype=np.float64) * (2 * np.pi / 60)
    return Dark(
        np.stack([StrayLight().image(imager_for(RIG, SHAPE, vial=faults.vial(float(angle)))) for angle in angles]),
        angles,
    )


@pytest.fixture(scope="module")
def still() -> Dark:
    return dark(Faults())


@pytest.fixture(scope="module")
def wobbling() -> Dark:
    return dark(Faults(run_out_mm=0.15))


def told(turn: Dark, rig: Rig, factor: float = 1.0) -> str:
    counts = Sensor().photograph(factor * turn.stray, np.random.default_rng(3))
    return "; ".join(doubts_of_background(rig, counts, turn.angles_rad))


def test_a_background_as_it_should_be_raises_no_doubt(still: Dark, wobbling: Dark) -> None:
    assert told(still, RIG.model_copy(update={"reference": GOOD})) == ""
    run_out = {"stage": {"run_out": {"radius_mm": 0.15, "phase_deg": 0.0}}}
    assert told(wobbling, changed_rig(RIG, run_out, "test")) == ""


@pytest.mark.parametrize(
    ("changes", "stray_factor", "expected"),
    [
        ({"vial": {"outer_radius_mm": 12.0}}, 1.0, "another vial"),
        ({"camera": {"pixel_mm": 0.152}}, 1.0, "another vial, or the camera has moved"),
        ({"reference": {"streak_columns": 1.2}}, 1.0, "out of focus"),
        ({"reference": {"streak_counts": LIGHT}}, 0.8, "the imaging light has changed"),
        ({"reference": {"streak_middle_column": 86.8}}, 1.0, "has moved aside"),
    ],
)
def test_what_has_changed_is_told(
    still: Dark, changes: dict[str, dict[str, float]], stray_factor: float, expected: str
) -> None:
    assert expected in told(still, changed_rig(RIG, changes, "test"), stray_factor)


def test_a_vial_that_sits_differently_and_light_that_drifts_are_told(wobbling: Dark, still: Dark) -> None:
    assert "sits differently" in told(wobbling, RIG)
    drift = np.linspace(1.0, 1.03, len(still.stray))[:, None, None]
    assert "the imaging light drifts" in told(still._replace(stray=drift * still.stray), RIG)


def test_an_image_that_is_no_vial_ends_nothing(still: Dark) -> None:
    noise = np.random.default_rng(0).integers(0, 4000, still.stray.shape).astype(np.uint16)
    doubts_of_background(RIG, noise, still.angles_rad)
    doubts_of_background(RIG, 0 * noise, still.angles_rad)


def test_old_calibrations_and_other_conditions_are_told() -> None:
    changes = {
        "calibration": {
            "axis": {"date": "2026-11-20T12:00:00+00:00"},
            "scale": {"date": "2026-05-01T12:00:00+00:00"},
            "resin": {"date": "last spring"},
        },
        "resin": {"threshold": 100.0, "threshold_conditions": {"exposure_s": 0.02, "binning": 1}},
        "camera": {"settings": {"exposure_s": 0.01}},
    }
    doubts = doubts_of_rig(changed_rig(RIG, changes, "test"), NOW)
    assert len(doubts) == 2
    assert "[calibration.scale] is 208 days old" in doubts[0]
    assert "0.5 times as large: exposure_s 0.01 instead of 0.02" in doubts[1]
