"""What a power cut must not take: files that are on the disk for certain, and the way back into a torn recording.

A disk writes the pages of a file in any order.  After a power cut a recording may hold some pages of its last sync and
some of later, and HDF5 cannot open it where its tables are torn.  Frames are written once and never move, so that a
copy of everything else, taken at each sync, is enough to read all frames up to that sync: `write_tables` keeps it
beside the recording, `open_torn` reads the recording through it, and a recording that was closed in order needs none.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import stat
import struct
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vialight.core.errors import InputError
from vialight.system import identity_of

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_HEADER_BYTES, _TABLE_BYTES = 1 << 24, 1 << 28
"""The most that is read of what is beside a recording, which may come from anywhere."""
_SUPERBLOCK_BYTES, _FLAGS_AT, _END_AT = 48, 11, 28
"""Of HDF5's superblock of version 3: its length, where it says who has the file open, where it says how long it is."""
_MOST_PLACES = 1 << 16
"""Of tables in a recording: there is one for each 200 frames or so, so that these are the tables of days."""
_UNFIT = (ValueError, KeyError, TypeError, OverflowError, RecursionError)
"""What comes of tables that someone else made."""
_MASK = 0xFFFFFFFF
_sync = getattr(os, "fdatasync", os.fsync)

Extent = tuple[int, int]
"""Where a piece of a file begins, and its length; bytes."""


def sync_descriptor(descriptor: int) -> None:
    """Return when what was written to a file is on the disk."""
    _sync(descriptor)


def sync_folder(folder: Path) -> None:
    """Return when the names in a folder are on the disk, as far as the system can do that."""
    with contextlib.suppress(OSError):  # Windows opens no folder
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_durably(path: Path, parts: Sequence[bytes]) -> None:
    """Replace a file by one that is on the disk for certain when this returns; at each moment it is whole.

    Raises
    ------
    OSError
        It cannot be written; the former file stays.
    """
    unfinished = path.with_name(f".{path.name}.partial")
    try:
        with unfinished.open("wb") as file:
            for part in parts:
                file.write(part)
            file.flush()
            sync_descriptor(file.fileno())
        unfinished.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def tables_beside(path: Path) -> Path:
    """Return where the tables of a recording are kept while it is written."""
    return path.with_name(f"{path.name}.synced")


def read_at(descriptor: int, length: int, offset: int) -> bytes:
    """Return what a file holds at a place; nobody else may move the descriptor meanwhile."""
    if hasattr(os, "pread"):
        return os.pread(descriptor, length, offset)
    os.lseek(descriptor, offset, os.SEEK_SET)
    return os.read(descriptor, length)


def gaps_between(extents: Sequence[Extent], size: int) -> list[Extent]:
    """Return what of a file of `size` bytes lies outside of all extents.

    Examples
    --------
    >>> gaps_between([(30, 10), (10, 20)], 50)
    [(0, 10), (40, 10)]
    """
    gaps: list[Extent] = []
    end = 0
    for offset, length in [*sorted(extents), (size, 0)]:
        if offset > end:
            gaps.append((end, offset - end))
        end = max(end, offset + length)
    return gaps


def read_tables(descriptor: int, extents: Sequence[Extent], size: int) -> tuple[list[Extent], list[bytes]]:
    """Read all of an HDF5 file that does not lie in the extents of its frames."""
    places = gaps_between(extents, size)
    return places, [read_at(descriptor, length, offset) for offset, length in places]


def write_tables(path: Path, frames: int, size: int, places: list[Extent], pieces: list[bytes]) -> None:
    """Keep a recording's tables beside it, on the disk for certain.

    Raises
    ------
    OSError
        They cannot be written; the former ones stay.
    """
    header = {"boot": _this_boot(), "frames": frames, "size": size, "places": places}
    write_durably(tables_beside(path), [json.dumps(header).encode() + b"\n", *pieces])


def forget_tables(path: Path) -> None:
    """Remove the tables beside a recording that was closed in order."""
    with contextlib.suppress(OSError):
        tables_beside(path).unlink(missing_ok=True)
        sync_folder(path.parent)


def is_from_before_a_start(path: Path) -> bool:
    """Tell whether a recording's writer never closed it, and the machine was started since: its power may have failed.

    A writer that was merely killed has lost nothing: the system still writes what it was given.
    """
    try:
        header, _ = _read_kept(path, with_tables=False)
        return bool(header["boot"] != _this_boot())
    except (OSError, *_UNFIT):
        return False


def open_torn(path: Path) -> Any:
    """Open a recording as it was at its last sync, from what of it is on the disk.

    Returns
    -------
    h5py.File
        For reading.

    Raises
    ------
    InputError
        What is kept beside it does not fit it.
    OSError
        Nothing is kept beside it, or it cannot be read.
    """
    import h5py

    try:
        header, pieces = _read_kept(path)
        torn = _Patched(path, int(header["size"]), header["places"], pieces)
    except _UNFIT as error:
        raise InputError(
            tables_beside(path), f"does not fit its recording ({error})", accepted="what vialight kept beside it",
            remedy="remove it, and the recording is read without",
        ) from error  # fmt: skip
    return h5py.File(torn, "r")


