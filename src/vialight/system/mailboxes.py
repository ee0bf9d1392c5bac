"""The newest of something, shared between processes: writing never waits, reading never blocks the writer.

A mailbox is a small file in memory that several processes map.  It holds the last three messages; a reader that is slow
skips to the newest.  Only the writer's processor order matters: numbers are written around the message, and a reader
whose numbers do not agree after copying tries again.
"""

from __future__ import annotations

import contextlib
import os
import weakref
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Generic, Self, TypeVar

import numpy as np

from vialight.core.codec import decoder_of, encode
from vialight.core.errors import InputError
from vialight.system.shared_files import make_shared_file, map_shared_file, reserve, words_of

_SLOTS = 3
_WORD = 8
_HEAD_BYTES = 2 * _WORD
"""Number of the newest message, capacity of a slot."""
_SLOT_HEAD_BYTES = 3 * _WORD
"""Number before, length, number after."""
_TRIES = 1000
"""After which a message that is never whole is taken for none: its writer has died in the middle of it."""

_T = TypeVar("_T")


class Mailbox(Generic[_T]):
    """Holds the newest message of one writer for any number of readers.

    Parameters
    ----------
    path
        File that all of them map.
    kind
        Type of the messages.
    capacity
        Bytes that a message may have; given by the writer, who makes the file, and not by readers.

    Raises
    ------
    InputError
        A reader's mailbox is not there (any more), or is none; a writer's finds no room.

    Examples
    --------
    >>> import shutil
    >>> from vialight.system import shared_folder
    >>> folder = shared_folder()
    >>> writer = Mailbox(folder / "state", dict[str, int], capacity=1000)
    >>> reader = Mailbox(folder / "state", dict[str, int])
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

    def __init__(self, path: str | Path, kind: type[_T], capacity: int | None = None) -> None:
        self.path = Path(path)
        self._decode: Callable[[bytes], _T] = decoder_of(kind)
        self._descriptor: int | None = None
        self._let_go: Callable[[], object] | None = None
        if capacity is not None:
            capacity = -(-capacity // _WORD) * _WORD
            make_shared_file(self.path, _HEAD_BYTES + _SLOTS * (_SLOT_HEAD_BYTES + capacity), _HEAD_BYTES)
            self._descriptor = os.open(self.path, os.O_RDWR)
            self._let_go = weakref.finalize(self, os.close, self._descriptor)
        self._map = map_shared_file(self.path, _HEAD_BYTES)
        self._words = words_of(self._map)
        if capacity is not None:
            self._words[1] = capacity
        self._capacity = (len(self._map) - _HEAD_BYTES) // _SLOTS // _WORD * _WORD - _SLOT_HEAD_BYTES
        if self._capacity < 0:
            raise InputError(self.path, "is no mailbox", remedy="check that the print is running")
        self._inode = _inode(self.path)
        self._written = 0
        self._reserved = [0] * _SLOTS

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the memory; the file stays until its folder is removed."""
        self._words = np.empty(0, np.uint64)
        with contextlib.suppress(BufferError):
            self._map.close()
        if self._let_go is not None:
            self._let_go()

    @property
    def is_replaced(self) -> bool:
        """Whether another writer has made the file anew, so that nothing more comes here."""
        return _inode(self.path) not in (self._inode, None)

    def put(self, message: _T) -> None:
        """Make a message the newest one.

        Raises
        ------
        ValueError
            It is larger than the mailbox.
        InputError
            There is not so much shared memory left.
        """
        assert self._descriptor is not None  # readers put nothing
        content = encode(message)
        if len(content) > self._capacity:
            raise ValueError(f"message of {len(content)} bytes in a mailbox of {self._capacity}")
        number = self._written + 1
        start, size = self._slot(number), _SLOT_HEAD_BYTES + len(content)
        if size > self._reserved[number % _SLOTS]:
            reserve(self.path, self._descriptor, start, size)
            self._reserved[number % _SLOTS] = size
        words, place = self._words, start // _WORD
        words[place + 2] = 0
        words[place] = number
        words[place + 1] = len(content)
        self._map[start + _SLOT_HEAD_BYTES : start + size] = content
        words[place + 2] = number
        words[0] = number
        self._written = number

    def newest(self, after: int = 0) -> tuple[int, _T] | None:
        """Return the newest message and its number; None where there is none with a number above `after`.

        Raises
        ------
        InputError
            What is there is no such message.
        """
        for _ in range(_TRIES):
            number = int(self._words[0])
            if number <= after:
                return None
            start = self._slot(number)
            place = start // _WORD
            behind, length = int(self._words[place + 2]), int(self._words[place + 1])
            begin = start + _SLOT_HEAD_BYTES
            content = bytes(self._map[begin : begin + min(length, self._capacity)])
            if behind == number == int(self._words[place]):
                try:
                    return number, self._decode(content)
                except ValueError as error:
                    raise InputError(self.path, str(error), remedy="check that the print is running") from error
        return None

    def _slot(self, number: int) -> int:
        return int(_HEAD_BYTES + (number % _SLOTS) * (_SLOT_HEAD_BYTES + self._capacity))


def _inode(path: Path) -> int | None:
    try:
        return path.stat().st_ino
    except OSError:
        return None
