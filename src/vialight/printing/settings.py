"""How to print: who ends it, and when at the latest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from vialight.core.errors import InputError

StopMode = Literal["auto", "manual", "turns"]


@dataclass(frozen=True)
class PrintSettings:
    """How to print.

    Parameters
    ----------
    stop
        Who ends it: the forecast, the operator, or a number of turns.
    turns
        Of light, where that ends it.
    longest_turns
        Of light, after which it ends in any case.
    after_turns
        Of imaging once the light is off; their frames make the final shape.
    frame_rate_hz
        Of the camera.
    give_up_s
        For which a fault may hold the light before the print ends.
    """

    stop: StopMode = "auto"
    turns: float | None = None
    longest_turns: float = 40.0
    after_turns: float = 1.0
    frame_rate_hz: float = 10.0
    give_up_s: float = 60.0

    def __post_init__(self) -> None:
        if self.stop == "turns" and not (self.turns is not None and 0 < self.turns <= 1000):
            raise InputError("--stop", f"turns is {self.turns}", accepted="a positive number", remedy="correct it")
        if not (math.isfinite(self.frame_rate_hz) and 0.5 <= self.frame_rate_hz <= 200):
            raise InputError("frame rate", f"is {self.frame_rate_hz} /s", accepted="0.5 to 200")


def stop_settings(stop: str, **others: float) -> PrintSettings:
    """Return settings for ``auto``, ``manual`` or ``turns=N``.

    Examples
    --------
    >>> stop_settings("turns=17").turns
    17.0

    Raises
    ------
    InputError
        It is none of these.
    """
    if stop in ("auto", "manual"):
        return PrintSettings("auto" if stop == "auto" else "manual", **others)
    name, _, count = stop.partition("=")
    try:
        if name == "turns":
            return PrintSettings("turns", float(count), **others)
    except ValueError:
        pass
    raise InputError("--stop", f"is {stop!r}", accepted="auto, manual, turns=N", remedy="choose one")
