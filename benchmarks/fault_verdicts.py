"""What is asked of the light after a fault and after Stop, from the changes of light alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

DARK_WITHIN_S = 0.25


class Change(NamedTuple):
    """A change of light."""

    monotonic_s: float
    is_lit: bool


@dataclass
class Found:
    """What became of a print."""

    case: str
    victim: str
    fault: str
    was_gone: str = ""
    """Why the fault could not happen; empty where it did."""
    was_lit: bool = False
    """Whether there was light when the fault came."""
    dark_after_fault_s: float = 0.0
    dark_after_order_s: float | None = None
    lit_after_fault_s: float = 0.0
    """Light when there should be none, later than is allowed."""
    lit_after_stop_s: float = 0.0
    """Light later than is allowed after Stop."""
    late_s: float = 0.0
    """By how much this machine woke up a process too late meanwhile, at the most."""
    acknowledged: int = 0
    readable: int = 0
    lost: int = 0
    wrong_angles: int = 0
    largest_angle_deg: float = 0.0
    exit_code: int | None = None
    odd: list[str] = field(default_factory=list)
    """All else that should not be: hangs, tracebacks, processes that are left behind."""

    def faults(self) -> list[str]:
        """Say what was not as promised."""
        told = list(self.odd)
        if self.dark_after_fault_s > DARK_WITHIN_S:
            told.append(f"dark {self.dark_after_fault_s:.3f} s after the fault")
        if (self.dark_after_order_s or 0.0) > DARK_WITHIN_S:
            told.append(f"dark {self.dark_after_order_s:.3f} s after Stop")
        if self.lit_after_fault_s > 0:
            told.append(f"lit for {self.lit_after_fault_s:.3f} s while the fault lasted")
        if self.lit_after_stop_s > 0:
            told.append(f"lit for {self.lit_after_stop_s:.3f} s after Stop")
        if self.lost:
            told.append(f"{self.lost} frames lost of {self.acknowledged} acknowledged")
        if self.wrong_angles:
            told.append(f"{self.wrong_angles} angles wrong, by {self.largest_angle_deg:.2f} deg at most")
        return told


def judged(
    found: Found, victim: str, is_over: bool, changes: list[Change], fault_s: float, go_on_s: float | None,
    order_s: float | None,
) -> None:  # fmt: skip
    """Fill in what became of the light.

    Parameters
    ----------
    found
        What is filled in.
    victim
        The process; without the page all is well.
    is_over
        Whether the light had ended for good when the fault came.
    changes
        Of the light, in order.
    fault_s, go_on_s, order_s
        By `time.monotonic`: when the process was killed or stopped, when it was let go on, when Stop was given.

    Examples
    --------
    >>> lit = [Change(1.0, True), Change(2.1, False), Change(4.0, True), Change(4.5, False)]
    >>> judged(found := Found("", "print", "KILL"), "print", False, lit, 2.0, None, None)
    >>> round(found.dark_after_fault_s, 3), found.lit_after_fault_s
    (0.1, 0.5)
    """
    end_s = float("inf")
    found.was_lit = _is_lit(changes, fault_s)
    if victim != "page":
        if found.was_lit:
            blacks = [change.monotonic_s for change in changes if change.monotonic_s > fault_s and not change.is_lit]
            found.dark_after_fault_s = (blacks[0] if blacks else end_s) - fault_s
        # The live measurement is started again, whatever has become of its processes: then there may be light.
        if victim not in ("follower", "analyst") or is_over:
            until_s = end_s if go_on_s is None or is_over else go_on_s
            found.lit_after_fault_s = lit_between(changes, fault_s + DARK_WITHIN_S, until_s)
    if order_s is not None:
        last = max((end for begin, end in _lit_times(changes) if end > order_s), default=order_s)
        found.dark_after_order_s = last - order_s
        found.lit_after_stop_s = lit_between(changes, order_s + DARK_WITHIN_S, end_s)


def lit_between(changes: list[Change], begin_s: float, end_s: float) -> float:
    """Return for how long there was light between two times.

    Examples
    --------
    >>> lit_between([Change(1.0, True), Change(2.0, False), Change(3.0, True)], 1.5, 4.0)
    1.5
    """
    return sum(max(0.0, min(end, end_s) - max(begin, begin_s)) for begin, end in _lit_times(changes))


def _is_lit(changes: list[Change], at_s: float) -> bool:
    return any(begin <= at_s < end for begin, end in _lit_times(changes))


def _lit_times(changes: list[Change]) -> list[tuple[float, float]]:
    times: list[tuple[float, float]] = []
    begin: float | None = None
    for at_s, is_lit in changes:
        if is_lit and begin is None:
            begin = at_s
        elif not is_lit and begin is not None:
            times.append((begin, at_s))
            begin = None
    return times if begin is None else [*times, (begin, float("inf"))]
