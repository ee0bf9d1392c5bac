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
        self._lines: queue.Queue[str | None] = queue.Queue(most)
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="lines", daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Add a line; never waits."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self.dropped += 1

    def close(self, timeout_s: float = 1.0) -> bool:
        """Write what waits, as far as that can be done in time; False where it cannot."""
        try:
            self._lines.put(None, timeout=timeout_s)
        except queue.Full:
            return False
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        is_open = True
        while is_open:
            lines = [self._lines.get()]
            with contextlib.suppress(queue.Empty):
                while True:
                    lines.append(self._lines.get_nowait())
            is_open = None not in lines
            told = [line for line in lines if line is not None]
            try:
                if told:
                    self._write("".join(told))
            except (OSError, ValueError):
                self.dropped += len(told)
