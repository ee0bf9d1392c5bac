"""What the camera sees of curing: cured resin scatters, and does so steeply beyond a certain conversion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.core.arrays import Float32Array
from vialight.core.errors import InputError


@dataclass(frozen=True)
class Scattering:
    """Scattering density as a function of conversion, ``density / (1 + (middle / c)^steepness)``.

    Its middle need not be the gel point: if it were, the density half-way up would mark the gelled surface by
    construction, and calibrating the threshold I_p on the twin would prove nothing.

    Parameters
    ----------
    counts_per_mm
        Density of fully scattering resin, in counts of one of the rig's pixels per mm of path, at the exposure and
        light that the rig is meant for; assumed, as in the shared cases.
    middle_conversion
        Conversion at which half of it is reached; assumed.
    steepness
        Exponent; assumed.

    Examples
    --------
    >>> Scattering(200.0, 0.15, 12.0).density(np.array([0.0, 0.15, 0.3], np.float32)).round(1)
    array([  0., 100., 200.], dtype=float32)
    """

    counts_per_mm: float = 200.0
    middle_conversion: float = 0.13
    steepness: float = 12.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise InputError("scattering", f"{name} is {value}", accepted="more than 0", remedy="correct it")

    def density(self, conversion: Float32Array) -> Float32Array:
        """Return counts per mm, of the shape of `conversion`."""
        ratio = np.maximum(conversion / np.float32(self.middle_conversion), 0) ** np.float32(self.steepness)
        return np.asarray(np.float32(self.counts_per_mm) * (ratio / (1 + ratio)), dtype=np.float32)
