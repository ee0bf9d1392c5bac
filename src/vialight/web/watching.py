"""Watching a run for the pages that show it: mailboxes and folder are looked at, the newest message of a kind kept.

Nothing is queued: a message takes the place of the one before, and a socket sends what is newest when its page has
taken the last one.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from vialight.core.errors import InputError
from vialight.core.messages import CameraImage, PrintStatus, Snapshot, SurfaceSnapshot
from vialight.printing.live_link import LiveLink
from vialight.store import to_json
from vialight.system.mailboxes import Mailbox
from vialight.web.live_pictures import LivePictures, grid_of
from vialight.web.readers import Readers
from vialight.web.reference import ViewGrid
from vialight.web.runs import CannotTellError, Run, find_print

_T = TypeVar("_T")
_LOG = logging.getLogger("vialight.web")

CHANNELS = {
    "state": ("status",),
    "images": ("snapshot", "planes", "camera", "pattern", "reference"),
    "surface": ("surface",),
}
"""Which kinds of message a socket of each name gets; apart, so that a mesh does not hold up what is said of Stop."""
_LOOK_S = 0.02
_HEARTBEAT_S = 0.25
_STATUS_S = 0.1
"""Between statuses that say nothing new but time."""
_PATTERN_S = 0.1
"""Between pictures of patterns, of which 32 are shown a second."""
_FOLDER_S = 1.0
_LINK_S = 1.0


class Board:
    """The newest message of each kind, for sockets on the same event loop."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[int, str | bytes]] = {}
        self._readers: dict[asyncio.Event, tuple[str, ...]] = {}

    def publish(self, kind: str, message: str | bytes) -> None:
        """Replace the newest message of a kind."""
        number = self._newest.get(kind, (0, ""))[0] + 1
        self._newest[kind] = number, message
        for event, kinds in self._readers.items():
            if kind in kinds:
                event.set()

    def clear(self, *kinds: str) -> None:
        """Forget what is over, so that a page that comes later does not get it."""
        for kind in kinds:
            if kind in self._newest:
                self._newest[kind] = self._newest[kind][0], ""

    def newest(self, kind: str) -> tuple[int, str | bytes]:
        """Return the number and the newest message; 0 and nothing where there is none."""
        return self._newest.get(kind, (0, ""))

    def enter(self, event: asyncio.Event, kinds: tuple[str, ...]) -> None:
        """Set an event whenever one of the kinds is renewed."""
        self._readers[event] = kinds

    def leave(self, event: asyncio.Event) -> None:
        """Stop doing so."""
        self._readers.pop(event, None)

    def is_read(self, kind: str) -> bool:
        """Tell whether any socket wants a kind."""
        return any(kind in kinds for kinds in self._readers.values())


_KINDS: dict[str, Any] = {
    "status": PrintStatus,
    "snapshot": Snapshot,
    "surface": SurfaceSnapshot,
    "camera": CameraImage,
}
"""Mailbox to what is in it."""


class _Reader:
    """One mailbox of whichever print is live."""

    def __init__(self, name: str) -> None:
        self._name, self._kind = name, _KINDS[name]
        self._box: Mailbox[Any] | None = None
        self._number = 0

    def newest(self, link: LiveLink) -> Any | None:
        """Return the newest message that was not returned yet."""
        path = Path(link.mailboxes) / self._name
        if self._box is not None and (self._box.path != path or self._box.is_replaced):
            self._box.close()
            self._box = None
        if self._box is None:
            if not path.exists():
                return None
            self._box, self._number = Mailbox(path, self._kind), 0
        found = self._box.newest(self._number)
        if found is None:
            return None
        self._number, message = found
        return message


