"""Reading runs, in a process that may be killed: the page's server hands it requests and takes answers as bytes.

Each request has a limit of time, after which the system ends the process, and one of memory.  Requests are lines of
JSON; an answer is its kind, its length and its content.  Nothing in it is executed by the server.
"""

from __future__ import annotations

import importlib
import json
import os
import select
import signal
import struct
import sys
import threading
import time
from collections import OrderedDict
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast

import psutil

from vialight.core.errors import VialightError
from vialight.store import to_json
from vialight.system import leave_interrupts_to_the_print
from vialight.web.catalogue import history_of, overview, run_changed, summary, surfaces_of
from vialight.web.run_log import LogTail
from vialight.web.runs import Run

if TYPE_CHECKING:
    from vialight.web.data import RunData

HEAD = struct.Struct("<cQ")
"""Kind and length of an answer."""
JSON, BYTES, NOTHING, REFUSED = b"J", b"B", b"N", b"R"
_GIB = 1 << 30
_KEPT_RUNS = 2
_MOST_KEPT_BYTES = 3 * _GIB
"""In memory between two requests; a process that has more ends, and is begun again."""
_NO_LIMIT = 1 << 62
_IDLE_S = 0.5
_WAITS = 3


class Limit(NamedTuple):
    """What a request may take: so much of a processor's time, a few times that by the clock, so much memory."""

    time_s: float
    memory_bytes: int

    @property
    def by_clock_s(self) -> float:
        """For as long it may wait, for a disk or for its turn on a busy machine."""
        return _WAITS * self.time_s


_LIGHT, _HEAVY = Limit(2.0, _GIB // 4), Limit(8.0, _GIB)
LIMITS = {
    "overview": _LIGHT,
    "summary": _LIGHT,
    "look": _LIGHT,
    "log": _LIGHT,
    "curves": _HEAVY,
    "moment": _HEAVY,
    "surface": _HEAVY,
    "recorded_picture": _HEAVY,
    "recorded_pattern": Limit(8.0, 3 * _GIB),
    "pattern": Limit(8.0, 3 * _GIB),
    "reference": Limit(15.0, 2 * _GIB),
    "reference_sums": Limit(15.0, 2 * _GIB),
    "slices": Limit(15.0, 3 * _GIB),
    "thumbnail": _HEAVY,
}
"""By what is asked."""


class _Reader:
    """Answers requests, and keeps what is dear of the runs that were asked for last."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Path, tuple[LogTail, RunData | None]] = OrderedDict()

    def prepare(self, run: Run, what: str) -> None:
        """Import what a request needs: that is not the run's fault, and not in its time."""
        log, data = self._kept.pop(run.folder, (LogTail(run.folder), None))
        if what == "thumbnail":
            importlib.import_module("vialight.web.thumbnails")
        elif LIMITS[what] is not _LIGHT and data is None:
            from vialight.web.data import RunData

            data = RunData(run)
        self._kept[run.folder] = log, data
        while len(self._kept) > _KEPT_RUNS:
            self._kept.popitem(last=False)

    def answer(self, run: Run, what: str, arguments: list[Any]) -> dict[str, Any] | list[Any] | bytes | None:
        """Return what is asked."""
        log, data = self._kept[run.folder]
        match what:
            case "overview":
                return overview(run)
            case "summary":
                return summary(run)
            case "look":
                counts = {"moments": len(history_of(run.folder)), "surfaces": len(surfaces_of(run.folder))}
                return {"counts": counts | {"log": log.count()}, "changed": run_changed(run.folder)}
            case "log":
                return log.lines(arguments[0])
            case "thumbnail":
                from vialight.web.thumbnails import thumbnail

                return thumbnail(run, arguments[0])
        assert data is not None
        return self._of_data(data, what, arguments)

    @staticmethod
    def _of_data(data: RunData, what: str, arguments: list[Any]) -> dict[str, Any] | bytes | None:
        from vialight.web.reference import ViewGrid

        match what:
            case "curves":
                return data.curves(arguments[0])
            case "slices":
                return data.slices.at(*arguments)
            case "reference":
                return data.reference_surface()
            case "reference_sums":
                shape, voxel_mm, centre_z_mm = arguments or ((), 0.0, 0.0)
                return data.reference_sums(ViewGrid(tuple(shape), voxel_mm, centre_z_mm) if arguments else None)
            case "moment" | "surface" | "recorded_picture" | "recorded_pattern" | "pattern":
                found: bytes | None = getattr(data, what)(arguments[0])
                return found
        raise ValueError(what)


def _told(reader: _Reader, request: dict[str, Any]) -> tuple[bytes, bytes]:
    """Return the kind and the content of the answer."""
    run = Run(request["key"], request["name"], Path(request["folder"]))
    what = request["what"]
    limit = LIMITS[what]
    reader.prepare(run, what)
    _limit_memory(limit.memory_bytes)
    _alarm_in(limit.time_s, limit.by_clock_s)
    try:
        found = reader.answer(run, what, request["arguments"])
        if found is None:
            return NOTHING, b""
        return (BYTES, found) if isinstance(found, bytes) else (JSON, _as_json(found))
    except VialightError as error:
        return REFUSED, str(error).encode("utf-8", "replace")
    except MemoryError:
        return REFUSED, f"{run.name}: cannot be read (it needs more memory than a file of its kind may)".encode()
    except Exception as error:  # files are broken in more ways than readers know
        text = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        return REFUSED, f"{run.name}: cannot be read ({text})".encode("utf-8", "replace")
    finally:
        _alarm_in(0.0, 0.0)
        _limit_memory(None)


def _as_json(found: dict[str, Any] | list[Any]) -> bytes:
    return to_json(cast("dict[str, Any]", found)).encode("utf-8", "replace")


def _limit_memory(more_bytes: int | None) -> None:
    """Let the process have so much more than it has now; None: as much as it wants."""
    if sys.platform != "linux":
        _Watch.limit_bytes = _NO_LIMIT if more_bytes is None else psutil.Process().memory_info().rss + more_bytes
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    wanted = hard
    if more_bytes is not None:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        wanted = pages * os.sysconf("SC_PAGE_SIZE") + more_bytes
    resource.setrlimit(resource.RLIMIT_AS, (wanted if hard < 0 else min(wanted, hard), hard))


class _Watch:
    """Ends the process when it has more memory than it may, where the system does not."""

    limit_bytes = _NO_LIMIT

    @classmethod
    def watch(cls) -> None:
        process = psutil.Process()
        while process.memory_info().rss < cls.limit_bytes:
            time.sleep(0.05)
        os._exit(3)


def _alarm_in(processor_s: float, by_clock_s: float) -> None:
    """Have the system end this process after a time, whatever it is doing then; never where that is 0."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, processor_s)
        signal.setitimer(signal.ITIMER_REAL, by_clock_s)


def _serve(requests: BinaryIO, answers: BinaryIO) -> None:
    reader = _Reader()
    if not select.select([requests], [], [], _IDLE_S)[0]:
        for name in ("data", "thumbnails"):  # nobody waits: what takes a second is done before someone does
            importlib.import_module(f"vialight.web.{name}")
    for line in requests:
        kind, content = _told(reader, json.loads(line))
        answers.write(HEAD.pack(kind, len(content)))
        answers.write(content)
        answers.flush()
        if psutil.Process().memory_info().rss > _MOST_KEPT_BYTES:
            return


def _main() -> None:
    leave_interrupts_to_the_print()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    if sys.platform != "linux":
        threading.Thread(target=_Watch.watch, daemon=True).start()
    _serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    _main()
