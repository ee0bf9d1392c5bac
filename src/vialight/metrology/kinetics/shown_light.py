"""What light a run got: from what the projector logged, else from when it was on, else unknown."""

from __future__ import annotations

import csv
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.plan import Patterns
from vialight.metrology.kinetics.dose import ShownPatterns
from vialight.store import FrameFile, read_json
from vialight.system import file_in, read_plain

_STEP_S = 1 / 32
"""Between patterns, where it is not logged."""
_LONGEST_S = 1e6
"""Of a print: eleven days."""
_MOST_BYTES = 100_000_000
"""Of a projector's log: a day of refreshes."""


@dataclass(frozen=True)
class ShownLight:
    """The light of a run.

    Parameters
    ----------
    source
        Where this is known from, in words.
    patterns
        The plan's; None without a plan.
    shown
        What was shown when; None where that is not known.
    time_s, lit_s
        Lit time over time, to be read between by straight lines.
    """

    source: str
    patterns: Patterns | None
    shown: ShownPatterns | None
    time_s: FloatArray
    lit_s: FloatArray

    def lit_at(self, time_s: FloatArray) -> FloatArray:
        """Return for how long light had been on by each time."""
        return np.asarray(np.interp(time_s, self.time_s, self.lit_s))

    def turns_at(self, time_s: FloatArray, turn_s: float) -> FloatArray:
        """Return turns of light by each time; once it is off for good, those in the dark are counted on."""
        off_s = self.time_at(float(self.lit_s[-1]))
        dark_s = 0.0 if self.off_at_lit_s is None else np.maximum(time_s - off_s, 0.0)
        return np.asarray((self.lit_at(time_s) + dark_s) / turn_s)

    def time_at(self, lit_s: float) -> float:
        """Return when light had first been on for so long."""
        at = min(int(np.searchsorted(self.lit_s, lit_s)), len(self.lit_s) - 1)
        return float(self.time_s[at] - max(self.lit_s[at] - lit_s, 0.0))

    @property
    def off_at_lit_s(self) -> float | None:
        """Lit time at which the light went off for good; None where it is not known to have."""
        return float(self.lit_s[-1]) if len(self.lit_s) > 1 and self.lit_s[-1] == self.lit_s[-2] else None


def light_of(run: Path, rig: Rig, frames: FrameFile, patterns: Patterns | None) -> ShownLight:
    """Find out what light a run got.

    Parameters
    ----------
    run
        Its folder: ``projector.csv`` is what was truly shown, ``run.json`` may know for how long there was light.
    rig
        For the stage's direction and speed.
    frames
        For the stage's angle over time.
    patterns
        Of the plan.
    """
    turned = np.unwrap(frames.angles_rad) * rig.stage.direction
    speed = np.radians(rig.stage.speed_deg_s)
    times = frames.time_s if frames.time_s is not None else np.abs(turned - turned[0]) / speed
    order = np.argsort(times)
    end_s = float(times.max())
    log = file_in(run, "projector.csv")
    if end_s - float(times.min()) > _LONGEST_S or end_s < 0:
        raise InputError(
            frames.path, f"has times from {times.min():.4g} s to {end_s:.4g} s", accepted="those of a print"
        )
    if log.exists():
        source = "what the projector showed, refresh by refresh (projector.csv)"
        time_s, pattern = _logged(log)
    else:
        lit_s = _known_lit_s(run)
        source = "recorded, light on from the first frame" if lit_s is None else (
            "for how long there was light (run.json), each pattern when it was due"
        )  # fmt: skip
        time_s = np.arange(0.0, min(end_s, np.inf if lit_s is None else lit_s), _STEP_S)
        pattern = np.zeros(len(time_s), np.int64)
        if lit_s is not None and lit_s < end_s:
            time_s, pattern = np.append(time_s, lit_s), np.append(pattern, -1)
    if not len(time_s) or time_s[-1] < end_s:
        time_s, pattern = np.append(time_s, end_s), np.append(pattern, pattern[-1:] if len(pattern) else [-1])
    middle = (time_s + np.append(time_s[1:], time_s[-1:])) / 2
    angle = np.interp(middle, times[order], turned[order])
    if patterns is not None and not log.exists():
        due = np.rint((angle - patterns.angles_rad[0]) / patterns.step_rad).astype(np.int64) % len(patterns.levels)
        pattern = np.where(pattern >= 0, due, -1)
    lit = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * (pattern[:-1] >= 0))])
    shown = None if patterns is None else ShownPatterns(time_s, pattern, angle)
    return ShownLight(source, patterns, shown, time_s, lit)


def patterns_shown(run: Path) -> dict[str, int]:
    """Count refreshes that showed a pattern, those at which another was due, and those at which it was long not due.

    Parameters
    ----------
    run
        Its folder, with ``projector.csv``; all counts are 0 without.

    Returns
    -------
    dict
        ``refreshes``; ``refreshes_not_due``; ``refreshes_off``, at which the pattern was due neither then nor at the
        refreshes before and after.
    """
    log = file_in(run, "projector.csv")
    rows = _rows(log) if log.exists() else []
    due = [row.due for row in rows]
    lit = [(k, row.shown) for k, row in enumerate(rows) if row.shown >= 0]
    return {
        "refreshes": len(lit),
        "refreshes_not_due": sum(shown != due[k] for k, shown in lit),
        "refreshes_off": sum(shown not in due[max(0, k - 1) : k + 2] for k, shown in lit),
    }


class _Refresh(NamedTuple):
    shown_s: float | None
    """None of one that was missed."""
    due: int
    shown: int


def _logged(path: Path) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Return when patterns appeared, and which."""
    rows = [(row.shown_s, row.shown) for row in _rows(path) if row.shown_s is not None]
    times = np.array([at_s for at_s, _ in rows], dtype=np.float64)
    if len(times) and not np.ptp(times) <= _LONGEST_S:  # NaN is not
        raise InputError(
            path, f"has times from {times.min():.4g} s to {times.max():.4g} s", accepted="those of a print"
        )
    return times, np.array([shown for _, shown in rows], np.int64)


def _rows(path: Path) -> list[_Refresh]:
    """Return the refreshes, those that were missed too; a line that was cut short by a kill is left out."""
    try:
        whole, _, _ = read_plain(path, _MOST_BYTES).decode("ascii").rpartition("\n")
        rows = csv.DictReader(whole.splitlines())
        return [_refresh(row) for row in rows]
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", remedy="check the file") from error
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(
            path, f"is no log of a projector ({type(error).__name__}: {error})", accepted="refresh_s,shown_s,due,shown"
        ) from error


def _refresh(row: Mapping[str, str]) -> _Refresh:
    due, shown = int(row["due"]), int(row["shown"])
    if max(abs(due), abs(shown)) >= 2**31:
        raise ValueError(f"a pattern {max(due, shown)}")
    return _Refresh(float(row["shown_s"]) if row["shown_s"] else None, due, shown)


def _known_lit_s(run: Path) -> float | None:
    path = file_in(run, "run.json")
    if not path.exists():
        return None
    printed = read_json(path).get("printed")
    lit_s = printed.get("lit_s") if isinstance(printed, dict) else None
    if lit_s is None:
        return None
    if not isinstance(lit_s, int | float) or not 0 <= lit_s <= _LONGEST_S:
        raise InputError(path, f"printed.lit_s is {reprlib.repr(lit_s)}", accepted="a time in s")
    return float(lit_s)
