"""For how long light has been on, at any moment, from what the projector has logged."""

from __future__ import annotations

from pathlib import Path


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
        self._path = path
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
            with self._path.open(encoding="ascii") as file:
                file.seek(self._offset)
                text = self._rest + file.read()
                self._offset = file.tell()
        except FileNotFoundError:
            return
        *lines, self._rest = text.split("\n")
        for line in lines:
            _, shown_s, _, shown = line.split(",")
            if not shown_s or shown == "shown":
                continue
            if shown == "-1" and self._on_since is not None:
                self._intervals.append((self._on_since, float(shown_s)))
                self._on_since = None
            elif shown != "-1" and self._on_since is None:
                self._on_since = float(shown_s)
