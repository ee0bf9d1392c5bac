"""The imaging conditions that counts depend on, and by how much."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from pydantic import Field

from vialight.core.config.fields import Finite, Length, Table
from vialight.core.errors import InputError


class ThresholdConditions(Table):
    """The imaging conditions that a gelation threshold belongs to.

    ``binning`` counts the camera's own pixels along a side of those that are reconstructed from.
    """

    exposure_s: Length | None = None
    gain_db: Finite | None = None
    led_level: Length | None = None
    binning: Annotated[int, Field(ge=1)] | None = None

    def factor_to(self, actual: ThresholdConditions, where: str) -> float:
        """Return by how much counts are larger under other conditions; what is not stated here is taken as equal.

        Counts are proportional to exposure, light and gain (20 dB a factor of 10), and sums over binned pixels.

        Raises
        ------
        InputError
            A condition is stated here, but not known there.

        Examples
        --------
        >>> known = ThresholdConditions(exposure_s=0.02, gain_db=0.0, binning=4)
        >>> known.factor_to(ThresholdConditions(exposure_s=0.01, gain_db=20.0, binning=2), "rig.toml")
        1.25
        """
        factor = 1.0
        for name in type(self).model_fields:
            stated, now = getattr(self, name), getattr(actual, name)
            if stated is not None and now is None:
                raise InputError(
                    f"{where} [resin.threshold_conditions]", f"{name} is {stated}, but that of the frames is not known",
                    accepted="frames, or a rig's [camera] (led_level) or [camera.settings], that say it",
                    remedy="add it there, or give --threshold",
                )  # fmt: skip
            if stated is not None:
                factor *= _COUNTS[name](now) / _COUNTS[name](stated)
        return factor


_COUNTS: dict[str, Callable[[float], float]] = {
    "exposure_s": lambda seconds: seconds,
    "gain_db": lambda decibels: 10 ** (decibels / 20),
    "led_level": lambda level: level,
    "binning": lambda pixels: pixels**2,
}
"""What counts are proportional to."""
