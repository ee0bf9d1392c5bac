"""Every wait has an end."""

from __future__ import annotations

from vialight.system import wait_for


def test_condition_that_holds_is_not_waited_for_even_where_something_is_wrong() -> None:
    assert wait_for(lambda: True, lambda: "a fault", timeout_s=0) is None


def test_fault_ends_a_wait_at_once_and_is_told() -> None:
    looks: list[int] = []

    def look() -> bool:
        looks.append(1)
        return False

    assert wait_for(look, lambda: "the disk is full", timeout_s=60) == "the disk is full"
    assert len(looks) == 1


def test_wait_without_an_end_ends_by_itself_and_has_ticked_meanwhile() -> None:
    ticks: list[int] = []
    told = wait_for(lambda: False, timeout_s=0.05, tick=lambda: ticks.append(1), every_s=0.01)
    assert told == "not within 0.05 s"
    assert 1 <= len(ticks) <= 6
