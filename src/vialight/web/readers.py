"""The processes that read runs for the page (see `vialight.web.reading`): few, begun again when one is killed.

A run has two of them at most, so that one that holds up its readers leaves one to all others.  What took too much of a
reader is not tried again for a while.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import subprocess
import sys
import threading
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

from vialight.core.errors import InputError
from vialight.web.reading import BYTES, HEAD, JSON, LIMITS, NOTHING
from vialight.web.runs import Run

_PROCESSES = 3
_OF_ONE_RUN = 2
_PATIENCE_S = 20.0
"""For a reader to be free."""
_NOT_AGAIN_FOR_S = 30.0
_MOST_REMEMBERED = 1000
_START_S = 30.0
"""For a process to start, while everything else does."""
_GRACE_S = 2.0
"""After which a process that should have been ended by its alarm is killed."""
_MOST_BYTES = 1 << 28


class CannotBeReadError(InputError):
    """A run could not be read within its limits."""


class Told(NamedTuple):
    """An answer: JSON in UTF-8, or bytes of another kind; None where there is nothing."""

    content: bytes | None
    is_json: bool

    @property
    def value(self) -> Any:
        """What the JSON says."""
        assert self.content is not None
        return json.loads(self.content)


class Readers:
    """Asks the processes; every method is for the event loop's thread."""

    def __init__(self) -> None:
        self._idle: list[_Process] = []
        self._all: set[_Process] = set()
        self._free = asyncio.Semaphore(_PROCESSES)
        self._of_run: defaultdict[str, asyncio.Semaphore] = defaultdict(lambda: asyncio.Semaphore(_OF_ONE_RUN))
        self._threads = ThreadPoolExecutor(_PROCESSES + 1, "readers")
        self._tasks: set[asyncio.Task[Told]] = set()
        self._faults: dict[tuple[str, str], tuple[float, str]] = {}
        self._is_closed = False

    def start(self) -> None:
        """Begin processes, so that who asks first, or while one is held up, need not wait for them to start."""
        self._idle += [self._begin() for _ in range(_PROCESSES)]

    def close(self) -> None:
        """End all of them."""
        self._is_closed = True
        for process in self._all:
            process.kill()
        self._threads.shutdown(wait=False)

    async def ask(self, run: Run, what: str, *arguments: Any) -> Told:
        """Return what a reader tells of a run.

        Parameters
        ----------
        run
            The run.
        what
            One of `vialight.web.reading.LIMITS`.
        *arguments
            Plain values of JSON.

        Raises
        ------
        InputError
            The reader says why it cannot be had.
        CannotBeReadError
            It took more time or memory than it may.
        """
        self._refuse_what_failed(run, what)
        # It goes on when who has asked no longer waits: a reader cannot be given another request before.
        task = asyncio.get_running_loop().create_task(self._asked(run, what, arguments))
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return await asyncio.shield(task)

    def _done(self, task: asyncio.Task[Told]) -> None:
        self._tasks.discard(task)
        if not task.cancelled():
            task.exception()  # it was told to whoever still waits

    async def _asked(self, run: Run, what: str, arguments: tuple[Any, ...]) -> Told:
        if len(self._of_run) > _MOST_REMEMBERED:
            self._of_run.clear()
        own = self._of_run[run.key]
        with self._waiting(run):
            await asyncio.wait_for(own.acquire(), _PATIENCE_S)
        try:
            with self._waiting(run):
                await asyncio.wait_for(self._free.acquire(), _PATIENCE_S)
            try:
                self._refuse_what_failed(run, what)
                return await self._read(run, what, arguments)
            finally:
                self._free.release()
        finally:
            own.release()

    @staticmethod
    @contextlib.contextmanager
    def _waiting(run: Run) -> Any:
        try:
            yield
        except TimeoutError as error:
            raise CannotBeReadError(run.name, "cannot be read: other requests take too long") from error

    async def _read(self, run: Run, what: str, arguments: tuple[Any, ...]) -> Told:
        process = self._take(run)
        loop = asyncio.get_running_loop()
        request = {
            "key": run.key, "name": run.name, "folder": str(run.folder), "what": what, "arguments": arguments,
        }  # fmt: skip
        limit = LIMITS[what]
        watchdog = loop.call_later(limit.by_clock_s + _GRACE_S + (0 if process.is_started else _START_S), process.kill)
        try:
            kind, content = await loop.run_in_executor(self._threads, process.ask, request)
        except (OSError, EOFError, ValueError) as error:
            self._all.discard(process)
            process.kill()
            if not self._is_closed:
                self._idle.append(self._begin())
            why = f"cannot be read: it took more than {limit.time_s:g} s, or more memory than it may, or hung"
            if len(self._faults) > _MOST_REMEMBERED:
                self._faults.clear()
            self._faults[run.key, what] = time.monotonic() + _NOT_AGAIN_FOR_S, why
            raise CannotBeReadError(run.name, why) from error
        finally:
            watchdog.cancel()
        self._idle.append(process)
        if kind == NOTHING:
            return Told(None, False)
        if kind in (JSON, BYTES):
            return Told(content, kind == JSON)
        where, _, what_is_wrong = content.decode("utf-8", "replace").partition(": ")
        raise InputError(where, what_is_wrong)

    def _refuse_what_failed(self, run: Run, what: str) -> None:
        until, why = self._faults.get((run.key, what), (0.0, ""))
        if time.monotonic() < until:
            raise CannotBeReadError(run.name, why)

    def _take(self, run: Run) -> _Process:
        """Return an idle process, if there is one that knows the run that, else one that is begun."""
        self._idle = [process for process in self._idle if process.is_alive]
        self._all = {process for process in self._all if process.is_alive}
        if not self._idle:
            return self._begin()
        known = next((process for process in self._idle if run.key in process.runs), self._idle[-1])
        self._idle.remove(known)
        known.runs = [*known.runs[-1:], run.key] if run.key not in known.runs else known.runs
        return known

    def _begin(self) -> _Process:
        process = _Process()
        self._all.add(process)
        return process


class _Process:
    def __init__(self) -> None:
        self.runs: list[str] = []
        self.is_started = False
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "vialight.web.reading"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def kill(self) -> None:
        with contextlib.suppress(OSError):
            self._process.kill()

    def ask(self, request: dict[str, Any]) -> tuple[bytes, bytes]:
        """Return kind and content; `EOFError` or `OSError` where the process has ended instead."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
            kind, length = HEAD.unpack(self._exactly(HEAD.size))
            self.is_started = True
            return kind, self._exactly(length)
        except BaseException:
            self._end()
            raise

    def _exactly(self, length: int) -> bytes:
        if length > _MOST_BYTES:
            raise ValueError("too long")
        assert self._process.stdout is not None
        content = self._process.stdout.read(length)
        if len(content) < length:
            raise EOFError
        return content

    def _end(self) -> None:
        self.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                assert pipe is not None
                pipe.close()
