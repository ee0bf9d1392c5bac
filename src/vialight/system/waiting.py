"""The one way to wait for something: it always has an end, and ends at once where something is wrong."""

from __future__ import annotations

import time
from collections.abc import Callable

TICK_S = 0.02
"""Between looks, by the wall clock."""


def wait_for(
    condition: Callable[[], bool],
    faults: Callable[[], str | None] = lambda: None,
    timeout_s: float = 30.0,
    *,
    tick: Callable[[], None] = lambda: None,
    every_s: float = TICK_S,
) -> str | None:
    """Wait until a condition holds.

    Parameters
    ----------
    condition
        What is waited for.
    faults
        Says what makes waiting useless; None while nothing does.
    timeout_s
        After which it is given up, by the wall clock.
    tick
        Called between looks.
    every_s
        Between looks, by the wall clock.

    Returns
    -------
    str or None
        None where the condition holds, else why it was given up: the fault, or the time that has passed.

    Examples
    --------
    >>> wait_for(lambda: True)
    >>> wait_for(lambda: False, timeout_s=0.01)
    'not within 0.01 s'
    >>> wait_for(lambda: False, lambda: "the disk is full")
    'the disk is full'
    """
    deadline = time.monotonic() + timeout_s
    while not condition():
        if (fault := faults()) is not None:
            return fault
        left_s = deadline - time.monotonic()
        if left_s <= 0:
            return f"not within {timeout_s:g} s"
        tick()
        time.sleep(min(every_s, left_s))
    return None
