"""The rules of the light, without processes or clocks: what may be shown, and when a guardian has to step in.

Every process that has to do with the light calls these, and so does the test that goes through all orders in which
their steps can fall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from vialight.devices.protocols import Lease, LightPhase

LEASE_S = 0.15
"""For which a lease holds, by the wall clock: with a refresh it is over well within a quarter of a second."""
HUNG_S = 0.15
"""Without a sign of life after which a projector is taken for hung."""
DISOBEYED_S = 0.1
"""After which light that nobody has given leave for is covered."""
LOOK_S = 0.01
"""Between the guardian's looks."""
_MOST_A_LOOK_S = 0.05
"""That one look of the guardian counts: where the whole machine has stood still, nobody hangs."""


class Verdict(NamedTuple):
    """What a projector may do now."""

    is_over: bool
    """Whether the light has ended for good."""
    may_light: bool


def judge(was_over: bool, is_stopped: bool, lease: Lease | None, monotonic_s: float, now_s: float) -> Verdict:
    """Return whether light may be shown.

    Parameters
    ----------
    was_over
        Whether the light had ended already: that stays.
    is_stopped
        Whether the stop switch is pressed.
    lease
        The newest one; None before the first.
    monotonic_s, now_s
        By the wall clock, and by the print's.

    Examples
    --------
    >>> lit = Lease(LightPhase.LIT, 10.0, 0.0, 0.0, 0.0, float("inf"))
    >>> judge(False, False, lit, 9.9, 0.0).may_light, judge(False, False, lit, 10.0, 0.0).may_light
    (True, False)
    >>> judge(False, True, lit, 9.9, 0.0)
    Verdict(is_over=True, may_light=False)
    >>> judge(True, False, lit, 9.9, 0.0).may_light
    False
    """
    is_over = was_over or is_stopped or (lease is not None and lease.phase >= LightPhase.OVER)
    has_leave = lease is not None and lease.phase == LightPhase.LIT and monotonic_s < lease.until_monotonic_s
    return Verdict(is_over, not is_over and has_leave and lease is not None and now_s < lease.off_at_s)


def leave(phase: LightPhase, is_stopped: bool, is_held: bool) -> LightPhase:
    """Return the phase of the lease that the owner of the light gives.

    Parameters
    ----------
    phase
        How far the light has been let.
    is_stopped
        Whether the stop switch is pressed.
    is_held
        Whether anything is wrong.

    Examples
    --------
    >>> leave(LightPhase.LIT, False, False).name, leave(LightPhase.LIT, False, True).name
    ('LIT', 'DARK')
    >>> leave(LightPhase.LIT, True, False).name, leave(LightPhase.OVER, False, False).name
    ('OVER', 'OVER')
    """
    if is_stopped or phase >= LightPhase.OVER:
        return LightPhase.OVER
    return LightPhase.DARK if is_held else phase


class Sight(NamedTuple):
    """What the guardian sees at a look."""

    monotonic_s: float
    beat_s: float
    """Of the projector's newest sign of life."""
    is_lit: bool
    """Whether the projector says that it shows light."""
    leave_until_s: float
    """By the wall clock: when leave to show light ended, or will."""
    may_light: bool
    """Whether the newest lease is one for light, be it over or not."""
    is_stopped: bool


@dataclass
class Vigil:
    """What the guardian remembers between looks.

    A time only counts as far as the guardian itself was looking: where the machine stands still, both stand still.  A
    projector that hangs in the dark, and had no leave when it looked for one last, cannot light when it goes on: it is
    let be, so that a computer that is busy before the light ends no print.

    Examples
    --------
    >>> vigil = Vigil()
    >>> looks = [Sight(0.02 * k, 0.0, True, 99.0, True, False) for k in range(12)]
    >>> [vigil.alarm(look) for look in looks][-1]
    'has given no sign of life for 0.15 s'
    """

    last_s: float | None = None
    beat_s: float = 0.0
    silent_s: float = 0.0
    had_leave: bool = False
    """Whether there was a lease for light at the last look, or since the projector's last sign of life."""
    unwanted_s: float | None = None
    """None while there is no light that nobody has given leave for."""

    def alarm(self, sight: Sight) -> str | None:
        """Return why the light is to be covered; None while all is well."""
        passed = 0.0 if self.last_s is None else min(max(sight.monotonic_s - self.last_s, 0.0), _MOST_A_LOOK_S)
        self.last_s = sight.monotonic_s
        is_silent = sight.beat_s == self.beat_s
        self.silent_s = self.silent_s + passed if is_silent else 0.0
        self.beat_s = sight.beat_s
        could_light = self.had_leave or sight.may_light or sight.is_lit
        self.had_leave = could_light if is_silent else sight.may_light
        is_unwanted = sight.is_lit and (sight.is_stopped or sight.monotonic_s > sight.leave_until_s)
        before_s = 0.0 if self.unwanted_s is None else self.unwanted_s + passed
        self.unwanted_s = before_s if is_unwanted else None
        if self.silent_s >= HUNG_S and could_light:
            return f"has given no sign of life for {HUNG_S:g} s"
        if self.unwanted_s is not None and self.unwanted_s >= DISOBEYED_S:
            return f"has shown light without leave for {DISOBEYED_S:g} s"
        return None
