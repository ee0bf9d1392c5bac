"""No order of steps, and nothing that befalls one or two of its processes, leaves light where there must be none."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from devices import light_model
from devices.light_model import State, broken, explore
from vialight.devices import Lease, LightPhase
from vialight.devices.leasing import Verdict, Vigil, judge


def first_broken(start: State) -> tuple[str | None, int]:
    """Return the first promise that is broken with the way to it, and how many states were looked at."""
    count = 0
    for count, (state, way) in enumerate(explore(start), start=1):
        if (what := broken(state)) is not None:
            return f"{what}:\n{way()}", count
    return None, count


@pytest.mark.parametrize("faults", [0, 1, 2])
def test_every_promise_holds_in_every_order_of_steps(faults: int) -> None:
    found, states = first_broken(State(budget=faults))
    assert found is None
    assert states > 1000 * 10**faults


def test_no_projector_that_is_well_is_taken_for_hung() -> None:
    assert not any(state.false_alarm for state, _ in explore(State(budget=0)))


def test_light_is_shown_at_all() -> None:
    assert any(state.is_seen for state, _ in explore(State(budget=0)))


def test_without_a_guardian_a_hung_projector_would_be_found_lit(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the tests above see what they are there for."""

    @dataclass
    class Blind(Vigil):
        def alarm(self, sight: object) -> str | None:
            return None

    monkeypatch.setattr(light_model, "Vigil", Blind)
    assert (first_broken(State(budget=1))[0] or "").startswith("light more than 0.25 s after projector")


def test_projector_that_did_not_look_at_the_switch_would_be_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def forgetful(was_over: bool, is_stopped: bool, lease: Lease | None, monotonic_s: float, now_s: float) -> Verdict:
        return judge(False, False, lease, monotonic_s, now_s)

    def stubborn(phase: LightPhase, is_stopped: bool, is_held: bool) -> LightPhase:
        return LightPhase.DARK if is_held else phase

    monkeypatch.setattr(light_model, "judge", forgetful)
    monkeypatch.setattr(light_model, "leave", stubborn)
    monkeypatch.setattr(light_model, "Vigil", _Trusting)
    assert (first_broken(State())[0] or "").startswith("light more than 0.25 s after stop")


@dataclass
class _Trusting(Vigil):
    """A guardian that only looks for signs of life."""

    def alarm(self, sight: object) -> str | None:
        return None
