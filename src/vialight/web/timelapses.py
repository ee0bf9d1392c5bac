"""Time-lapses made when asked for, one at a time, in a process of its own that yields to everything else."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from vialight.core.errors import InputError
from vialight.system import scratch_folder
from vialight.web.runs import Run, own_folder

_NICE = 10
_MOST_PROCESSOR_S = 3600
_MOST_BYTES = 6 << 30


class TimeLapses:
    """Makes and keeps time-lapses while the server runs."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._run: Run | None = None
        self._process: subprocess.Popen[str] | None = None
        self._states: dict[str, dict[str, Any]] = {}

    def close(self) -> None:
        """Give up what is being made, and remove what was."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            self._process.wait(5)
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def begin(self, run: Run) -> dict[str, Any]:
        """Begin to draw one.

        Raises
        ------
        InputError
            Another one is being drawn.
        """
        if self._process is not None and self._process.poll() is None:
            if self._run is not None and self._run.key == run.key:
                return self.state(run)
            raise InputError("time-lapse", "another one is being drawn", remedy="wait for it")
        if self._folder is None:
            self._folder = scratch_folder()
        self._run = run
        self._states[run.key] = {"state": "drawing", "done": 0, "total": None}
        command = [sys.executable, "-P", "-m", __name__, str(run.folder), str(self._path(run))]
        # Not multiprocessing: the page's server is a child itself, and such may have none.
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        threading.Thread(target=self._hear, args=(run, self._process), daemon=True).start()
        return self._states[run.key]

    def state(self, run: Run) -> dict[str, Any]:
        """Tell how far it is: absent, drawing, done or failed."""
        return self._states.get(run.key, {"state": "absent"})

    def finished(self, run: Run) -> Path | None:
        """Return the file; None where it is not done."""
        path = self._path(run)
        return path if self.state(run)["state"] == "done" and path is not None and path.is_file() else None

    def _path(self, run: Run) -> Path | None:
        return None if self._folder is None else self._folder / f"{run.key}.mp4"

    def _hear(self, run: Run, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with process.stdout as lines:
            for line in lines:
                with contextlib.suppress(ValueError):
                    self._states[run.key] = json.loads(line)
        process.wait()
        if self._states[run.key]["state"] == "drawing":
            self._states[run.key] = {"state": "failed", "error": "the drawing process ended"}


def _limit() -> None:
    """Let the drawing have so much time of a processor and memory, whatever the surfaces hold."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (_MOST_PROCESSOR_S, _MOST_PROCESSOR_S))
        resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))


def _draw(folder: str, out: str) -> None:
    from vialight.report import write_timelapse

    with contextlib.suppress(OSError):
        os.nice(_NICE)

    def tell(**state: Any) -> None:
        print(json.dumps(state), flush=True)

    if own_folder(Path(folder), "surfaces") is None:
        tell(state="failed", error="surfaces: are not there, or not the run's own")
        return
    _limit()
    try:
        write_timelapse(folder, out, progress=lambda done, total: tell(state="drawing", done=done, total=total))
        tell(state="done")
    except InputError as error:
        tell(state="failed", error=str(error))


if __name__ == "__main__":
    _draw(*sys.argv[1:])
