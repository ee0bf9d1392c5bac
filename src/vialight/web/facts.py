"""Facts of a run as its files tell them, of which any may be missing, false, or of the wrong kind."""

from __future__ import annotations

import os
from datetime import datetime
from typing import Any

from vialight.core.errors import InputError
from vialight.store import read_json
from vialight.web.runs import Run, own_file

_MOST_BYTES = 4_000_000
_MOST_FACTS = 64
_LONGEST_TEXT = 300
_LARGEST_NUMBER = 1e300


class Facts:
    """A table of a JSON file, whose values may be anything; what is not as it should be is left out, and told."""

    def __init__(self, run: Run, name: str) -> None:
        self.faults: list[str] = []
        self._where = name
        self._table: dict[str, Any] = {}
        if not os.path.lexists(run.folder / name):
            return
        path = own_file(run.folder, name, most_bytes=_MOST_BYTES)
        if path is None:
            self.faults.append(f"{name}: is no file of the run's own, or larger than {_MOST_BYTES} bytes")
            return
        try:
            self._table = read_json(path)
        except RecursionError:
            self.faults.append(f"{name}: is nested too deeply")
        except (InputError, ValueError) as error:
            self.faults.append(_short(str(error).replace(f"{run.folder}{os.sep}", "")))

    def __bool__(self) -> bool:
        return bool(self._table)

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def table(self, name: str) -> Facts:
        """Return a table inside."""
        inside = Facts.__new__(Facts)
        inside.faults, inside._where = self.faults, f"{self._where}: {name}"
        found = self._table.get(name)
        inside._table = found if isinstance(found, dict) else {}
        if found is not None and not isinstance(found, dict):
            self._refuse(name, "a table")
        return inside

    def number(self, name: str) -> float | None:
        """Return a number that is finite."""
        found = self._table.get(name)
        if found is None:
            return None
        if not _is_number(found):
            self._refuse(name, "a number")
            return None
        return float(found)

    def truth(self, name: str) -> bool | None:
        """Return true or false."""
        found = self._table.get(name)
        if found is not None and not isinstance(found, bool):
            self._refuse(name, "true or false")
            return None
        return found

    def text(self, name: str) -> str | None:
        """Return a text."""
        found = self._table.get(name)
        if found is not None and not isinstance(found, str):
            self._refuse(name, "a text")
            return None
        return None if found is None else _short(found)

    def moment(self, name: str) -> str | None:
        """Return a date and time."""
        found = self.text(name)
        if found is None:
            return None
        try:
            return datetime.fromisoformat(found).isoformat()
        except ValueError:
            self._refuse(name, "a date")
            return None

    def plain(self) -> dict[str, Any]:
        """Return the numbers, texts and lists of texts."""
        kept: dict[str, Any] = {}
        for name, found in list(self._table.items())[:_MOST_FACTS]:
            if isinstance(found, bool) or found is None or _is_number(found):
                kept[name] = found
            elif isinstance(found, str):
                kept[name] = _short(found)
            elif isinstance(found, list):
                kept[name] = [_short(item) for item in found[:_MOST_FACTS] if isinstance(item, str)]
        return kept

    def _refuse(self, name: str, wanted: str) -> None:
        self.faults.append(f"{self._where}: {_short(name)} is not {wanted}")


def _is_number(found: Any) -> bool:
    return isinstance(found, int | float) and not isinstance(found, bool) and abs(found) < _LARGEST_NUMBER


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 1] + "\N{HORIZONTAL ELLIPSIS}"
