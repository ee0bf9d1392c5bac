"""Rehearsals are computed once, and never taken for those of another plan, printer, resin or model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from printing.prints import quick_rig, write_quick_plan
from vialight.control import kept_rehearsals
from vialight.control.kept_rehearsals import kept_stop_model, rehearsal_key
from vialight.control.stop_model import StopModel
from vialight.core.plan import Plan
from vialight.store import read_plan
from vialight.twin import load_resin

RIG, RESIN = quick_rig(), load_resin("DUDMA")
MODEL = StopModel(
    np.zeros((2, 3)), 0.2, np.array([0.5, 2.0]), np.array([[2.0, np.nan], [1.0, 3.0]]), np.array([9.0, 4.0]), (),
    18.0, np.zeros(12),
)  # fmt: skip


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return read_plan(write_quick_plan(tmp_path)[0])


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    made: list[int] = []
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def rehearsed(*_: object, **__: object) -> StopModel:
        made.append(1)
        return MODEL

    monkeypatch.setattr(kept_rehearsals, "stop_model_for", rehearsed)
    return made


def test_a_rehearsal_is_computed_once(plan: Plan, calls: list[int]) -> None:
    first, second = (kept_stop_model(plan, RIG, RESIN) for _ in range(2))
    assert len(calls) == 1
    assert first is MODEL
    np.testing.assert_array_equal(second.crossing_s, MODEL.crossing_s)
    np.testing.assert_array_equal(second.stop_s, MODEL.stop_s)


def test_a_file_that_is_damaged_is_made_again(plan: Plan, calls: list[int], tmp_path: Path) -> None:
    kept_stop_model(plan, RIG, RESIN)
    (kept,) = (tmp_path / "cache").rglob("*.json")
    kept.write_text(kept.read_text()[:50])
    kept_stop_model(plan, RIG, RESIN)
    assert len(calls) == 2


def test_a_cache_that_cannot_be_written_stops_no_print(
    plan: Plan, calls: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert kept_stop_model(plan, RIG, RESIN) is MODEL


def test_whatever_differs_is_another_rehearsal(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    levels = plan.patterns.levels.copy()
    levels[0, 0, 0] ^= 1
    dimmer = RIG.need_projector().model_copy(update={"irradiance_mw_per_cm2": 499.0})
    others = [
        (replace(plan, patterns=replace(plan.patterns, levels=levels)), RIG, RESIN),
        (replace(plan, patterns=replace(plan.patterns, dose_rate_per_level=1e-3)), RIG, RESIN),
        (replace(plan, reference=plan.reference.moved(np.eye(4) * [1.1, 1.1, 1.1, 1])), RIG, RESIN),
        (plan, RIG.model_copy(update={"projector": dimmer}), RESIN),
        (plan, RIG, replace(RESIN, chemistry=replace(RESIN.chemistry, sensitivity=1.2))),
        (plan, RIG, load_resin("BPAGDA")),
    ]
    keys = {rehearsal_key(*one, 0.2) for one in [(plan, RIG, RESIN), *others]}
    assert len(keys) == len(others) + 1
    assert rehearsal_key(plan, quick_rig(), load_resin("DUDMA"), 0.2) in keys
    monkeypatch.setattr(kept_rehearsals, "_MODEL", ("twin",))  # as if the code were another
    assert rehearsal_key(plan, RIG, RESIN, 0.2) not in keys
    assert rehearsal_key(plan, RIG, RESIN, 0.3) not in keys
