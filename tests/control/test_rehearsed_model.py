"""Rehearsals by formula, and `auto` from plan to stop on the twin."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin.rigs import patterns_of, printer, printer_without_glass
from vialight.control.rehearsal import Design, Rehearser, crossings_s, depth_in, lowest
from vialight.control.rehearsed_model import camera_resolution_mm, doubted_resins, stop_model_for, waiting_s
from vialight.core.arrays import Float32Array, Grid, Volume
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Plan
from vialight.metrology.surface import isosurface
from vialight.twin import find_rig, load_resin

sys.path[:0] = [str(Path(__file__).parents[2] / name) for name in ("examples", "benchmarks")]
simulated_print: Any = importlib.import_module("simulated_print")
stopping: Any = importlib.import_module("stopping")

RESIN = load_resin("DUDMA")


def ball(radius_mm: float) -> Mesh:
    grid = Grid((90, 90, 90), 0.1)
    distance = np.sqrt(grid.x_mm**2 + grid.y_mm[:, None] ** 2 + grid.z_mm[:, None, None] ** 2)
    return isosurface(Volume((radius_mm - distance).astype(np.float32), grid), 0.0)


def plan_of(images: np.ndarray, part: Mesh) -> Plan:
    grid = Grid((8, 20, 20), 0.4)
    return Plan(patterns_of(images), part, np.ones(grid.shape, np.float32), grid, printer_without_glass(0.0))


def test_a_ball_is_off_its_design_by_the_difference_of_their_radii() -> None:
    assert Design(ball(3.0)).rmse_mm(ball(3.12)) == pytest.approx(0.12, abs=0.002)
    assert Design(ball(3.0)).rmse_mm(ball(3.0)) < 0.002


def test_depth_is_that_below_the_surface_and_nothing_well_outside() -> None:
    grid = Grid((50, 50, 50), 0.2)
    depth = depth_in(ball(3.0), grid)
    distance = np.sqrt(grid.x_mm**2 + grid.y_mm[:, None] ** 2 + grid.z_mm[:, None, None] ** 2)
    inside = depth > 0
    assert np.abs(depth - (3.0 - distance))[inside].max() < 0.01
    assert not np.isfinite(depth[0, 0, 0])
    np.testing.assert_array_equal(inside, distance < 3.0)


def test_a_sudden_cure_is_seen_when_its_share_of_the_window_reaches_the_threshold() -> None:
    looks: Float32Array = np.zeros((40, 2), np.float32)
    looks[20:, 0] = 100.0  # from 63 s, or between that and the look before it
    seen = crossings_s(looks, 3.0, 6, 75.0)
    assert seen[0] == pytest.approx(61.5 + 0.75 * 18, abs=0.01)
    assert np.isnan(seen[1])


def test_the_least_of_errors_that_only_rise_is_the_first() -> None:
    assert lowest(np.arange(3.0), np.array([0.1, 0.2, 0.25])) == (0.0, 0.1)


def test_light_that_is_alike_from_all_sides_need_not_wait_for_a_whole_turn() -> None:
    plan = plan_of(np.full((48, 200, 200), 255, np.uint8), ball(2.0))
    near = np.abs(depth_in(plan.reference, plan.grid)) < 0.4
    assert waiting_s(plan, plan.rig, plan.grid, near).max() < 0.02


def test_light_from_one_direction_comes_all_at_once() -> None:
    images = np.zeros((48, 200, 200), np.uint8)
    images[8:12] = 255  # the third of twelve phases
    plan = plan_of(images, ball(2.0))
    near = np.abs(depth_in(plan.reference, plan.grid)) < 0.4
    share = np.arange(12) / 12
    # Of all beginnings, that share has it, a whole turn's worth, within so much of a turn.
    np.testing.assert_allclose(
        waiting_s(plan, plan.rig, plan.grid, near), 18.0 * np.sqrt(share * (1 - share)), atol=0.01
    )


def test_resolution_is_that_of_the_binned_pixels() -> None:
    rig = RESIN.in_vial_of(find_rig("orth2022-190"))
    fine = camera_resolution_mm(rig, 0.0)
    coarse = camera_resolution_mm(rig.model_copy(update={"camera": rig.need_camera().binned(4)}), 0.0)
    assert coarse == pytest.approx(4 * fine)


def test_a_doubted_resin_gels_by_as_much_light_unless_its_oxygen_is_doubted() -> None:
    critical = RESIN.chemistry.critical_dose_mj_per_cm2(0.08)
    doses = {name: resin.chemistry.critical_dose_mj_per_cm2(0.08) for name, resin in doubted_resins(RESIN).items()}
    changed = [name for name, dose in doses.items() if dose != pytest.approx(critical)]
    assert changed == ["oxygen, and so induction"]


def test_a_printer_of_unknown_brightness_cannot_be_rehearsed() -> None:
    plan = plan_of(np.full((8, 20, 20), 255, np.uint8), ball(2.0))
    with pytest.raises(InputError, match="how bright"):
        Rehearser(plan, printer(), RESIN, 0.4, 0.1)


def test_a_resin_that_never_gels_is_told() -> None:
    rig = find_rig("orth2022-190")
    plan = plan_of(np.zeros((8, 20, 20), np.uint8), ball(2.0))
    with pytest.raises(InputError, match="does not gel"):
        stop_model_for(plan, rig, RESIN, voxel_mm=0.4)


@pytest.fixture(scope="module")
def prepared() -> Any:
    return stopping.Prepared("boat", simulated_print.boat(), stopping.printer(), RESIN)


def test_a_rehearsal_finds_times_that_fall_as_sensitivity_rises(prepared: Any) -> None:
    model = prepared.model
    assert model.is_known.mean() > 0.99
    middle = np.median(model.crossing_s[:, model.is_known], axis=1)
    # But for the camera's lag of half a turn and the radicals' lifetime, the dose decides.
    dose = (middle - 9.0 - 1 / RESIN.chemistry.radical_decay_per_s) * model.sensitivities
    assert np.ptp(dose) / dose.mean() < 0.03
    assert (np.diff(model.stop_s) < 0).all()


def test_thin_posts_are_seen_to_cure_after_the_hull(prepared: Any) -> None:
    model = prepared.model
    z = model.points_mm[:, 2]
    hull, posts = (z < -0.2), (z > 0.2) & (z < 1.3)
    nominal = model.crossing_s[list(model.sensitivities).index(1.0)]
    assert posts.sum() > 5
    assert np.nanmedian(nominal[posts]) > np.nanmedian(nominal[hull])


@pytest.mark.parametrize("sensitivity", [0.75, 1.35])
def test_auto_stops_within_three_percent_of_the_best_dose(prepared: Any, sensitivity: float) -> None:
    row = stopping.measure(prepared, "", stopping.NOMINAL, sensitivity)
    assert abs(row.error) < stopping.GOAL_SHARE
    assert row.is_close
    assert row.covered
    assert row.found_sensitivity == pytest.approx(sensitivity, rel=0.02)
    assert row.ready_s < row.stop_s


def test_the_uncertainty_covers_a_wrong_threshold(prepared: Any) -> None:
    name = "scattering middle 10 % higher"
    row = stopping.measure(prepared, name, stopping.WRONG_RESINS[name], 1.0)
    assert 0.01 < row.error < stopping.LATEST_SHARE
    assert row.covered


def test_doubts_are_what_is_rehearsed(prepared: Any) -> None:
    by_name = {doubt.name: doubt for doubt in prepared.model.doubts}
    threshold = by_name["density at the gel point"]
    assert threshold.stop_change == 0.0
    assert np.nanmedian(threshold.crossing_change) > 0.01
