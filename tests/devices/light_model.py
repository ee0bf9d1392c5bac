"""The light's protocol as a finite machine: its processes, what can befall them, and all orders of their steps.

Time goes in ticks of 50 ms.  Every process that runs does one round of its loop a tick, in two steps where it looks
first and acts then; anything may happen between any two steps.  The rules are those of `vialight.devices.leasing`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Literal, NamedTuple

from vialight.devices import LEASE_S, Lease, LightPhase
from vialight.devices.leasing import Sight, Vigil, judge, leave

TICK_S = 0.05
DARK_TICKS = 5
"""0.25 s."""
LEASE_TICKS = round(LEASE_S / TICK_S)
GUARDIAN_SILENT_TICKS = 2
GRACE_TICKS = 6
"""In which an owner that was held up gives no leave: 0.3 s."""

Health = Literal["runs", "hung", "dead"]


class State(NamedTuple):
    """Where everything is between two steps."""

    is_stopped: bool = False
    is_fault: bool = False
    budget: int = 0
    """Things that may yet go wrong."""
    # The owner of the light.
    owner: Health = "runs"
    owner_did: int = 0
    """Steps of this tick's round: 2 when it is done."""
    given: LightPhase = LightPhase.DARK
    given_age: int = 0
    """Ticks since it decided what to give."""
    phase: LightPhase = LightPhase.DARK
    grace: int = 0
    # The lease.
    lease: LightPhase = LightPhase.DARK
    lease_left: int = 0
    # The projector.
    projector: Health = "runs"
    projector_did: int = 0
    wanted: bool = False
    is_lit: bool = False
    is_over: bool = False
    has_told_end: bool = False
    has_beaten: bool = True
    """Since the guardian looked."""
    # The guardian.
    guardian: Health = "runs"
    guardian_did: int = 0
    silent: int = 0
    had_leave: bool = False
    unwanted: int | None = None
    guardian_age: int = 0
    is_covered: bool = False
    false_alarm: bool = False
    since_event: int = DARK_TICKS + 1
    """Ticks since anything befell anyone; not counted beyond what is allowed."""
    owner_hung: int = 0
    """Ticks for which the owner has hung."""

    @property
    def is_seen(self) -> bool:
        """Whether light reaches the resin."""
        return self.is_lit and self.projector != "dead" and not self.is_covered


def steps(state: State) -> Iterator[State]:
    """Yield every state that can come next."""
    yield from _what_befalls(state)
    if state.owner == "runs" and state.owner_did < 2:
        yield _owner(state)
    if state.projector == "runs" and state.projector_did < 2:
        yield _projector(state)
    if state.guardian == "runs" and state.guardian_did < 1:
        yield _guardian(state)
    is_round_done = (
        (state.owner != "runs" or state.owner_did == 2)
        and (state.projector != "runs" or state.projector_did == 2)
        and (state.guardian != "runs" or state.guardian_did == 1)
    )
    if is_round_done:
        yield _tick(state)


def _what_befalls(state: State) -> Iterator[State]:
    if state.phase == LightPhase.DARK:
        yield state._replace(phase=LightPhase.LIT)
    now = state._replace(since_event=0)
    if not state.is_stopped:
        yield now._replace(is_stopped=True)
    if state.is_fault:
        yield now._replace(is_fault=False)
    for name in ("owner", "projector", "guardian"):
        if getattr(state, name) == "hung":
            yield _with(now, name, "runs")
    if not state.budget:
        return
    less = now._replace(budget=state.budget - 1)
    if not state.is_fault:
        yield less._replace(is_fault=True)
    for name in ("owner", "projector", "guardian"):
        if getattr(state, name) == "runs":
            yield _with(less, name, "hung")
            yield _with(less, name, "dead")


def _with(state: State, name: str, health: Health) -> State:
    changes: dict[str, Any] = {name: health}
    return state._replace(**changes)


def _owner(state: State) -> State:
    if state.owner_did == 0:
        grace = GRACE_TICKS if state.owner_hung > LEASE_TICKS else state.grace
        held = state.is_fault or grace > 0 or state.guardian_age >= GUARDIAN_SILENT_TICKS or state.guardian == "dead"
        over = state.projector == "dead"
        given = leave(LightPhase.OVER if over else state.phase, state.is_stopped, held)
        return state._replace(
            owner_did=1, given=given, given_age=0, phase=max(state.phase, given), grace=grace, owner_hung=0
        )
    left = max(0, LEASE_TICKS - state.given_age)  # it is counted from when the owner looked
    return state._replace(owner_did=2, lease=state.given, lease_left=left)


