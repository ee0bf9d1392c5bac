"""The newest of something, shared between processes: writing never waits, reading never blocks the writer.

A mailbox is a small file in memory that several processes map.  It holds the last three messages; a reader that is slow
skips to the newest.  Only the writer's processor order matters: numbers are written around the message, and a reader
whose numbers do not agree after copying tries again.  Messages are pickled: the folder is private to the user.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import pickle
import secrets
import shutil
import struct
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from vialight.errors import InputError

_SLOTS = 3
_HEAD = struct.Struct("<QQ")
"""Number of the newest message, capacity of a slot."""
_SLOT_HEAD = struct.Struct("<QQQ")
"""Number before, length, number after."""
_PREFIX = "vialight-"


def shared_folder() -> Path:
    """Make a private folder in memory, where the system has such a place, for the mailboxes of one run.

    Folders whose process is gone are cleared away.
    """
    memory = Path("/dev/shm")
    host = memory if os.access(memory, os.W_OK) else Path(tempfile.gettempdir())
    for left in host.glob(f"{_PREFIX}*"):
        pid = left.name.removeprefix(_PREFIX).split("-")[0]
        if pid.isdigit() and not _is_running(int(pid)):
            shutil.rmtree(left, ignore_errors=True)
    folder = host / f"{_PREFIX}{os.getpid()}-{secrets.token_hex(4)}"
    folder.mkdir(mode=0o700)
    return folder


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


class Mailbox:
    """Holds the newest message of one writer for any number of readers.

    Parameters
    ----------
    path
        File that all of them map.
    capacity
        Bytes that a message may have; given by the writer, who makes the file, and not by readers.

    Raises
    ------
    InputError
        A reader's mailbox is not there (any more).

    Examples
    --------
    >>> folder = shared_folder()
    >>> writer = Mailbox(folder / "state", capacity=1000)
    >>> reader = Mailbox(folder / "state")
    >>> reader.newest() is None
    True
    >>> writer.put({"turn": 3})
    >>> reader.newest()
    (1, {'turn': 3})
    >>> reader.newest(after=1) is None
    True
    >>> reader.close(), writer.close(), shutil.rmtree(folder)
    (None, None, None)
    """

    def __init__(self, path: str | Path, capacity: int | None = None) -> None:
        self.path = Path(path)
        try:
            if capacity is not None:
                fresh = self.path.with_suffix(".new")
                with fresh.open("wb") as made:
                    made.truncate(_HEAD.size + _SLOTS * (_SLOT_HEAD.size + capacity))
                    made.write(_HEAD.pack(0, capacity))
                fresh.rename(self.path)
            with self.path.open("r+b") as file:
                self._map = mmap.mmap(file.fileno(), 0)
        except OSError as error:
            raise InputError(
                self.path, f"cannot be opened ({error.strerror})", accepted="the mailbox of a running print",
                remedy="check that the print is running",
            ) from error  # fmt: skip
        _, self._capacity = _HEAD.unpack_from(self._map)
        self._written = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the memory; the file stays until its folder is removed."""
        with contextlib.suppress(BufferError):
            self._map.close()

    def put(self, message: Any) -> None:
        """Make a message the newest one.

        Raises
        ------
        ValueError
            It is larger than the mailbox.
        """
        content = pickle.dumps(message, protocol=5)
        if len(content) > self._capacity:
            raise ValueError(f"message of {len(content)} bytes in a mailbox of {self._capacity}")
        number = self._written + 1
        start = self._slot(number)
        _SLOT_HEAD.pack_into(self._map, start, number, len(content), 0)
        self._map[start + _SLOT_HEAD.size : start + _SLOT_HEAD.size + len(content)] = content
        _SLOT_HEAD.pack_into(self._map, start, number, len(content), number)
        _HEAD.pack_into(self._map, 0, number, self._capacity)
        self._written = number

    def newest(self, after: int = 0) -> tuple[int, Any] | None:
        """Return the newest message and its number; None where there is none with a number above `after`."""
        while True:
            number, _ = _HEAD.unpack_from(self._map)
            if number <= after:
                return None
            start = self._slot(number)
            before, length, behind = _SLOT_HEAD.unpack_from(self._map, start)
            content = bytes(self._map[start + _SLOT_HEAD.size : start + _SLOT_HEAD.size + min(length, self._capacity)])
            if before == behind == number == _SLOT_HEAD.unpack_from(self._map, start)[0]:
                return number, pickle.loads(content)

    def _slot(self, number: int) -> int:
        return int(_HEAD.size + (number % _SLOTS) * (_SLOT_HEAD.size + self._capacity))
