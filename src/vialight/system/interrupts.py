"""Ctrl-C and the wish to end: heard at once, even where the main thread is held up by a terminal or a long call."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from vialight.system.processes import no_code_from_here

_FROM_A_TERMINAL = [getattr(signal, name) for name in ("SIGINT", "SIGTSTP") if hasattr(signal, name)]
"""Ctrl-C and Ctrl-Z."""


def leave_interrupts_to_the_print() -> None:
    """Go on when the user presses Ctrl-C or Ctrl-Z: what that ends is for the process that prints to decide.

    For processes that a print has started, called first of all: a terminal sends both to every one of them.  Ctrl-Z
    would stop the projector and all who watch it at once; so it stops the print alone, whose leave to show light then
    ends.  From then on Linux lists the process by the name that the print has given it, for who looks which one hangs.
    """
    for number in _FROM_A_TERMINAL:
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(multiprocessing.current_process().name, encoding="utf-8")


@contextlib.contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Start processes within that do not hear Ctrl-C or Ctrl-Z even before their own first line has run.

    Without, one that is still importing its modules dies of it.  Only the thread that starts them is deaf meanwhile;
    where the system has no such thing, they are as before.  They import nothing from the current folder either, as
    `no_code_from_here` says.
    """
    with no_code_from_here():
        if not hasattr(signal, "pthread_sigmask"):
            yield
            return
        resource_tracker.ensure_running()  # multiprocessing's own, which lets the signal through again when started
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _FROM_A_TERMINAL)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class StopAsked:
    """Whether the user has asked to stop, by Ctrl-C or by ending the process.

    The system itself writes the signal's number into a socket, and a thread that does nothing else reads it there: the
    main thread may meanwhile be anywhere.  The first Ctrl-C is only noted.  The second one, and the wish to end the
    process (SIGTERM), do besides what they did before.

    Parameters
    ----------
    on_first
        Called once, on that thread, when it is asked for.

    Examples
    --------
    >>> with StopAsked() as asked:
    ...     signal.raise_signal(signal.SIGINT)
    ...     asked.wait(1.0), bool(asked)
    (True, True)
    """

    def __init__(self, on_first: Callable[[], None] = lambda: None) -> None:
        self._on_first = on_first
        self._asked = threading.Event()
        self._before: Any = None
        self._woken_before = -1
        self._near: socket.socket | None = None
        self._far: socket.socket | None = None

    def __bool__(self) -> bool:
        return self._asked.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Wait until it is asked for; False where that does not come in time."""
        return self._asked.wait(timeout_s)

    def __enter__(self) -> Self:
        if threading.current_thread() is not threading.main_thread():
            return self  # signals are the main thread's; who prints from another one stops in another way
        self._near, self._far = socket.socketpair()
        self._far.setblocking(False)
        threading.Thread(target=self._listen, args=(self._near,), name="signals", daemon=True).start()
        self._woken_before = signal.set_wakeup_fd(self._far.fileno(), warn_on_full_buffer=False)
        self._before = signal.signal(signal.SIGINT, self._first_interrupt)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._far is None or self._near is None:
            return
        signal.signal(signal.SIGINT, self._before)
        signal.set_wakeup_fd(self._woken_before)
        self._far.close()  # which ends the thread

    def _first_interrupt(self, number: int, frame: FrameType | None) -> None:
        self._asked.set()
        signal.signal(signal.SIGINT, self._before)

    def _listen(self, near: socket.socket) -> None:
        told = False
        with near, contextlib.suppress(OSError):
            while numbers := near.recv(64):
                if not {signal.SIGINT, signal.SIGTERM} & set(numbers):
                    continue
                self._asked.set()
                if not told:
                    told = True
                    self._on_first()
