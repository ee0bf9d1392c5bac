"""When to stop, on print courses made by formula."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vialight.control.history import StopHistory, fresh_history, observe, places, sample
from vialight.control.prediction import predict, should_stop
from vialight.control.stop_model import Doubt, StopModel
from vialight.core.arrays import FloatArray, Grid
from vialight.core.errors import InputError
from vialight.store import read_json, write_json

SENSITIVITIES = np.array([0.6, 0.8, 1.0, 1.25, 1.6])
TURN_S = 18.0


def model_of(
    nominal_s: FloatArray, *, doubts: tuple[Doubt, ...] = (), waiting_s: FloatArray | None = None
) -> StopModel:
    """A part of 8 mm whose places cure at known times, and whose stop is due 3 % after the middle of them."""
    points = np.random.default_rng(1).uniform(-4, 4, (len(nominal_s), 3))
    return StopModel(
        points, 0.2, SENSITIVITIES, nominal_s / SENSITIVITIES[:, None], 1.03 * np.median(nominal_s) / SENSITIVITIES,
        doubts, TURN_S, np.zeros(12) if waiting_s is None else waiting_s,
    )  # fmt: skip


def spread_times(count: int = 1500, middle_s: float = 250.0, spread: float = 0.02) -> FloatArray:
    return np.asarray(middle_s * np.exp(spread * np.random.default_rng(2).normal(size=count)))


def seen_until(now_s: float, crossing_s: FloatArray) -> StopHistory:
    return StopHistory(now_s, np.zeros(len(crossing_s)), np.where(crossing_s <= now_s, crossing_s, np.nan))


# Of few places it is not known yet whether they are early or scatter little: noise of 1.5 % where 2 % is assumed at
# first moves the twentieth that is seen first by up to 1.6 times the difference.
@pytest.mark.parametrize(("share_cured", "within"), [(0.05, 0.01), (0.3, 0.005), (0.9, 0.003)])
@pytest.mark.parametrize("sensitivity", [0.55, 0.7, 1.0, 1.4, 1.9])
def test_the_sensitivity_is_found_from_those_places_that_have_cured(
    sensitivity: float, share_cured: float, within: float
) -> None:
    nominal = spread_times()
    model = model_of(nominal)
    noise = np.exp(0.015 * np.random.default_rng(3).normal(size=len(nominal)))
    crossing = nominal / sensitivity * noise
    found = predict(model, seen_until(float(np.quantile(crossing, share_cured)), crossing))
    assert found.is_ready
    assert found.sensitivity == pytest.approx(sensitivity, rel=within)
    assert found.best_s == pytest.approx(1.03 * np.median(nominal) / sensitivity, rel=within)


def test_places_not_seen_yet_hold_back_those_that_noise_let_cross_early() -> None:
    nominal = np.full(1500, 250.0)
    crossing = nominal * np.exp(0.02 * np.random.default_rng(3).normal(size=1500))
    now = float(np.quantile(crossing, 0.05))
    as_seen_alone = np.median(nominal[crossing <= now] / crossing[crossing <= now])
    assert as_seen_alone > 1.03
    assert predict(model_of(nominal), seen_until(now, crossing)).sensitivity == pytest.approx(1.0, abs=0.01)


def test_places_that_cure_at_any_other_time_pull_little() -> None:
    nominal = spread_times()
    rng = np.random.default_rng(4)
    crossing = nominal * np.exp(0.01 * rng.normal(size=len(nominal)))
    strange = rng.uniform(size=len(nominal)) < 0.1
    crossing[strange] = rng.uniform(150, 400, strange.sum())
    found = predict(model_of(nominal), seen_until(265.0, crossing))
    assert found.sensitivity == pytest.approx(1.0, abs=0.01)


def test_dust_that_is_bright_from_the_start_is_not_taken_for_resin() -> None:
    model = model_of(spread_times())
    crossing = np.full(1500, np.inf)
    crossing[::10] = 18.0
    dusty = predict(model, seen_until(60.0, crossing))
    assert not dusty.is_ready
    assert dusty.stop_s == pytest.approx(model.stop_s[2], rel=1e-6)


@pytest.mark.parametrize("stop_share", [0.97, 1.03])
@pytest.mark.parametrize("stray_share", [0.01, 0.02, 0.05])
def test_places_that_only_seem_to_have_cured_do_not_end_a_print_early(stray_share: float, stop_share: float) -> None:
    nominal = spread_times()
    model = replace(model_of(nominal), stop_s=stop_share * np.median(nominal) / SENSITIVITIES)
    crossing = nominal * np.exp(0.01 * np.random.default_rng(3).normal(size=len(nominal)))
    crossing[np.random.default_rng(6).choice(len(nominal), int(stray_share * len(nominal)), replace=False)] = 150.0
    best_s = float(model.stop_s[2])
    stops = [now for now in np.arange(152.0, 270.0, 0.5) if should_stop(predict(model, seen_until(now, crossing)), now)]
    assert stops[0] == pytest.approx(best_s, rel=0.05)


def test_nothing_seen_says_so_and_does_not_stop() -> None:
    model = model_of(spread_times())
    nothing = predict(model, fresh_history(model))
    assert nothing.sigma_s == np.inf
    assert not nothing.is_ready
    assert not should_stop(nothing, 1e9)


def test_one_corner_is_too_little_to_act_on() -> None:
    model = model_of(spread_times())
    corner = (model.points_mm > 1.5).all(axis=1)
    found = predict(model, StopHistory(200.0, np.zeros(1500), np.where(corner, 199.0, np.nan)))
    assert corner.sum() > 20
    assert not found.is_ready


def test_light_goes_off_at_the_stop_and_not_before() -> None:
    nominal = spread_times()
    found = predict(model_of(nominal), seen_until(250.0, nominal))
    assert not should_stop(found, found.stop_s - 0.01)
    assert should_stop(found, found.stop_s)


def test_a_doubt_that_moves_crossings_and_stop_alike_costs_nothing() -> None:
    nominal = spread_times()
    plain = predict(model_of(nominal), seen_until(250.0, nominal))
    alike = Doubt("lamp", np.full(len(nominal), 0.1), 0.1)
    apart = Doubt("threshold", np.full(len(nominal), 0.1), 0.0)
    doubted = predict(model_of(nominal, doubts=(alike,)), seen_until(250.0, nominal))
    assert doubted.sigma_s == pytest.approx(plain.sigma_s, rel=0.02)
    threshold = predict(model_of(nominal, doubts=(apart,)), seen_until(250.0, nominal))
    assert threshold.sigma_s == pytest.approx(np.hypot(plain.sigma_s, 0.1 * plain.best_s), rel=0.05)


def test_the_stated_uncertainty_is_that_of_worlds_in_which_the_doubts_come_true() -> None:
    nominal = spread_times()
    height = np.random.default_rng(1).uniform(-4, 4, (len(nominal), 3))[:, 2]
    doubts = (
        Doubt("threshold", np.full(len(nominal), 0.02), 0.0),
        Doubt("diffusion", 0.005 * height / 4, 0.01),
    )
    model = model_of(nominal, doubts=doubts)
    rng = np.random.default_rng(5)
    off = []
    for _ in range(60):
        z, ln_s = rng.normal(size=2), rng.uniform(np.log(0.7), np.log(1.4))
        change = z[0] * doubts[0].crossing_change + z[1] * doubts[1].crossing_change
        crossing = nominal * np.exp(change - ln_s + 0.01 * rng.normal(size=len(nominal)))
        true_stop = 1.03 * np.median(nominal) * np.exp(z[1] * 0.01 - ln_s)
        found = predict(model, seen_until(float(np.median(crossing)), crossing))
        off.append((found.best_s - true_stop) / found.sigma_s)
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.2
    assert np.mean(np.abs(off) < 2) > 0.9


def test_the_stop_moves_to_where_the_dose_is_even_as_far_as_that_is_worth() -> None:
    nominal = spread_times()
    history = seen_until(250.0, nominal)
    free = predict(model_of(nominal), history)
    assert free.stop_s == pytest.approx(free.best_s, abs=0.06)
    uneven = np.full(12, 100.0)
    uneven[0] = 0.0
    forced = predict(model_of(nominal, waiting_s=uneven), history)
    assert forced.best_s == free.best_s
    assert forced.stop_s == pytest.approx(TURN_S * round(free.best_s / TURN_S), abs=0.1)
    gentle = 0.3 * np.minimum(np.arange(12), 12 - np.arange(12))
    a_little = predict(model_of(nominal, waiting_s=gentle), history)
    assert 0.1 < free.best_s - a_little.stop_s < 1.0  # 5.8 s after a whole turn, back towards it


def test_reasons_are_told() -> None:
    nominal = spread_times()
    why = predict(model_of(nominal), seen_until(250.0, nominal)).why
    assert "of 1500 places have cured" in why
    assert "turns" in why


def test_a_crossing_lies_between_the_renewals_where_density_says_and_is_forgotten_when_density_falls_again() -> None:
    history = StopHistory(np.nan, np.full(3, np.nan), np.full(3, np.nan))
    for lit_s, density in ((10.0, [0, 50, 0]), (12.0, [0, 70, 59]), (14.0, [10, 50, 61]), (16.0, [20, 70, 80])):
        history = observe(history, np.array(density, dtype=np.float64), lit_s, 60.0)
    np.testing.assert_allclose(history.crossing_s, [np.nan, 15.0, 13.0])


def test_a_renewal_that_is_not_newer_changes_nothing() -> None:
    history = StopHistory(10.0, np.array([0.0]), np.array([np.nan]))
    assert observe(history, np.array([90.0]), 10.0, 60.0) is history


def test_a_place_is_the_mean_of_its_cube_whatever_the_live_volume_is_made_of() -> None:
    model = model_of(spread_times(300))
    for voxel in (0.05, 0.1, 0.155, 0.2):
        side = 2 * int(4.5 / voxel)
        grid = Grid((side + 1, side, side), voxel)
        z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij")
        ramp = (100 + 3 * x - 2 * y + z).astype(np.float32)
        # As the live volume lies in memory: z innermost.
        turned = np.ascontiguousarray(ramp.transpose(1, 2, 0)).transpose(2, 0, 1)
        expected = 100 + model.points_mm @ np.array([3.0, -2.0, 1.0])
        error = sample(turned, places(model, grid)) - expected
        assert np.abs(error).max() < 6 * voxel / 2
        assert abs(error.mean()) < 4 * error.std() / np.sqrt(len(error))


def test_places_that_the_camera_does_not_see_are_refused() -> None:
    with pytest.raises(InputError, match="does not see"):
        places(model_of(spread_times()), Grid((20, 20, 20), 0.1))


def test_a_model_comes_back_from_a_file(tmp_path: Path) -> None:
    nominal = spread_times(50)
    change = np.full(50, 0.1)
    change[3] = np.nan
    model = model_of(nominal, doubts=(Doubt("oxygen", change, -0.2),))
    write_json(tmp_path / "stop.json", model.to_json())
    back = StopModel.from_json(read_json(tmp_path / "stop.json"))
    np.testing.assert_allclose(back.crossing_s, model.crossing_s, atol=1e-3)
    np.testing.assert_array_equal(back.is_known, np.arange(50) != 3)
    assert back.doubts[0].name == "oxygen"
    history = seen_until(250.0, nominal)
    assert predict(back, history).best_s == pytest.approx(predict(model, history).best_s, abs=0.01)


def test_a_model_that_does_not_fit_together_is_refused() -> None:
    model = model_of(spread_times(50))
    for wrong in (
        {"crossing_s": model.crossing_s[:, :-1]},
        {"sensitivities": model.sensitivities[::-1]},
        {"stop_s": np.zeros(5)},
    ):
        with pytest.raises(InputError, match="stop model"):
            replace(model, **wrong)
    with pytest.raises(InputError, match="cannot be used"):
        StopModel.from_json({"points_mm": []})
