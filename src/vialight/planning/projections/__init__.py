"""From a target to the light patterns that print it.

- `forward`: from projections to dose, and its transpose
- `methods`, `descent`: they optimise projections against `goals`
- `given`: projections that were computed elsewhere
- `patterns`: grey levels of a projector

`optimise` runs a method.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import get_args

from vialight.core.errors import InputError
from vialight.planning.projections.descent import gradient
from vialight.planning.projections.forward import Light, dose_of, light_for, strip_positions
from vialight.planning.projections.given import lay_in_vial
from vialight.planning.projections.goals import VOID_LIMIT, Goal, State
from vialight.planning.projections.methods import CEILING, Method, MethodName, normalised, object_space, osmo
from vialight.planning.projections.patterns import full_turn, make_patterns

__all__ = [
    "CEILING",
    "DEFAULT_PASSES",
    "VOID_LIMIT",
    "Goal",
    "Light",
    "MethodName",
    "State",
    "dose_of",
    "full_turn",
    "lay_in_vial",
    "light_for",
    "make_patterns",
    "method_named",
    "optimise",
    "strip_positions",
]

DEFAULT_PASSES: dict[MethodName, int] = {"object-space": 20, "osmo": 20, "gradient": 4, "normalised": 2}

Progress = Callable[[int, int], None]


def method_named(name: MethodName, **parameters: float | bool | None) -> Method:
    """Return a method by its name, with parameters of its own set.

    Raises
    ------
    InputError
        There is no such method.
    """
    methods: dict[str, Method] = {
        "object-space": object_space, "osmo": osmo, "gradient": gradient, "normalised": normalised,
    }  # fmt: skip
    if name not in methods:
        raise InputError("--method", f"is {name!r}", accepted=", ".join(get_args(MethodName)))
    return partial(methods[name], **parameters)


def optimise(
    goal: Goal,
    light: Light,
    method: Method,
    passes: int,
    *,
    state: State | None = None,
    progress: Progress | None = None,
    keep_going: Callable[[], bool] = lambda: True,
) -> tuple[State, State]:
    """Run a method for a number of passes.

    Parameters
    ----------
    goal, light
        What is wanted, and the forward model.
    method
        See `method_named`.
    passes
        To do, those of `state` included.
    state
        To go on from.
    progress
        Called with passes done and to do.
    keep_going
        Asked after each pass: False ends the run.

    Returns
    -------
    best, last : State
        That of the lowest cost (of `Goal.cost_of`), whose projections to use, and the last, to go on from.
    """
    best, best_cost = state, float("inf") if state is None else goal.cost_of(state.dose)
    last = state
    for last in method(goal, light, state):
        cost = goal.cost_of(last.dose)
        if best is None or cost <= best_cost:
            best, best_cost = last, cost
        if progress:
            progress(last.passes, passes)
        if last.passes >= passes or not keep_going():
            break
    assert best is not None  # for mypy: a method yields at least once
    assert last is not None
    return best, last
