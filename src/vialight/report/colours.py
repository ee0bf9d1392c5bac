"""Blue, white, red: the colours of a deviation, as in the figures of Orth et al. 2022."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vialight.core.arrays import FloatArray
from vialight.core.drawing import round_up
from vialight.metrology import Comparison

_STOPS = np.array([(24, 52, 148), (92, 134, 226), (255, 255, 255), (235, 112, 92), (160, 16, 32)], dtype=np.float64)
_UNKNOWN = (128, 128, 128)


def deviation_colours(deviation_mm: ArrayLike, limit_mm: float) -> NDArray[np.uint8]:
    """Colour deviations: blue where material is missing, white where there is none, red where it stands proud.

    Parameters
    ----------
    deviation_mm
        (n,) signed distances; NaN becomes grey.
    limit_mm
        The deviation, either way, at which the scale ends; beyond, the end's colour is kept.

    Returns
    -------
    numpy.ndarray
        (n, 3) uint8: red, green, blue.

    Examples
    --------
    >>> deviation_colours([-0.3, 0.0, 0.1, float("nan")], 0.1).tolist()
    [[24, 52, 148], [255, 255, 255], [160, 16, 32], [128, 128, 128]]
    """
    position = np.clip(np.asarray(deviation_mm, dtype=np.float64) / limit_mm, -1, 1)
    known = ~np.isnan(position)
    colours = np.empty((*position.shape, 3), dtype=np.uint8)
    colours[~known] = _UNKNOWN
    places = np.linspace(-1, 1, len(_STOPS))
    for channel in range(3):
        colours[known, channel] = np.rint(np.interp(position[known], places, _STOPS[:, channel]))
    return colours


def colour_limit_mm(comparison: Comparison) -> float:
    """Choose where the colour scale ends: the next of 1, 2, 5, 10 ... that 99 % of the print's surface does not exceed.

    Round steps keep the scale the same for prints of like quality.
    """
    part = comparison.reported.forward
    return round_up(float(np.quantile(np.abs(part.distance_mm[part.weights_mm2 > 0]), 0.99)))


def colour_ramp(count: int = 256) -> FloatArray:
    """Return (count, 3) colours from one end of the scale to the other, 0 to 1, for a colour bar."""
    return np.asarray(deviation_colours(np.linspace(-1, 1, count), 1.0) / 255)
