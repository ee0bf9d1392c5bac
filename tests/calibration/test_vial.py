"""Outer radius, index and distance, as far as frames determine them, and not a step farther."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.wobbling import RIG, WIDE, Recorded, axis_found, recorded, rig_with
from vialight.calibration.axis.estimator import AxisFit
from vialight.calibration.vial.bending import usual_widths
from vialight.calibration.vial.estimator import VialFit, bend_left, find_vial
from vialight.commands.calibrate import calibrate_vial
from vialight.core.config import Uncertainty
from vialight.core.errors import InputError
from vialight.store import rig_to_toml, write_frames
from vialight.store.rig_files import load_rig
from vialight.twin import Faults

TRUTH = np.array([12.4, 1.48, 190.0, 1.1, 1.472, 0.155])
WIDTHS = usual_widths(TRUTH)
WRONG = np.array([0.15, -0.01, -15.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def wide() -> Recorded:
    """Posts out to where the vial bends rays most."""
    return recorded(Faults(), posts=WIDE)


@pytest.fixture(scope="module")
def wrong_axis(wide: Recorded) -> AxisFit:
    """Found with a rig that has radius, index and distance wrong."""
    return axis_found(wide, off=-0.3 / 0.155, rig=rig_with(*(TRUTH + WRONG)))


@pytest.fixture(scope="module")
def found(wrong_axis: AxisFit) -> VialFit:
    return find_vial(wrong_axis, WIDTHS)


def test_all_three_are_covered_where_two_can_be_told_apart(found: VialFit) -> None:
    """Index and distance change the bend nearly alike: one of them is left alone, and the other not said to be sure."""
    assert found.free[0]
    assert found.free.sum() == 2
    assert (np.abs(found.values - TRUTH[:3]) <= 2 * found.std).all()
    assert abs(found.values[0] - 12.4) < 0.05  # of the 0.15 mm that it was off
    assert found.std[2] > 0.5 * WIDTHS[2]


def test_what_is_left_of_the_bend_is_nothing(found: VialFit) -> None:
    before, after = (np.degrees(bend_left(compared)[0]) for compared in (found.compared_before, found.compared))
    assert np.nanmedian(np.abs(before)) > 0.1
    assert np.nanmedian(np.abs(after)) < 0.02
    assert found.compared.rms < 0.3 * found.compared_before.rms
    assert found.misfit < 1.5


def test_an_index_that_is_known_lets_the_distance_be_found(wrong_axis: AxisFit) -> None:
    optics = wrong_axis.views.optics
    assert optics is not None
    known = replace(wrong_axis, views=replace(wrong_axis.views, optics=replace(optics, resin_index=1.48)))
    found = find_vial(known, WIDTHS * np.array([1.0, 0.01, 1.0, 1.0, 1.0, 0.1]))
    assert list(found.free) == [True, False, True]
    assert (np.abs(found.values - TRUTH[:3]) <= 2 * found.std).all()
    assert found.std[0] < 0.05
    assert found.std[2] < 6


def test_a_part_that_looks_alike_all_round_determines_no_more_than_the_edges_do(wrong_axis: AxisFit) -> None:
    counts = wrong_axis.views.counts
    still = replace(wrong_axis.views, counts=np.broadcast_to(counts.mean(axis=0), counts.shape).copy())
    found = find_vial(replace(wrong_axis, views=still), WIDTHS)
    assert list(found.free) == [True, False, False]
    assert abs(found.values[0] - 12.4) <= 2 * found.std[0]


def test_the_new_rig_and_its_page_say_what_was_found_and_what_was_left_alone(wide: Recorded, tmp_path: Path) -> None:
    known = Uncertainty(resin={"index_imaging": 0.0002})
    rig = rig_with(12.5, 1.48, 185.0, 1.1, 1.472, 0.155).model_copy(update={"uncertainty": known})
    (tmp_path / "rig.toml").write_text(rig_to_toml(rig), encoding="utf-8")
    write_frames(tmp_path / "frames.h5", wide.counts(1), wide.angles_rad, dark=wide.dark(1))
    result = calibrate_vial(tmp_path / "frames.h5", tmp_path / "rig.toml", tmp_path / "new.toml")
    new = load_rig(tmp_path / "new.toml")
    assert new.vial is not None
    assert new.uncertainty is not None
    assert new.uncertainty.vial is not None
    assert abs(new.vial.outer_radius_mm - 12.4) < 2 * new.uncertainty.vial["outer_radius_mm"]
    assert new.resin.index_imaging == 1.48
    assert result["details"]["left_alone"] == ["index_imaging"]
    assert len(result["details"]["singular_values"]) == 3
    page = (tmp_path / "new.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2
    assert "index_imaging is left alone" in page


def test_frames_that_tell_nothing_are_refused_with_a_picture(wide: Recorded, tmp_path: Path) -> None:
    alike = wide._replace(
        part=np.broadcast_to(wide.part.mean(axis=0), wide.part.shape), stray=np.full_like(wide.stray, 45)
    )
    (tmp_path / "rig.toml").write_text(rig_to_toml(RIG), encoding="utf-8")
    write_frames(tmp_path / "frames.h5", alike.counts(0), alike.angles_rad, dark=alike.dark(0))
    with pytest.raises(InputError, match="hardly depend on radius, index and distance"):
        calibrate_vial(tmp_path / "frames.h5", tmp_path / "rig.toml", tmp_path / "new.toml")
    assert (tmp_path / "new.refused.png").exists()
    assert not (tmp_path / "new.toml").exists()
