"""Opening files that anyone may have made: plain files of a sane size alone, and none outside a run's folder."""

from __future__ import annotations

import errno
import io
import os
import stat
from pathlib import Path

from vialight.core.errors import InputError

_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}

_LARGE_BYTES = 1_000_000_000
_MOST_HOLES = 1000
"""Times that a file may state what the disk holds of it: more than file systems that compress gain."""


def file_in(folder: str | Path, *names: str) -> Path:
    """Return the path of something in a folder that came from elsewhere; whatever leads out of it is refused.

    It need not be there.  The folder itself may be reached by a link, which its user made; a link in it may have been
    made by anyone, and is followed only where it stays inside.

    Parameters
    ----------
    folder
        Of a run.
    names
        Of folders and at last the file in it, which may come from a file of the run.

    Raises
    ------
    InputError
        A link, or a name such as ``..``, leads out of the folder.

    Examples
    --------
    >>> import tempfile
    >>> run = Path(tempfile.mkdtemp())
    >>> file_in(run, "history", "000001.npz") == run / "history" / "000001.npz"
    True
    >>> file_in(run, "../secret.txt")
    Traceback (most recent call last):
        ...
    vialight.core.errors.InputError: ...
    """
    path = Path(folder, *names)
    try:
        is_inside = path.resolve().is_relative_to(Path(folder).resolve())
    except (OSError, RuntimeError, ValueError):  # a loop of links, or a name that no file can have
        is_inside = False
    if not is_inside:
        raise InputError(
            path,
            "leads out of its folder",
            accepted="a file in the folder, and no link to another place",
            remedy="copy what is meant to its place",
        )
    return path


def check_plain(path: str | Path, most_bytes: int | None = None) -> int:
    """Refuse what is no plain file, or is too large; opening a pipe would wait for ever, and a device may act.

    Parameters
    ----------
    path
        The file.
    most_bytes
        Its largest size; any by default.

    Returns
    -------
    int
        Its size in bytes.

    Raises
    ------
    InputError
        It is a pipe, a socket or a device, or is too large.
    OSError
        It is missing, is a folder, or may not be looked at.
    """
    try:
        return _checked(path, Path(path).stat(), most_bytes)
    except ValueError as error:
        raise InputError(repr(str(path)), f"is no name of a file ({error})", remedy="correct the path") from error


def open_plain(path: str | Path, most_bytes: int) -> io.BufferedReader:
    """Open a file for reading, if it is a plain file of a sane size; never wait for anything.

    Raises
    ------
    InputError
        It is a pipe, a socket or a device, is too large, or is all holes.
    OSError
        It is missing, is a folder, or may not be read.
    """
    check_plain(path, most_bytes)
    flags = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
    descriptor = os.open(path, flags)
    try:
        found = os.fstat(descriptor)
        _checked(path, found, most_bytes)  # it may have been exchanged meanwhile
        _refuse_holes(path, found)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_plain(path: str | Path, most_bytes: int) -> bytes:
    """Read a whole file, as `open_plain` opens it.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "answer.txt"
    >>> _ = path.write_bytes(b"42")
    >>> read_plain(path, 10)
    b'42'
    >>> read_plain(path, 1)
    Traceback (most recent call last):
        ...
    vialight.core.errors.InputError: ...
    """
    with open_plain(path, most_bytes) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(min(size, most_bytes) + 1)  # memory is taken for as much as is asked for
    if len(content) > most_bytes:
        raise _too_large(path, len(content), most_bytes)
    return content


def _checked(path: str | Path, found: os.stat_result, most_bytes: int | None) -> int:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else than a file")
        raise InputError(path, f"is {kind}", accepted="a plain file", remedy="check the path")
    if most_bytes is not None and found.st_size > most_bytes:
        raise _too_large(path, found.st_size, most_bytes)
    return found.st_size


def _refuse_holes(path: str | Path, found: os.stat_result) -> None:
    """Refuse to read from end to end what is hardly there; formats such as HDF5 leave holes and read none of them."""
    stored_bytes = 512 * getattr(found, "st_blocks", found.st_size)
    if found.st_size > _LARGE_BYTES and found.st_size > _MOST_HOLES * (stored_bytes + 1):
        raise InputError(
            path,
            f"is all holes: of {found.st_size / 1e9:.4g} GB, {stored_bytes / 1e9:.4g} GB are on the disk",
            accepted="a file that was written to its end",
            remedy="copy it again",
        )


def _too_large(path: str | Path, size: int, most_bytes: int) -> InputError:
    return InputError(
        path,
        f"has {size / 1e6:.4g} MB",
        accepted=f"a file of this kind has {most_bytes / 1e6:.4g} MB at most",
        remedy="check that it is the right file",
    )
