"""What a print has not done by when its rehearsal had."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vialight.control.history import StopHistory
from vialight.control.prediction import crossings_at
from vialight.control.stop_model import StopModel
from vialight.core.arrays import FloatArray

LATE_SHARE = 1.2
"""Of the rehearsed time: what is seen to cure after this is late.  Some per cent are usual."""


class Lateness(NamedTuple):
    """Places that cured later than rehearsed, or not at all."""

    due_lit_s: float
    """Lit time at which the first of them was late."""
    at_mm: FloatArray
    """(xyz) middle of the block in which it lies."""
    blocks: int
    """Cubic millimetres in which more than half of what was due is late."""


def lateness(model: StopModel, history: StopHistory, sensitivity: float) -> Lateness | None:
    """Return where a print fell behind its rehearsal in resin of a sensitivity; None where it did not.

    Examples
    --------
    >>> points = np.random.default_rng(0).uniform(-5, 5, (4000, 3))
    >>> nominal_s = 200 + 5 * points[:, 2]
    >>> model = StopModel(
    ...     points, 0.2, np.array([0.5, 2.0]), np.outer([2.0, 0.5], nominal_s), np.array([400.0, 100.0]), (), 18.0,
    ...     np.zeros(12),
    ... )
    >>> seen_s = np.where(points[:, 0] > 4, np.nan, nominal_s)
    >>> late = lateness(model, StopHistory(280.0, np.zeros(4000), seen_s), 1.0)
    >>> 90 < late.blocks <= 100, bool(late.at_mm[0] > 4)
    (True, True)
    """
    limit_s = LATE_SHARE * crossings_at(model, sensitivity)
    with np.errstate(invalid="ignore"):
        is_due = limit_s < history.lit_s
        is_late = is_due & ~(history.crossing_s <= limit_s)
    due, late = (np.bincount(model.block, weights=which) for which in (is_due, is_late))
    blocks = np.flatnonzero(late > due / 2)
    members = is_late & np.isin(model.block, blocks)
    if not members.any():
        return None
    first = np.flatnonzero(members)[np.argmin(limit_s[members])]
    near = members & (model.block == model.block[first])
    return Lateness(float(limit_s[first]), model.points_mm[near].mean(axis=0), len(blocks))
