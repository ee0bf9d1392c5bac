"""Clocks that every process of a print reads alike."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vialight.system import make_shared_file, map_shared_file, words_of

_BASE, _WALL, _RATE, _LIMIT, _FIELDS = range(5)
"""Time and wall time of the last change, rate, limit: of each of two records, behind the number of the newest."""
_WORDS = 1 + 2 * _FIELDS


@dataclass(frozen=True)
class MonotonicClock:
    """The system's monotonic clock: what hardware runs by."""

    rate: float = 1.0

    def now_s(self) -> float:
        """Return the time."""
        return time.monotonic()


class SimulatedClock:
    """A clock for simulated devices, that runs at any rate and stands still where the simulation cannot keep up.

    One process, the one that simulates, makes the clock and moves its limit; others read it.

    Parameters
    ----------
    path
        File that all of them map.
    rate
        Seconds of this clock in a second of the wall clock; given by who makes it.

    Examples
    --------
    >>> import tempfile
    >>> clock = SimulatedClock(Path(tempfile.mkdtemp()) / "clock", rate=1000.0)
    >>> clock.allow_until(0.5)
    >>> time.sleep(0.01)
    >>> SimulatedClock(clock.path).now_s()
    0.5
    """

    def __init__(self, path: Path, rate: float | None = None) -> None:
        self.path = path
        if rate is not None:
            make_shared_file(path, 8 * _WORDS)
        self._words = words_of(map_shared_file(path, 8 * _WORDS))
        self._numbers = self._words.view(np.float64)
        if rate is not None:
            self._write(0.0, time.monotonic(), rate, 0.0)

    def __reduce__(self) -> tuple[type[SimulatedClock], tuple[Path]]:
        return SimulatedClock, (self.path,)

    @property
    def rate(self) -> float:
        """Seconds of this clock in a second of the wall clock."""
        return self._read()[2]

    def now_s(self) -> float:
        """Return the time: it never goes back, and never beyond the limit."""
        base, wall, rate, limit = self._read()
        return min(base + rate * (time.monotonic() - wall), limit)

    def allow_until(self, limit_s: float) -> None:
        """Let time pass up to a limit; where it has waited at the last one, it goes on from there."""
        base, wall, rate, limit = self._read()
        now = time.monotonic()
        if base + rate * (now - wall) > limit:
            base, wall = limit, now
        self._write(base, wall, rate, limit_s)

    def _write(self, *record: float) -> None:
        """Write the older record, then say that it is the newest: a writer that dies in between holds up nobody."""
        number = int(self._words[0]) + 1
        self._numbers[_place(number)] = record
        self._words[0] = number

    def _read(self) -> tuple[float, float, float, float]:
        while True:
            number = int(self._words[0])
            base, wall, rate, limit = self._numbers[_place(number)].tolist()
            if number == int(self._words[0]):
                return base, wall, rate, limit


def _place(number: int) -> slice:
    begin = 1 + number % 2 * _FIELDS
    return slice(begin, begin + _FIELDS)
