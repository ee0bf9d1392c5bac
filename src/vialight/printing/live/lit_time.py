"""For how long light has been on, at any moment, from what the projector has logged."""

from __future__ import annotations

import math
from pathlib import Path

from vialight.core.errors import InputError
from vialight.system import file_in, open_plain

_MOST_BYTES = 500_000_000
"""Of a log: weeks of refreshes."""


class LitTime:
    r"""Follows a run's ``projector.csv`` while it grows; without such a file light counts as always on.

    Parameters
    ----------
    path
        The log.

    Examples
    --------
    >>> import tempfile
    >>> log = Path(tempfile.mkdtemp()) / "projector.csv"
    >>> _ = log.write_text("refresh_s,shown_s,due,shown\n1.0,1.0,7,7\n1.1,1.1,8,8\n3.0,3.0,-1,-1\n")
    >>> lit = LitTime(log)
    >>> lit.at(0.5), lit.at(2.0), lit.at(9.0)
    (0.0, 1.0, 2.0)
    """

    def __init__(self, path: Path) -> None:
        self._path = file_in(path.parent, path.name)
        self._offset = 0
        self._rest = ""
        self._intervals: list[tuple[float, float]] = []
        self._on_since: float | None = None

    def at(self, time_s: float) -> float:
        """Return the lit time, s, at a time of the print's clock."""
        self._read_on()
        if not self._path.exists():
            return time_s
        lit = sum(min(off, time_s) - on for on, off in self._intervals if on < time_s)
        return lit + (max(0.0, time_s - self._on_since) if self._on_since is not None else 0.0)

    def _read_on(self) -> None:
        try:
            with open_plain(self._path, _MOST_BYTES) as file:
                file.seek(self._offset)
                text = self._rest + file.read().decode("ascii", errors="replace")
                self._offset = file.tell()
        except FileNotFoundError:
            return
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror})", remedy="check the file") from error
        *lines, self._rest = text.split("\n")
        for line in lines:
            shown = _shown(line)
            if shown is None:
                continue
            at_s, is_lit = shown
            if not is_lit and self._on_since is not None:
                self._intervals.append((self._on_since, at_s))
                self._on_since = None
            elif is_lit and self._on_since is None:
                self._on_since = at_s


def _shown(line: str) -> tuple[float, bool] | None:
    """Return when a refresh was shown, and whether it was lit; None of one that was missed, and of what is none."""
    try:
        _, shown_s, _, shown = line.split(",")
        at_s, is_lit = float(shown_s), int(shown) >= 0
    except ValueError:
        return None
    return (at_s, is_lit) if math.isfinite(at_s) else None
