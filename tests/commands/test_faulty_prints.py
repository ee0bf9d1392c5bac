"""Processes of a print are killed and stopped while it runs: dark in time, nothing lost, all angles true.

A short form of ``benchmarks/faults.py``, which goes through all processes, faults and moments, and every kind of Stop.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from devices.xvfb import needs_xvfb

sys.path[:0] = [str(Path(__file__).parents[2] / "benchmarks")]
fault_scenes: Any = importlib.import_module("fault_scenes")
faulty_prints: Any = importlib.import_module("faulty_prints")
Case = faulty_prints.Case

pytestmark = pytest.mark.alone

_SIMULATED = [
    Case("print", 0.0, "first light"),
    Case("print", 1.0, "printing", "page"),
    Case("projector", 1.0, "printing", "Ctrl-C"),
    Case("follower", 1.0, "background", "page"),
]
_IN_A_WINDOW = Case("projector", 1.0, "printing", "page", on_window=True)


def run(case: Any, scene: Any) -> Any:
    return faulty_prints.run_case(case, scene, np.random.default_rng())


@pytest.mark.parametrize("case", _SIMULATED, ids=str)
def test_print_is_dark_in_time_after_fault_and_stop_and_loses_nothing(case: Any) -> None:
    found = run(case, fault_scenes.SimulatedScene())
    assert not found.was_gone
    assert found.faults() == [], found
    assert found.acknowledged > 0
    assert found.was_lit == (case.moment == "printing") or case.moment == "first light"


@pytest.fixture
def window_scene() -> Iterator[Any]:
    with fault_scenes.window_scene() as scene:
        yield scene


@needs_xvfb
def test_window_of_a_stopped_projector_is_covered_and_stop_is_answered(window_scene: Any) -> None:
    found = run(_IN_A_WINDOW, window_scene)
    assert found.was_lit
    assert found.faults() == [], found
