"""The one owner of a print's light: a thread that takes orders, and gives leave while everything is well.

Whoever wants something of the light tells this thread; nobody else gives leave.  How far the light is only goes one way
(`vialight.devices.LightPhase`): once it is over, here or on the stop switch, nothing can light any more.  When the
thread stalls or its process dies, the leave that it gave last runs out by itself.
"""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from vialight.devices import LEASE_S, DeviceError, DeviceGoneError, Devices, Lease, LightPhase
from vialight.devices.leasing import leave
from vialight.devices.panel import LightPanel
from vialight.printing.log import EventLog
from vialight.printing.track import StageFollower, StageTrack

BEAT_S = 0.025
"""Between renewals, by the wall clock."""
_LATE_S = 0.12
"""By the wall clock: a stage that has not told its position for longer is silent; one late answer is no fault."""
_DONE_S = 0.01
"""Light that is not worth a last flash."""
_SLOW_SHARE = 0.5
"""A stage at less than this share of its speed is taken for stopped."""
_AFTER_A_PAUSE_S = 0.3
"""That the light stays off after this process was held up itself: orders that came meanwhile are heard first."""

FaultCheck = Callable[[], str | None]
"""Says what is wrong; None while all is well.  Asked many times a second, on the light's thread: it must not wait."""


class LightOrder(NamedTuple):
    """What the owner of the light is told."""

    phase: LightPhase = LightPhase.DARK
    """How far the light is to go at least."""
    by: str = ""
    """Who ends it."""
    message: str = ""
    """For the log, where it ends."""


@dataclass(frozen=True)
class LightRules:
    """What the owner of the light goes by; all of it is asked at every beat, and must answer at once.

    Parameters
    ----------
    turning_rad_s
        By how much the object turns in a second, counter-clockwise positive as seen from above.
    lit_s_to_stop
        Returns after how much light the print ends, as far as known.
    checks
        Name to check.
    keep_going
        False ends the light for good.
    """

    turning_rad_s: float
    lit_s_to_stop: Callable[[], float] = lambda: math.inf
    checks: Mapping[str, FaultCheck] = field(default_factory=dict)
    keep_going: Callable[[], bool] = lambda: True


