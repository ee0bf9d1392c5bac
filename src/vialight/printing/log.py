"""What happened in a print, one JSON object a line, written as it happens, on a thread that holds up no other."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import queue
import threading
import time
from pathlib import Path

from vialight.devices import Clock
from vialight.store.durable import sync_descriptor

_WAITING = 4096
"""Lines that may wait for the disk; later ones are dropped and counted."""
_SYNC_S = 1.0
_CLOSE_S = 1.0


class EventLog:
    """Appends events to ``log.jsonl``.

    Whoever notes something never waits and never fails: a thread of its own writes, and what cannot be written is
    dropped and counted, since a full disk must not end a print.

    Parameters
    ----------
    path
        The file; it is made with the first event.
    clock
        The print's.

    Attributes
    ----------
    last : str
        The newest event that is meant for a person.
    dropped : int
        Events that could not be written and are not told of in the file yet.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path, self._clock = path, clock
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._descriptor: int | None = None
        self.dropped = 0
        self.last = ""

    def note(self, event: str, message: str = "", **details: object) -> None:
        """Note an event, with the print's time and what belongs to it."""
        if message:
            self.last = message
        line = self._line(event, message, details)
        if self._lines.qsize() >= _WAITING:
            self._drop()
            return
        self._lines.put(line)
        if self._thread is None:
            self._start()

    def close(self, timeout_s: float = _CLOSE_S) -> None:
        """Write what waits, and end; a disk that does not take it in this time is waited for no longer."""
        with self._lock:
            thread, self._thread = self._thread, None
        if thread is not None:
            self._lines.put(None)
            thread.join(timeout_s)
            atexit.unregister(self.close)

    def _line(self, event: str, message: str, details: dict[str, object]) -> bytes:
        entry: dict[str, object] = {}
        try:
            entry["time_s"] = round(self._clock.now_s(), 4)
            entry |= {"event": event} | ({"message": message} if message else {})
            return json.dumps(entry | details, default=str).encode() + b"\n"
        except Exception as error:  # whatever a detail does when it is written, the print goes on
            told = {"event": str(event), "message": str(message), "unwritable": type(error).__name__}
            return json.dumps(entry | told).encode() + b"\n"

    def _drop(self) -> None:
        with self._lock:
            self.dropped += 1

    def _start(self) -> None:
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._write, name="log", daemon=True)
                self._thread.start()
                atexit.register(self.close)

    def _write(self) -> None:
        unsynced_since: float | None = None
        while True:
            try:
                left_s = None if unsynced_since is None else max(0.0, unsynced_since + _SYNC_S - time.monotonic())
                line = self._lines.get(timeout=left_s)
            except queue.Empty:
                line = b""
            if line:
                self._append(line)
                unsynced_since = unsynced_since or time.monotonic()
            if line is None or (unsynced_since is not None and time.monotonic() - unsynced_since >= _SYNC_S):
                unsynced_since = None
                with contextlib.suppress(OSError):
                    if self._descriptor is not None:
                        sync_descriptor(self._descriptor)
            if line is None:
                self._tell_dropped()
                if self._descriptor is not None:
                    os.close(self._descriptor)
                    self._descriptor = None
                return

    def _append(self, line: bytes) -> None:
        self._tell_dropped()
        if not self._put(line):
            self._drop()

    def _tell_dropped(self) -> None:
        with self._lock:
            dropped = self.dropped
        if dropped and self._put(self._line("log", f"{dropped} events could not be written here", {})):
            with self._lock:
                self.dropped -= dropped

    def _put(self, line: bytes) -> bool:
        """Write a whole line, or nothing of it."""
        try:
            if self._descriptor is None:
                self._descriptor = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            written = os.write(self._descriptor, line)
            if written < len(line):
                os.ftruncate(self._descriptor, os.fstat(self._descriptor).st_size - written)
            return written == len(line)
        except OSError:
            return False
