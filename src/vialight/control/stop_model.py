"""What is believed, before a print, of when each place will be seen to cure and when the light should go off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vialight.core.arrays import BoolArray, FloatArray, IntArray
from vialight.core.errors import InputError

REHEARSAL = "rehearsal.json"

FEWEST_TURNS = 5.0
"""Of light, for a forecast that comes in time: what is seen is the mean of the last turn, and the last fifth of a print
is much of a turn where it has few."""

BLOCK_MM = 1.0
"""Places in a cube of this edge err together: between them they count as one."""

_FARTHEST_MM = 1e4


@dataclass(frozen=True)
class Doubt:
    """One thing about the resin that the model may have wrong, by one standard deviation of its prior.

    Parameters
    ----------
    name
        What it is.
    crossing_change
        (place,) change of the logarithm of the time at which each place is seen to cure; NaN where it never is.
    stop_change
        Change of the logarithm of the time at which the light should go off.
    """

    name: str
    crossing_change: FloatArray = field(repr=False)
    stop_change: float


@dataclass(frozen=True)
class StopModel:
    """When places are seen to cure, and when to stop, by the resin's sensitivity.

    Parameters
    ----------
    points_mm
        (place, xyz) middles of the places watched, object frame.
    size_mm
        Edge of the cube whose mean density is watched.
    sensitivities
        (resin,) relative to nominal, ascending, 2 or more.
    crossing_s
        (resin, place) lit time at which each place's density passes that at the gel point in the live volume, which is
        the mean of the last turn; NaN where it never does before the print is overdone.
    stop_s
        (resin,) lit time at which light should go off.
    doubts
        What else may be wrong.
    turn_s
        Of the stage.
    waiting_s
        (phase,) what stopping in each phase of a turn costs, as if the light went off so many seconds wrong: the
        unevenness of the dose of a part of a turn.  Phase k is `k turn_s / phases` after a whole number of turns.
    gel_share
        Density at the gel point over I_p.  I_p is calibrated on finished surfaces, where it is the mean of what has
        cured beside what has not; inside the part a place gels at less.
    """

    points_mm: FloatArray = field(repr=False)
    size_mm: float
    sensitivities: FloatArray
    crossing_s: FloatArray = field(repr=False)
    stop_s: FloatArray
    doubts: tuple[Doubt, ...]
    turn_s: float
    waiting_s: FloatArray = field(repr=False)
    gel_share: float = 1.0

    def __post_init__(self) -> None:
        resins, places = len(self.sensitivities), len(self.points_mm)
        for name, shape in (("crossing_s", (resins, places)), ("stop_s", (resins,)), ("points_mm", (places, 3))):
            found = getattr(self, name).shape
            if found != shape:
                raise InputError(f"stop model {name}", f"has the shape {found}", accepted=f"{shape}")
        if resins < 2 or not (np.diff(self.sensitivities) > 0).all() or not self.sensitivities[0] > 0:
            raise InputError("stop model sensitivities", f"are {self.sensitivities}", accepted="2 or more, ascending")
        if not (np.isfinite(self.stop_s).all() and (self.stop_s > 0).all()):
            raise InputError("stop model stop_s", f"is {self.stop_s}", accepted="positive times")
        if any(doubt.crossing_change.shape != (places,) or not np.isfinite(doubt.stop_change) for doubt in self.doubts):
            raise InputError("stop model doubts", "do not fit its places", accepted=f"{places} changes each")
        if self.waiting_s.ndim != 1 or not self.waiting_s.size or not np.isfinite(self.waiting_s).all():
            raise InputError("stop model waiting_s", f"has the shape {self.waiting_s.shape}", accepted="finite times")
        if not (np.abs(self.points_mm) <= _FARTHEST_MM).all():  # NaN is not
            raise InputError("stop model points_mm", "are not all in a vial", accepted=f"up to {_FARTHEST_MM:g} mm")
        for name in ("size_mm", "turn_s", "gel_share"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"stop model {name}", f"is {getattr(self, name)}", accepted="a positive number")

    @property
    def nominal_turns(self) -> float:
        """Turns of light that a print in nominal resin wants."""
        return float(np.exp(np.interp(0.0, np.log(self.sensitivities), np.log(self.stop_s)))) / self.turn_s

    @cached_property
    def block(self) -> IntArray:
        """(place,) number of the block of `BLOCK_MM` that each place lies in, from 0."""
        cells = np.floor(self.points_mm / BLOCK_MM).astype(np.int64)
        return np.asarray(np.unique(cells, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)

    @cached_property
    def is_known(self) -> BoolArray:
        """(place,) whether it is seen to cure in every resin."""
        times = np.vstack([self.crossing_s, *(doubt.crossing_change for doubt in self.doubts)])
        return np.asarray(np.isfinite(times).all(axis=0))

    def to_json(self) -> dict[str, Any]:
        """Return plain values, for `from_json`; NaN, where a place never cures, may have become None meanwhile."""
        return {
            "points_mm": _listed(self.points_mm, 4), "size_mm": self.size_mm,
            "sensitivities": self.sensitivities.tolist(), "crossing_s": _listed(self.crossing_s, 3),
            "stop_s": self.stop_s.tolist(), "turn_s": self.turn_s, "waiting_s": self.waiting_s.tolist(),
            "gel_share": self.gel_share,
            "doubts": [
                {
                    "name": doubt.name, "crossing_change": _listed(doubt.crossing_change, 6),
                    "stop_change": doubt.stop_change,
                }
                for doubt in self.doubts
            ],
        }  # fmt: skip

    @classmethod
    def from_json(cls, held: Mapping[str, Any]) -> StopModel:
        """Return what `to_json` was given.

        Raises
        ------
        InputError
            Something is missing or of the wrong shape.
        """
        try:
            doubts = tuple(
                Doubt(str(doubt["name"]), _array(doubt["crossing_change"]), float(doubt["stop_change"]))
                for doubt in held["doubts"]
            )
            return cls(
                _array(held["points_mm"]), float(held["size_mm"]), _array(held["sensitivities"]),
                _array(held["crossing_s"]), _array(held["stop_s"]), doubts, float(held["turn_s"]),
                _array(held["waiting_s"]), float(held.get("gel_share", 1.0)),
            )  # fmt: skip
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError("stop model", f"cannot be used ({error})", remedy="make it again") from error


def _array(values: ArrayLike) -> FloatArray:
    return np.array(values, dtype=np.float64)


def _listed(values: FloatArray, decimals: int) -> Any:
    return np.round(values, decimals).tolist()
