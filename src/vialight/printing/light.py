"""Leave for the projector to show light, renewed many times a second while everything is well, and never otherwise."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from vialight.devices import LEASE_S, DeviceError, Devices, DeviceTimeoutError, Lease
from vialight.printing.log import EventLog
from vialight.printing.track import StageTrack

BEAT_S = 0.025
"""Between renewals, by the wall clock."""
_STAGE_TIMEOUT_S = 0.08
_LATE_S = 0.12
"""By the wall clock: a stage that has not told its position for longer is silent; one late answer is no fault."""
_DONE_S = 0.01
"""Light that is not worth a last flash."""
_SLOW_SHARE = 0.5
"""A stage at less than this share of its speed is taken for stopped."""

FaultCheck = Callable[[], str | None]
"""Says what is wrong; None while all is well."""


class LightKeeper:
    """Asks the stage where it is, asks everyone whether all is well, and then renews the projector's lease.

    It runs on a thread of its own.  When that thread stalls or the process dies, the lease runs out by itself.

    Parameters
    ----------
    devices
        Stage, projector and clock are used.
    track
        Takes the stage's positions.
    direction
        1 where the stage counts counter-clockwise seen from above, else -1.
    speed_rad_s
        That the stage should have.
    checks
        Name to check, asked at every beat.
    log
        Takes changes of the light, and why.

    Attributes
    ----------
    lit_s, lit_rad : float
        For how long, and over which angle, light has been on.
    is_over : bool
        Whether the light has gone off for good.
    fault : str or None
        What holds the light now.
    """

    def __init__(
        self, devices: Devices, track: StageTrack, direction: int, speed_rad_s: float, checks: dict[str, FaultCheck],
        log: EventLog,
    ) -> None:  # fmt: skip
        self._devices, self._track, self._direction = devices, track, direction
        self._speed, self._checks, self._log = speed_rad_s, checks, log
        self._is_wanted = False
        self._stop_lit_s = math.inf
        self._counted_until_s = 0.0
        self._was_lit = self._is_late = False
        self._ending = threading.Event()
        self.lit_s = self.lit_rad = 0.0
        self.is_over = False
        self.fault: str | None = None
        self.pattern: int | None = None
        self.devices_health: dict[str, str] = {}
        self._thread = threading.Thread(target=self._run, name="light", daemon=True)

    def start(self) -> None:
        """Begin to follow the stage; the light stays off."""
        self._thread.start()

    def light_on(self) -> None:
        """Let light through from the next beat on, while all is well."""
        self._is_wanted = True

    def stop_at(self, lit_s: float) -> None:
        """End the light for good when it has been on for so long; `math.inf` takes that back."""
        self._stop_lit_s = lit_s

    def light_off(self) -> None:
        """End the light for good, now."""
        self._is_wanted, self.is_over = False, True
        self._devices.projector.darken()

    def close(self) -> None:
        """End the thread; the light is off."""
        self.light_off()
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        try:
            while not self._ending.wait(BEAT_S):
                self._beat()
        except Exception as error:
            self._log.note("fault", f"the light's keeper has failed: {error}")
            self.fault = str(error)
            self.light_off()
            raise

    def _beat(self) -> None:
        fault = self._ask_everyone()
        if fault != self.fault:
            if self._is_wanted or fault:
                self._log.note("fault" if fault else "well", fault or "all is well again", held_light=self._is_wanted)
            self.fault = fault
        newest = self._track.newest()
        if fault or not self._is_wanted or newest is None:
            self._devices.projector.darken()
            return
        if self._is_late:
            return  # the lease, which is not renewed meanwhile, outlasts a late answer
        speed = self._track.speed_rad_s()
        left_s = self._stop_lit_s - self.lit_s
        if left_s <= _DONE_S:
            self._log.note("light", "light off: the print has had its light", lit_s=round(self.lit_s, 3))
            self.light_off()
            return
        now = self._devices.clock.now_s()
        self._devices.projector.renew(
            Lease(
                time.monotonic() + LEASE_S, self._direction * newest.angle_rad, newest.time_s, self._direction * speed,
                now + left_s if self._was_lit else math.inf,
            )
        )  # fmt: skip

    def _ask_everyone(self) -> str | None:
        health: dict[str, str] = {}
        try:
            self._track.add(self._devices.stage.position(_STAGE_TIMEOUT_S))
            speed = self._track.speed_rad_s()
            if self._is_wanted and not abs(speed) >= _SLOW_SHARE * self._speed:
                health["stage"] = (
                    f"turns at {math.degrees(abs(speed)):.1f} deg/s instead of {math.degrees(self._speed):.1f}"
                )
            self._is_late = False
        except DeviceTimeoutError as error:
            self._is_late = True
            newest, now = self._track.newest(), self._devices.clock.now_s()
            if newest is None or (now - newest.time_s) / self._devices.clock.rate > _LATE_S:
                health["stage"] = str(error)
        except DeviceError as error:
            health["stage"] = str(error)
        try:
            self._count_light()
        except DeviceError as error:
            health["projector"] = str(error)
        for name, check in self._checks.items():
            if told := check():
                health[name] = told
        self.devices_health = {name: told.removeprefix(f"{name}: ") for name, told in health.items()}
        return (
            "; ".join(f"{name}: {told}" if name not in told else told for name, told in self.devices_health.items())
            or None
        )

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