class LightOwner:
    """Asks the stage where it is, asks everyone whether all is well, and then renews the projector's lease.

    Parameters
    ----------
    devices
        Stage, projector and clock are used.
    track
        Takes the stage's positions.
    rules
        What it goes by.
    panel
        With the stop switch.
    log
        Takes changes of the light, and why.

    Attributes
    ----------
    lit_s, lit_rad : float
        For how long, and over which angle, light has been on.
    ended_by : str
        Who has ended the light; empty while it goes on.
    fault : str or None
        What holds the light now.
    """

    def __init__(
        self, devices: Devices, track: StageTrack, rules: LightRules, panel: LightPanel, log: EventLog
    ) -> None:
        self._devices, self._track, self._rules, self._panel, self._log = devices, track, rules, panel, log
        self._orders: queue.SimpleQueue[LightOrder] = queue.SimpleQueue()
        self._phase = LightPhase.DARK
        self._counted_until_s = 0.0
        self._was_lit = False
        self._beaten_s = self._held_until_s = 0.0
        self._stage: StageFollower | None = None
        self.lit_s = self.lit_rad = 0.0
        self.ended_by = ""
        self.fault: str | None = None
        self.pattern: int | None = None
        self.devices_health: dict[str, str] = {}
        self._thread = threading.Thread(target=self._run, name="light", daemon=True)

    @property
    def is_over(self) -> bool:
        """Whether the light has gone off for good."""
        return self._phase >= LightPhase.OVER

    def start(self) -> None:
        """Begin to follow the stage; the light stays off."""
        self._stage = StageFollower(self._devices.stage, self._track)
        self._thread.start()

    def permit(self) -> None:
        """Let light through from the next beat on, while all is well, unless it is over."""
        self._orders.put(LightOrder(LightPhase.LIT))

    def end(self, by: str, message: str = "") -> None:
        """End the light for good, now; does not wait."""
        self._panel.press_stop()
        self._orders.put(LightOrder(LightPhase.OVER, by, message))

    def close(self) -> None:
        """End the light, and the thread."""
        self.end("end")
        self._orders.put(LightOrder(LightPhase.CLOSED))
        if self._thread.is_alive():
            self._thread.join(2.0)
        if self._stage is not None:
            self._stage.close()

    def _run(self) -> None:
        try:
            while self._phase < LightPhase.CLOSED:
                self._hear(BEAT_S)
                self._beat()
        except Exception as error:
            self._panel.press_stop()
            self._end("fault", f"the light's owner has failed: {error}")
            self.fault = str(error)
            raise

    def _hear(self, timeout_s: float) -> None:
        """Obey orders, all that have come; wait for the first one."""
        with contextlib.suppress(queue.Empty):
            order = self._orders.get(timeout=timeout_s)
            while True:
                if order.phase == LightPhase.OVER:
                    self._end(order.by, order.message)
                self._phase = max(self._phase, order.phase)
                order = self._orders.get_nowait()

    def _end(self, by: str, message: str = "") -> None:
        """End the light, then say who did it."""
        try:
            if not self.is_over:
                self._devices.projector.end()
        finally:  # who sees that it is over also sees by whom
            is_news = by != "end" and self.ended_by in ("", "stop")
            if is_news:
                self.ended_by = by
            self._phase = max(self._phase, LightPhase.OVER)
        if is_news and message:
            self._log.note("light", message, lit_s=round(self.lit_s, 3))

    def _beat(self) -> None:
        now = time.monotonic()
        if not self.is_over and not self._rules.keep_going():
            self._panel.press_stop()
            self._end("operator", "stopped (operator)")
        if self._panel.is_stopped and not self.is_over:
            self._end("stop", "light off: the stop switch was pressed")
        held = self._held_up(now)
        fault = held or self._ask_everyone()
        if fault != self.fault:
            if self._phase == LightPhase.LIT or fault:
                is_held = self._phase == LightPhase.LIT
                self._log.note("fault" if fault else "well", fault or "all is well again", held_light=is_held)
            self.fault = fault
        newest, left_s = self._track.newest(), self._rules.lit_s_to_stop() - self.lit_s
        if self._phase == LightPhase.LIT and left_s <= _DONE_S:
            self._end("done", "light off: the print has had its light")
        given = leave(self._phase, self._panel.is_stopped, fault is not None or newest is None)
        if given == LightPhase.DARK:
            self._devices.projector.darken()
        elif given == LightPhase.LIT and newest is not None:
            sense = math.copysign(1.0, self._rules.turning_rad_s)
            off_at_s = self._devices.clock.now_s() + left_s if self._was_lit else math.inf
            self._devices.projector.renew(
                Lease(
                    LightPhase.LIT, now + LEASE_S, sense * newest.angle_rad, newest.time_s,
                    sense * self._track.speed_rad_s(), off_at_s,
                )
            )  # fmt: skip

    def _held_up(self, now_s: float) -> str | None:
        """Say whether this thread itself was held up for longer than a lease, a moment ago."""
        passed_s = now_s - self._beaten_s if self._beaten_s else 0.0
        self._beaten_s = now_s
        if passed_s > LEASE_S:
            self._held_until_s = now_s + _AFTER_A_PAUSE_S
        return "print: its process was held up" if now_s < self._held_until_s else None

    def _ask_everyone(self) -> str | None:
        health: dict[str, str] = {}
        if (stage := self._stage_fault()) is not None:
            health["stage"] = stage
        try:
            self._count_light()
        except DeviceError as error:
            health["projector"] = str(error)
            if isinstance(error, DeviceGoneError):
                self._end("fault", f"given up: {error}")
        for name, check in self._rules.checks.items():
            if told := check():
                health[name] = told
        self.devices_health = {name: told.removeprefix(f"{name}: ") for name, told in health.items()}
        return (
            "; ".join(f"{name}: {told}" if name not in told else told for name, told in self.devices_health.items())
            or None
        )

    def _stage_fault(self) -> str | None:
        told = None if self._stage is None else self._stage.fault(_LATE_S)
        if told is not None:
            return told
        speed, wanted = abs(self._track.speed_rad_s()), abs(self._rules.turning_rad_s)
        if self._phase == LightPhase.LIT and not speed >= _SLOW_SHARE * wanted:
            return f"turns at {math.degrees(speed):.1f} deg/s instead of {math.degrees(wanted):.1f}"
        return None

    def _count_light(self) -> None:
        """Add the time, and the angle, for which light was on since the last beat."""
        shown = self._devices.projector.shown()
        self.pattern, is_lit = shown.pattern, shown.pattern is not None
        now = self._devices.clock.now_s()
        begin = self._counted_until_s if self._was_lit else shown.since_s
        end = now if is_lit else shown.since_s
        if (is_lit or self._was_lit) and end > begin:
            self.lit_s += end - begin
            self.lit_rad += self._track.turned_rad(begin, end)
        if is_lit != self._was_lit:
            self._log.note("light", pattern=self.pattern, on=is_lit, lit_s=round(self.lit_s, 3))
        self._was_lit, self._counted_until_s = is_lit, now