def end_of_hdf5(descriptor: int) -> int:
    """Return the length that an HDF5 file says it has; what lies beyond was only reserved."""
    (end,) = struct.unpack("<Q", read_at(descriptor, 8, _END_AT))
    return int(end)


def _this_boot() -> str:
    me = identity_of()
    return "" if me is None else me.boot


def _read_kept(path: Path, *, with_tables: bool = True) -> tuple[dict[str, Any], bytes]:
    beside = tables_beside(path)
    found = beside.lstat()
    if not stat.S_ISREG(found.st_mode) or found.st_size > _TABLE_BYTES:
        raise ValueError("it is no file, or too large")
    with beside.open("rb") as file:
        header = json.loads(file.readline(_HEADER_BYTES))
        if not isinstance(header, dict):
            raise TypeError("it does not begin with an object")
        return header, file.read() if with_tables else b""


class _Patched(io.RawIOBase):
    """A recording as HDF5 shall see it: frames from the file itself, all else as it was at the last sync."""

    def __init__(self, path: Path, size: int, places: list[Extent], pieces: bytes) -> None:
        # The file may be shorter: what a recording reserved and did not need is cut off when it is closed.
        if size > path.stat().st_size + len(pieces) or sum(length for _, length in places) != len(pieces):
            raise ValueError("lengths do not agree")
        if len(places) > _MOST_PLACES:
            raise ValueError(f"it has more than {_MOST_PLACES} places")
        self._size, self._at = size, 0
        self._places: list[tuple[int, bytes]] = []
        end = taken = 0
        for offset, length in places:
            if offset < end or length <= 0 or offset + length > size:
                raise ValueError("its places do not follow each other")
            self._places.append((offset, pieces[taken : taken + length]))
            end, taken = offset + length, taken + length
        if not self._places or self._places[0][0] != 0 or len(self._places[0][1]) < _SUPERBLOCK_BYTES:
            raise ValueError("it lacks the superblock")
        self._places[0] = (0, _closed(self._places[0][1], size))
        self._file = path.open("rb")

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, into: WriteableBuffer) -> int:
        view = memoryview(into).cast("B")
        begin, stop = self._at, min(self._at + len(view), self._size)
        if stop <= begin:
            return 0
        self._file.seek(begin)
        found = self._file.read(stop - begin)
        view[: stop - begin] = found.ljust(stop - begin, b"\0")
        for at in range(self._place_before(begin), len(self._places)):
            offset, piece = self._places[at]
            if offset >= stop:
                break
            first, last = max(begin, offset), min(stop, offset + len(piece))
            if first < last:
                view[first - begin : last - begin] = piece[first - offset : last - offset]
        self._at = stop
        return stop - begin

    def _place_before(self, at: int) -> int:
        """Return the last place that begins at a byte or before it; the first begins at 0."""
        return bisect_right(self._places, at, key=lambda place: place[0]) - 1

    def close(self) -> None:
        if not self.closed:
            self._file.close()
        super().close()


def _closed(tables: bytes, size: int) -> bytes:
    """Return tables whose superblock says that no writer has the file open, and how long it is."""
    block = bytearray(tables[: _SUPERBLOCK_BYTES - 4])
    block[_FLAGS_AT] = 0
    struct.pack_into("<Q", block, _END_AT, size)  # the writer itself says it at the end only
    return bytes(block) + struct.pack("<I", _lookup3(bytes(block))) + tables[_SUPERBLOCK_BYTES:]


def _lookup3(data: bytes) -> int:
    """Return Bob Jenkins' lookup3 (`hashlittle`, public domain), the checksum of HDF5's tables."""
    a: int = (0xDEADBEEF + len(data)) & _MASK
    b: int = a
    c: int = a
    x: int
    y: int
    z: int
    while len(data) > 12:
        x, y, z = struct.unpack("<III", data[:12])
        a, b, c = (a + x) & _MASK, (b + y) & _MASK, (c + z) & _MASK
        for turn in (4, 6, 8, 16, 19, 4):
            a = ((a - c) & _MASK) ^ _turned(c, turn)
            c = (c + b) & _MASK
            a, b, c = b, c, a
        data = data[12:]
    if not data:
        return c
    x, y, z = struct.unpack("<III", data.ljust(12, b"\0"))
    a, b, c = (a + x) & _MASK, (b + y) & _MASK, (c + z) & _MASK
    for turn in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _turned(b, turn)) & _MASK
        a, b, c = b, c, a
    # After seven steps the names have moved on by one.
    return b


def _turned(value: int, bits: int) -> int:
    return ((value << bits) | (value >> (32 - bits))) & _MASK
