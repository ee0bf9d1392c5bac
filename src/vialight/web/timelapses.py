"""Time-lapses made when asked for, one at a time, in a process of its own that yields to everything else."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import tempfile
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from vialight.errors import InputError
from vialight.web.catalogue import Run


class TimeLapses:
    """Makes and keeps time-lapses while the server runs."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._run: Run | None = None
        self._process: SpawnProcess | None = None
        self._pipe: Connection[Any, Any] | None = None
        self._states: dict[str, dict[str, Any]] = {}

    def close(self) -> None:
        """Give up what is being made, and remove what was."""
        if self._process is not None and self._process.is_alive():
            self._process.terminate()
            self._process.join(5)
        if self._folder is not None:
            self._folder.cleanup()

    def begin(self, run: Run) -> dict[str, Any]:
        """Begin to draw one.

        Raises
        ------
        InputError
            Another one is being drawn.
        """
        self._hear()
        if self._process is not None and self._process.is_alive():
            if self._run is not None and self._run.key == run.key:
                return self.state(run)
            raise InputError("time-lapse", "another one is being drawn", remedy="wait for it")
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="vialight-page-")
        context = multiprocessing.get_context("spawn")
        self._pipe, far_end = context.Pipe(duplex=False)
        self._process = context.Process(target=_draw, args=(run.folder, self._path(run), far_end), daemon=True)
        self._process.start()
        far_end.close()
        self._run = run
        self._states[run.key] = {"state": "drawing", "done": 0, "total": None}
        return self._states[run.key]

    def state(self, run: Run) -> dict[str, Any]:
        """Tell how far it is: absent, drawing, done or failed."""
        self._hear()
        return self._states.get(run.key, {"state": "absent"})

    def finished(self, run: Run) -> Path | None:
        """Return the file; None where it is not done."""
        path = self._path(run)
        return path if self.state(run)["state"] == "done" and path is not None and path.is_file() else None

    def _path(self, run: Run) -> Path | None:
        return None if self._folder is None else Path(self._folder.name) / f"{run.key}.mp4"

    def _hear(self) -> None:
        if self._pipe is None or self._run is None:
            return
        try:
            while self._pipe.poll():
                self._states[self._run.key] = self._pipe.recv()
        except (EOFError, OSError):
            if self._states[self._run.key]["state"] == "drawing":
                self._states[self._run.key] = {"state": "failed", "error": "the drawing process ended"}
            self._pipe = None


def _draw(folder: Path, out: Path, pipe: Connection[Any, Any]) -> None:
    from vialight.report import write_timelapse

    with contextlib.suppress(OSError):
        os.nice(10)

    def tell(done: int, total: int) -> None:
        pipe.send({"state": "drawing", "done": done, "total": total})

    try:
        write_timelapse(folder, out, progress=tell)
        pipe.send({"state": "done"})
    except InputError as error:
        pipe.send({"state": "failed", "error": str(error)})
