"""Places for connections: those of strangers are few and short-lived, and never those of who is let in.

A stranger may share the operator's address, since every program of the same machine does.  No connection is refused,
therefore: when there is no place left, the stranger's that has been open for longest is cut.  Whoever asks at once is
answered long before that.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import socket
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from vialight.core.errors import VialightError

_T = TypeVar("_T")
_LOG = logging.getLogger("vialight.web")
_HANDFUL = 32
"""Connections accepted before those that are open are heard again."""
_PAUSE_S = 0.02
"""Without accepting, where the system has no descriptor left."""
_NO_DESCRIPTOR = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}


class Connection(Protocol):
    """What has a place."""

    @property
    def address(self) -> str:
        """The other side's."""
        ...

    @property
    def is_idle(self) -> bool:
        """Whether cutting it interrupts nothing."""
        ...

    def cut(self) -> None:
        """Close it, without a word and without waiting."""
        ...


@dataclass(frozen=True)
class Limits:
    """How many connections there may be, and for how long a stranger's.

    Parameters
    ----------
    strangers
        Connections that are not let in.
    of_one
        Of those, from one address.
    inside
        Connections that are let in.
    silence_s
        From connecting to a first word.
    patience_s
        From there until a request is let in.
    """

    strangers: int = 128
    of_one: int = 64
    inside: int = 256
    silence_s: float = 2.0
    patience_s: float = 3.0

    @classmethod
    def of_this_process(cls) -> Limits:
        """Return limits that leave more than half of the process' descriptors to what else it does."""
        try:
            import resource
        except ImportError:
            return cls()
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if soft == resource.RLIM_INFINITY:
            return cls()
        return cls(min(128, soft // 8), min(64, soft // 16), min(256, soft // 4))


class Places:
    """Who is connected, on one event loop.

    Parameters
    ----------
    limits
        How many.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._strangers: dict[Connection, None] = {}
        self._of_one: defaultdict[str, dict[Connection, None]] = defaultdict(dict)
        self._inside: dict[Connection, None] = {}

    @property
    def counts(self) -> tuple[int, int]:
        """How many strangers there are, and how many are let in."""
        return len(self._strangers), len(self._inside)

    def enter(self, connection: Connection) -> None:
        """Give a stranger a place, if need be another stranger's."""
        of_one = self._of_one[connection.address]
        self._strangers[connection] = of_one[connection] = None
        if len(of_one) > self.limits.of_one:
            self._cut(next(iter(of_one)))
        elif len(self._strangers) > self.limits.strangers:
            self.cut_oldest_stranger()

    def let_in(self, connection: Connection) -> None:
        """Give a connection a place that no stranger can take."""
        if connection in self._inside or connection not in self._strangers:
            return
        self.leave(connection)
        self._inside[connection] = None
        if len(self._inside) > self.limits.inside:
            others = [other for other in self._inside if other is not connection]
            self._cut(next((other for other in others if other.is_idle), others[0]))

    def leave(self, connection: Connection) -> None:
        """Take note that a connection is gone."""
        self._inside.pop(connection, None)
        if connection in self._strangers:
            del self._strangers[connection]
            of_one = self._of_one[connection.address]
            del of_one[connection]
            if not of_one:
                del self._of_one[connection.address]

    def cut_oldest_stranger(self) -> bool:
        """Make room; tell whether there was anyone to cut."""
        oldest = next(iter(self._strangers), None)
        if oldest is not None:
            self._cut(oldest)
        return oldest is not None

    def _cut(self, connection: Connection) -> None:
        self.leave(connection)
        connection.cut()


class Reserve:
    """Descriptors that are held open only to be let go of when Stop needs them.

    Parameters
    ----------
    count
        How many.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._held: list[int] = []
        self._lock = threading.Lock()
        self.is_lent = False
        self.fill()

    def fill(self) -> None:
        """Take back what was let go of, as far as there are descriptors."""
        with self._lock, contextlib.suppress(OSError):
            while len(self._held) < self._count:
                self._held.append(os.open(os.devnull, os.O_RDONLY))

    def release(self, count: int | None = None) -> bool:
        """Let go of some, by default all; tell whether there were any."""
        with self._lock:
            count = len(self._held) if count is None else min(count, len(self._held))
            for _ in range(count):
                os.close(self._held.pop())
            return count > 0

    @contextlib.contextmanager
    def lent(self) -> Iterator[None]:
        """Lend all of them to what is done inside; meanwhile nobody is accepted."""
        self.is_lent = True
        self.release()
        try:
            yield
        finally:
            self.is_lent = False
            self.fill()

    def spent_on(self, function: Callable[..., _T], *arguments: Any) -> _T:
        """Do something, and where there are no descriptors for it, do it again with those held here."""
        try:
            return function(*arguments)
        except (OSError, VialightError) as error:
            if not is_out_of_descriptors(error):
                raise
        with self.lent():
            return function(*arguments)

    def close(self) -> None:
        """Let go of all of them for good."""
        self._count = 0
        self.release()


def is_out_of_descriptors(error: BaseException | None) -> bool:
    """Tell whether that is what lies behind an error.

    Examples
    --------
    >>> is_out_of_descriptors(OSError(errno.EMFILE, "")), is_out_of_descriptors(OSError(errno.EACCES, ""))
    (True, False)
    """
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_DESCRIPTOR:
            return True
        error = error.__cause__ or error.__context__
    return False


class Acceptor:
    """Accepts connections by small handfuls, and goes on where the system has no descriptor left.

    The event loop's own would take all that have queued up before the first of them is heard, and then, out of
    descriptors, none for a second.  One that says nothing is given nothing but its place, so that a thousand of them
    hold up nobody.

    Parameters
    ----------
    listener
        Listens already.
    make
        Makes what a connection talks to, which enters `places` itself.
    places
        Whom to cut when the system is out of descriptors.
    reserve
        What to let go of when there is nobody to cut.
    """

    def __init__(
        self, listener: socket.socket, make: Callable[[], asyncio.Protocol], places: Places, reserve: Reserve
    ) -> None:
        self._listener, self._make, self._places, self._reserve = listener, make, places, reserve
        self._tasks: set[asyncio.Task[None]] = set()
        self._is_closed = False
        listener.setblocking(False)

    def start(self) -> None:
        """Begin, on the running event loop."""
        if not self._is_closed:
            asyncio.get_running_loop().add_reader(self._listener.fileno(), self._accept)

    def close(self) -> None:
        """Accept no more."""
        self._is_closed = True
        if self._listener.fileno() >= 0:
            asyncio.get_running_loop().remove_reader(self._listener.fileno())

    def _accept(self) -> None:
        if self._reserve.is_lent:
            self._pause()
            return
        for count in range(_HANDFUL):
            try:
                connection, address = self._listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                if error.errno not in _NO_DESCRIPTOR:
                    _LOG.warning("cannot accept connections: %s", error)
                    self._pause()
                elif count:
                    return  # perhaps nobody else has come; the system says this first
                elif not self._places.cut_oldest_stranger() and not self._reserve.release(1):
                    self._pause()
                return
            connection.setblocking(False)
            self._places.enter(_Silent(connection, address, self._places, self._hear))

    def _hear(self, connection: socket.socket) -> None:
        task = asyncio.get_running_loop().create_task(self._connect(connection))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _connect(self, connection: socket.socket) -> None:
        try:
            await asyncio.get_running_loop().connect_accepted_socket(self._make, connection)
        except OSError:
            connection.close()
        self._reserve.fill()

    def _pause(self) -> None:
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._listener.fileno())
        loop.call_later(_PAUSE_S, self.start)


class _Silent:
    """A connection that has said nothing yet."""

    is_idle = True

    def __init__(
        self, connection: socket.socket, address: Any, places: Places, hear: Callable[[socket.socket], None]
    ) -> None:
        self.address = str(address[0]) if address else ""
        self._connection, self._places, self._hear = connection, places, hear
        self._loop = asyncio.get_running_loop()
        self._timer = self._loop.call_later(places.limits.silence_s, self.cut)
        self._loop.add_reader(connection.fileno(), self._begin)

    def cut(self) -> None:
        """Close it, without a word and without waiting."""
        self._leave()
        self._connection.close()

    def _begin(self) -> None:
        self._leave()
        self._hear(self._connection)

    def _leave(self) -> None:
        self._timer.cancel()
        self._loop.remove_reader(self._connection.fileno())
        self._places.leave(self)
