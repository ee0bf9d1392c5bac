"""Opening zip archives that anyone may have made: what they would unpack to is known before anything is unpacked."""

from __future__ import annotations

import struct
import zipfile
from typing import BinaryIO

from vialight.core.errors import InputError

_PLAIN_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_END = struct.Struct("<4s4H2LH")
_END_MARK = b"PK\x05\x06"
_END64 = struct.Struct("<4sQ2H2L4Q")
_LOCATOR_MARK = b"PK\x06\x07"
_LOCATOR_BYTES = 20
_LONGEST_COMMENT = 65_536
_ENTRY_BYTES = 46
"""Least that the directory has for an entry."""


def open_archive(file: BinaryIO, where: object, *, most_bytes: int, most_entries: int = 10_000) -> zipfile.ZipFile:
    """Open an archive of which no more can be unpacked than is said here.

    Python unpacks no entry beyond the size that the directory states, so that a directory that lies gains nothing.

    Parameters
    ----------
    file
        Open for reading.
    where
        Named in errors.
    most_bytes
        Unpacked, all together.
    most_entries
        Of its directory, which is read as a whole.

    Raises
    ------
    InputError
        It is larger, or packed in a way that may need any amount of memory.
    zipfile.BadZipFile
        It is no archive.

    Examples
    --------
    >>> import io
    >>> packed = io.BytesIO()
    >>> with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
    ...     archive.writestr("zeros", bytes(1_000_000))
    >>> open_archive(packed, "zeros.zip", most_bytes=2_000_000).namelist()
    ['zeros']
    >>> open_archive(packed, "zeros.zip", most_bytes=500_000)
    Traceback (most recent call last):
        ...
    vialight.core.errors.InputError: ...
    """
    if _entries(file) > most_entries:
        raise InputError(where, "is an archive of too many entries", accepted=f"{most_entries} at most")
    archive = zipfile.ZipFile(file)
    entries = archive.infolist()
    if len(entries) > most_entries or len({entry.filename for entry in entries}) != len(entries):
        raise InputError(
            where, f"is an archive of {len(entries)} entries", accepted=f"{most_entries} at most, each of its own name"
        )
    if any(entry.compress_type not in _PLAIN_METHODS or entry.flag_bits & 1 for entry in entries):
        raise InputError(where, "is packed in an unusual way, or encrypted", accepted="deflate, or not packed")
    if (total := sum(entry.file_size for entry in entries)) > most_bytes:
        raise InputError(
            where,
            f"would unpack to {total / 1e6:.4g} MB",
            accepted=f"{most_bytes / 1e6:.4g} MB at most",
            remedy="check where it comes from",
        )
    return archive


def _entries(file: BinaryIO) -> int:
    """Return how many entries the directory can have by its size, whichever of its ends Python will believe."""
    size = file.seek(0, 2)
    begin = max(0, size - _END.size - _LONGEST_COMMENT - _END64.size - _LOCATOR_BYTES)
    file.seek(begin)
    tail = file.read()
    file.seek(0)
    most_bytes, at = 0, tail.find(_END_MARK)
    while 0 <= at <= len(tail) - _END.size:
        directory_bytes = int(_END.unpack_from(tail, at)[5])
        large = at - _LOCATOR_BYTES - _END64.size
        if large >= 0 and tail.startswith(_LOCATOR_MARK, at - _LOCATOR_BYTES):
            directory_bytes = int(_END64.unpack_from(tail, large)[-2])
        most_bytes, at = max(most_bytes, directory_bytes), tail.find(_END_MARK, at + 1)
    return most_bytes // _ENTRY_BYTES
