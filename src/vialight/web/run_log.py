"""A run's log, told in parts, of which only what is new is read."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
from pathlib import Path
from typing import Any

from vialight.core.errors import InputError
from vialight.store.results import parse_json
from vialight.web.runs import Run, own_file

_LOG = "log.jsonl"
_MOST_BYTES = 64_000_000
_MOST_LINES = 200_000
_PART_BYTES = 1 << 20
_HEAD_BYTES = 256
_LINES_AT_ONCE = 1000
_LONGEST_LINE_BYTES = 65_536
_MOST_TOLD_BYTES = 2_000_000
_NO_EVENT = {"event": "a line that cannot be read"}


class LogTail:
    """A run's log, of which only what is new is read.

    Parameters
    ----------
    folder
        The run's.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._forget()

    def _forget(self) -> None:
        self._number, self._head, self._read, self._starts = 0, b"", 0, [0]

    def count(self) -> int:
        """Return how many whole lines there are."""
        path = own_file(self._folder, _LOG)
        if path is None:
            self._forget()
            return 0
        with path.open("rb") as file:
            about = os.fstat(file.fileno())
            head = file.read(_HEAD_BYTES)
            # A log that was begun anew may get the number of the one that was removed.
            if about.st_ino != self._number or about.st_size < self._read or not head.startswith(self._head):
                self._forget()
                self._number = about.st_ino
            self._head = head
            file.seek(self._read)
            while self._read < _MOST_BYTES and len(self._starts) <= _MOST_LINES:
                part = file.read(_PART_BYTES)
                if not part:
                    break
                ends = [self._read + found.end() for found in re.finditer(b"\n", part)]
                self._starts += ends
                self._read += len(part)
        return min(len(self._starts) - 1, _MOST_LINES)

    def lines(self, start: int) -> list[dict[str, Any]]:
        """Return events from a number on, as many as are told at once; a line that is not whole yet is left for later.

        A log that goes on for longer than anyone reads is told up to there.
        """
        stop = min(self.count(), start + _LINES_AT_ONCE)
        path = own_file(self._folder, _LOG)
        if path is None or start >= stop:
            return []
        events: list[dict[str, Any]] = []
        with path.open("rb") as file:
            file.seek(self._starts[start])
            for begin, end in itertools.pairwise(self._starts[start : stop + 1]):
                if end - self._starts[start] > _MOST_TOLD_BYTES and events:
                    break
                is_short = end - begin <= _LONGEST_LINE_BYTES
                file.seek(begin)
                events.append(_event(file.read(end - begin - 1)) if is_short else dict(_NO_EVENT))
        return events


def log_lines(run: Run, start: int) -> list[dict[str, Any]]:
    """Return the run's log from an event on, as `LogTail.lines` does."""
    return LogTail(run.folder).lines(start)


def _event(line: bytes) -> dict[str, Any]:
    """Return what a line says; no number (NaN), which Python's own writer writes and JSON has not, as nothing."""
    with contextlib.suppress(InputError):
        return parse_json(line, _LOG)
    with contextlib.suppress(InputError, ValueError, RecursionError):
        return parse_json(json.dumps(json.loads(line, parse_constant=lambda name: None)), _LOG)
    return dict(_NO_EVENT)
