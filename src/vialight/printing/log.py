"""What happened in a print, one JSON object a line, written as it happens."""

from __future__ import annotations

import contextlib
import json
import threading
from pathlib import Path

from vialight.devices import Clock


class EventLog:
    """Appends events to ``log.jsonl``; a full disk must not end a print, so that what cannot be written is dropped.

    Attributes
    ----------
    last : str
        The newest event that is meant for a person.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path, self._clock = path, clock
        self._lock = threading.Lock()
        self.last = ""

    def note(self, event: str, message: str = "", **details: object) -> None:
        """Write an event, with the print's time and what belongs to it."""
        entry = {"time_s": round(self._clock.now_s(), 4), "event": event} | ({"message": message} if message else {})
        line = json.dumps(entry | details, default=str)
        with self._lock, contextlib.suppress(OSError), self._path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        if message:
            self.last = message