class RunWatch:
    """Keeps a board up to date with a run while there are pages that read it.

    Parameters
    ----------
    run
        The run.
    readers
        Read what lies in its folder.
    workers
        Where what is published is read and packed, so that the event loop stays free for Stop.
    looking
        Where it is looked whether a print runs.
    """

    def __init__(self, run: Run, readers: Readers, workers: Executor, looking: Executor) -> None:
        self.run = run
        self.board = Board()
        self.link: LiveLink | None = None
        self._pictures = LivePictures()
        self._readers, self._workers, self._looking = readers, workers, looking
        self._tasks: list[asyncio.Task[None]] = []
        self._seen: dict[str, float] = {}
        self._published = 0.0
        self._status: PrintStatus | None = None
        self._counts = {"moments": 0, "surfaces": 0, "log": 0}
        self._changed: str | None = None
        self._is_known = False
        self._unsure: str | None = None
        self._fault: str | None = None
        self._grid: ViewGrid | None = None
        self._pattern: int | None = -1

    def start(self) -> None:
        """Begin to watch, on the running event loop."""
        if self._tasks:
            return
        jobs: list[Callable[[], Coroutine[Any, Any, None]]] = [
            self._watch_link,
            self._watch_folder,
            self._beat,
            functools.partial(self._watch, "status", self._take_status),
            functools.partial(self._watch, "snapshot", self._take_snapshot),
            functools.partial(self._watch, "surface", self._take_surface),
            functools.partial(self._watch, "camera", self._take_camera),
            self._show_pattern,
        ]
        self._tasks = [asyncio.create_task(_for_ever(job)) for job in jobs]

    async def stop(self) -> None:
        """Stop watching."""
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        # Who comes next must not be told what was true then.
        self.link, self._changed, self._is_known = None, None, False
        self._forget()
        self.board.clear("status", "reference")

    async def _do(self, function: Callable[..., _T], *arguments: Any) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._workers, function, *arguments)

    async def _watch_link(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                link = await loop.run_in_executor(self._looking, find_print, self.run)
            except CannotTellError as error:
                self._unsure = str(error)  # what was known last is shown on, as no longer sure
            else:
                if self.link is not None and link != self.link:
                    self._forget()
                self.link, self._unsure = link, None
            self._is_known = True
            await asyncio.sleep(_LINK_S if self.link else _LINK_S / 4)

    async def _watch_folder(self) -> None:
        while True:
            try:
                found = (await self._readers.ask(self.run, "look")).value
            except InputError as error:
                self._fault = str(error)
                self._changed = self._changed or "unknown"
            else:
                self._counts, self._changed, self._fault = found["counts"], found["changed"], None
            await asyncio.sleep(_FOLDER_S if self.link else _FOLDER_S / 4)

    def _forget(self) -> None:
        self._status, self._pattern, self._grid = None, -1, None
        self._seen.clear()
        self.board.clear("snapshot", "planes", "camera", "pattern", "surface")

    async def _beat(self) -> None:
        while True:
            self._publish_status()
            await asyncio.sleep(_HEARTBEAT_S)

    async def _watch(self, name: str, take: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
        reader = _Reader(name)
        while True:
            await asyncio.sleep(_LOOK_S)
            if self.link is None or not (name == "status" or self._is_wanted(name)):
                continue
            message = await self._do(reader.newest, self.link)
            if message is not None:
                self._seen[name] = time.monotonic()
                await take(message)

    def _is_wanted(self, name: str) -> bool:
        return any(self.board.is_read(kind) for kind in ((name, "planes") if name == "surface" else (name,)))

    async def _take_status(self, status: PrintStatus) -> None:
        before, self._status = self._status, status
        is_news = before is None or _news(before) != _news(status)
        if is_news or time.monotonic() - self._published >= _STATUS_S:
            self._publish_status()

    async def _take_snapshot(self, snapshot: Snapshot) -> None:
        self.board.publish("snapshot", await self._do(self._pictures.snapshot, snapshot))
        grid = grid_of(snapshot)
        if grid != self._grid:
            self._grid = grid
            self._asking = asyncio.create_task(self._show_reference(grid))

    async def _show_reference(self, grid: ViewGrid) -> None:
        """Read the reference beside the pictures, which do not wait for it."""
        try:
            sums = (await self._readers.ask(self.run, "reference_sums", *grid)).content
        except InputError as error:
            _LOG.info("%s", error)
            return
        if sums is not None and grid == self._grid:
            self.board.publish("reference", sums)

    async def _take_surface(self, surface: SurfaceSnapshot) -> None:
        self.board.publish("planes", await self._do(self._pictures.planes, surface))
        self.board.publish("surface", await self._do(self._pictures.live_surface, surface))

    async def _take_camera(self, image: CameraImage) -> None:
        self.board.publish("camera", await self._do(self._pictures.camera, image))

    async def _show_pattern(self) -> None:
        while True:
            await asyncio.sleep(_PATTERN_S)
            status = self._status
            if status is None or status.pattern == self._pattern or not self.board.is_read("pattern"):
                continue
            self._pattern = status.pattern
            message = (await self._readers.ask(self.run, "pattern", status.pattern)).content
            if message is not None:
                self.board.publish("pattern", message)

    def _publish_status(self) -> None:
        if self._changed is None or not self._is_known:
            return  # not known yet whether anything prints
        now = self._published = time.monotonic()
        message = {
            "kind": "status",
            "live": self.link is not None,
            "unsure": self._unsure,
            "fault": self._fault,
            "status": None if self._status is None else asdict(self._status),
            "ages_s": {name: round(now - seen, 3) for name, seen in self._seen.items()},
            "counts": self._counts,
            # Results are renewed, and so is what is told of a print that has ended without any.
            "changed": f"{self._changed}{'' if self.link is None else ' live'}",
        }
        self.board.publish("status", to_json(message))


def _news(status: PrintStatus) -> tuple[str, str, str, bool]:
    return status.state, status.message, status.mode, status.pattern is None


async def _for_ever(job: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Do a job again after it failed: a page that is watched must not freeze for one bad message."""
    while True:
        try:
            await job()
        except InputError as error:
            _LOG.info("%s", error)
        except Exception:
            _LOG.exception("while watching a run")
        await asyncio.sleep(0.5)
