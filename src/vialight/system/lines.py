"""Lines for a file or a terminal, written by a thread of its own: who has something to say never waits for it."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable

_MOST_LINES = 4096


class LineWriter:
    """Hands lines to a slow place, in their order, as many as wait at once; of more, it counts what it drops.

    Parameters
    ----------
    write
        Called on that thread with one or more lines; an `OSError` or `ValueError` (a place that is full, or closed)
        loses them, and is no more than that.
    most
        Lines that may wait.

    Attributes
    ----------
    dropped : int
        Lines that found no room, or could not be written.

    Examples
    --------
    >>> written = []
    >>> writer = LineWriter(written.append)
    >>> writer.put("one")
    >>> writer.close(), written
    (True, ['one'])
    """

    def __init__(self, write: Callable[[str], object], most: int = _MOST_LINES) -> None:
        self._write = write
        self._lines: queue.Queue[str | threading.Event] = queue.Queue(most)
        self._is_closing = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="lines", daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Add a line; never waits."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self.dropped += 1

    def flush(self, timeout_s: float = 1.0) -> bool:
        """Write what waits, as far as that can be done in time; False where it cannot."""
        is_written = threading.Event()
        try:
            self._lines.put(is_written, timeout=timeout_s)
        except queue.Full:
            return False
        return is_written.wait(timeout_s)

    def close(self, timeout_s: float = 1.0) -> bool:
        """Write what waits, as far as that can be done in time, and end; False where it cannot."""
        self._is_closing = True
        return self.flush(timeout_s)

    def _run(self) -> None:
        while not self._is_closing or not self._lines.empty():
            waiting = [self._lines.get()]
            with contextlib.suppress(queue.Empty):
                while True:
                    waiting.append(self._lines.get_nowait())
            lines = [line for line in waiting if isinstance(line, str)]
            try:
                if lines:
                    self._write("".join(lines))
            except (OSError, ValueError):
                self.dropped += len(lines)
            for is_written in waiting:
                if isinstance(is_written, threading.Event):
                    is_written.set()