def _projector(state: State) -> State:
    if state.projector_did == 0:
        lease = Lease(state.lease, state.lease_left * TICK_S, 0.0, 0.0, 0.0, float("inf"))
        is_over, may_light = judge(state.is_over, state.is_stopped, lease, 0.0, 0.0)
        return state._replace(projector_did=1, is_over=is_over, wanted=may_light)
    told = state.has_told_end or (state.is_over and not state.wanted)
    return state._replace(projector_did=2, is_lit=state.wanted, has_told_end=told, has_beaten=True)


def _guardian(state: State) -> State:
    if state.projector == "dead":
        return state._replace(guardian_did=1, guardian_age=0, is_covered=True)
    unwanted_s = None if state.unwanted is None else state.unwanted * TICK_S
    vigil = Vigil(-TICK_S, 0.0, state.silent * TICK_S, state.had_leave, unwanted_s)
    until = state.lease_left * TICK_S if state.lease == LightPhase.LIT else -1.0
    why = vigil.alarm(
        Sight(0.0, float(state.has_beaten), state.is_lit, until, state.lease == LightPhase.LIT, state.is_stopped)
    )
    seen = state._replace(
        guardian_did=1, guardian_age=0, has_beaten=False,
        silent=min(round(vigil.silent_s / TICK_S), 4),
        had_leave=vigil.had_leave,
        unwanted=None if vigil.unwanted_s is None else round(vigil.unwanted_s / TICK_S),
    )  # fmt: skip
    if why is None:
        return seen
    return seen._replace(is_covered=True, projector="dead", false_alarm=state.projector == "runs")


def _tick(state: State) -> State:
    return state._replace(
        owner_did=0 if state.owner_did == 2 else state.owner_did,
        projector_did=0 if state.projector_did == 2 else state.projector_did,
        guardian_did=0,
        given_age=min(state.given_age + 1, LEASE_TICKS),
        grace=max(0, state.grace - 1),
        lease_left=max(0, state.lease_left - 1),
        guardian_age=min(state.guardian_age + 1, GUARDIAN_SILENT_TICKS) if state.guardian != "runs" else 0,
        since_event=min(state.since_event + 1, DARK_TICKS + 1),
        owner_hung=min(state.owner_hung + 1, LEASE_TICKS + 1) if state.owner != "runs" else 0,
    )


def broken(state: State) -> str | None:
    """Say which promise a state breaks; None where it keeps all.

    Where one thing befalls them after another, time counts from the last.  Nothing is promised while projector and
    guardian both are not well: that is what the lamp's own switch is for.
    """
    if not state.is_seen:
        return None
    if state.has_told_end:
        return "light after the projector has told its end"
    if state.projector != "runs" and state.guardian != "runs":
        return None
    reasons = {
        "stop": state.is_stopped,
        "fault": state.is_fault,
        "owner": state.owner != "runs",
        "projector": state.projector != "runs",
        "guardian": state.guardian != "runs",
    }
    why = [reason for reason, holds in reasons.items() if holds]
    return f"light more than 0.25 s after {', '.join(why)}" if why and state.since_event > DARK_TICKS else None


def explore(start: State) -> Iterator[tuple[State, Callable[[], str]]]:
    """Yield every state that can come to be, each once, with what tells the way to it."""
    came_from: dict[State, State | None] = {start: None}
    waiting = deque([start])
    while waiting:
        state = waiting.popleft()
        yield state, partial(_way_to, state, came_from)
        for after in steps(state):
            if after not in came_from:
                came_from[after] = state
                waiting.append(after)


def _way_to(state: State, came_from: dict[State, State | None]) -> str:
    lines: list[str] = []
    after, before = state, came_from[state]
    while before is not None:
        changes = {name: new for name, old, new in zip(State._fields, before, after, strict=True) if old != new}
        lines.append(str(changes))
        after, before = before, came_from[before]
    return "\n".join(reversed(lines))
