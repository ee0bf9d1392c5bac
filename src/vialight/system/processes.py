"""Processes of this machine: told apart from later ones of the same number, asked how they do, and started safely."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import psutil

ProcessState = Literal["runs", "stopped", "gone"]

_STOPPED = {psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP}
_GONE = {psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD}
_SAFE_PATH = "PYTHONSAFEPATH"
_starting = threading.RLock()
_FIELDS_BEFORE_START = 19
"""Of /proc/PID/stat, after the name in parentheses."""


class ProcessIdentity(NamedTuple):
    """What tells a process from every other that has had, or will have, its number."""

    pid: int
    started: str
    """When it started, in the system's own terms."""
    boot: str
    """Which start of the machine that counts from."""
    user: str


def identity_of(pid: int | None = None) -> ProcessIdentity | None:
    """Return who a process is, by default this one; None where there is none of that number.

    Examples
    --------
    >>> identity_of() == identity_of(os.getpid())
    True
    >>> identity_of(0) is None, identity_of(-1) is None
    (True, True)
    """
    pid = os.getpid() if pid is None else pid
    if pid <= 0:
        return None
    try:
        process = psutil.Process(pid)
        if process.status() in _GONE:
            return None
        return ProcessIdentity(pid, _started(process), _boot(), process.username())
    except (psutil.Error, OSError, OverflowError):
        return None


def is_same_process(identity: ProcessIdentity) -> bool:
    """Tell whether that very process is still there.

    Examples
    --------
    >>> me = identity_of()
    >>> is_same_process(me), is_same_process(me._replace(started="another time"))
    (True, False)
    """
    return identity_of(identity.pid) == identity


def state_of(pid: int) -> ProcessState:
    """Tell whether a process runs (or could), was stopped from outside, or is gone.

    Examples
    --------
    >>> state_of(os.getpid())
    'runs'
    """
    try:
        status = psutil.Process(pid).status()
    except (psutil.Error, OSError, ValueError, OverflowError):
        return "gone"
    return "stopped" if status in _STOPPED else "gone" if status in _GONE else "runs"


def _started(process: psutil.Process) -> str:
    """Return the start in ticks since the machine's own start where the system tells: no clock can be set under it."""
    try:
        text = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8", errors="replace")
        return text.rpartition(")")[2].split()[_FIELDS_BEFORE_START]
    except (OSError, IndexError):
        return f"{process.create_time():.2f}"


@functools.cache
def _boot() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return f"{psutil.boot_time():.0f}"


@contextlib.contextmanager
def no_code_from_here() -> Iterator[None]:
    """Start processes of Python within that import nothing from the current folder: it may be one that was given.

    Python puts that folder before its own modules where it is started with ``-c``, as multiprocessing does, or ``-m``.

    Examples
    --------
    >>> import subprocess, sys
    >>> with no_code_from_here():
    ...     subprocess.check_output([sys.executable, "-c", "import sys; print('' in sys.path)"]).strip()
    b'False'
    """
    with _starting:  # threads that start some at the same time would undo each other's environment
        before = os.environ.get(_SAFE_PATH)
        os.environ[_SAFE_PATH] = "1"
        try:
            yield
        finally:
            if before is None:
                os.environ.pop(_SAFE_PATH, None)
            else:
                os.environ[_SAFE_PATH] = before
