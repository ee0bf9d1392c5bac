"""Outputs that appear whole or not at all.

Results are made in a hidden place on the same file system and renamed when they are complete; whatever goes wrong
before that leaves the user's files as they were.  Here also failures of the operating system become `InputError`.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vialight.core.errors import InputError

_NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@contextmanager
def staged_folder(out: str | Path) -> Iterator[Path]:
    """Give a folder to fill; what it holds moves into `out` when the body succeeds.

    Items replace those of the same name in `out`, a folder as a whole; other items of `out` stay.  On any failure,
    an interrupt included, `out` is left as it was, and is not created.

    Parameters
    ----------
    out
        The folder for the results; it is created if it is missing, its parent is not.

    Yields
    ------
    pathlib.Path
        A new, empty folder: inside `out`, hidden, where `out` exists (it may be a mount of its own, and its parent
        need not be writable), otherwise beside it, so that a single rename makes `out`.

    Raises
    ------
    InputError
        `out` is a file, cannot be written, its parent is missing, or the disk is full.

    Examples
    --------
    >>> import tempfile
    >>> out = Path(tempfile.mkdtemp()) / "results"
    >>> with staged_folder(out) as folder:
    ...     _ = (folder / "answer.txt").write_text("42")
    ...     out.exists()
    False
    >>> (out / "answer.txt").read_text()
    '42'
    """
    target = Path(os.path.realpath(out))
    if target.exists() and not target.is_dir():
        raise InputError(out, "is a file", accepted="a folder, or a name for a new one", remedy="choose another name")
    host = target if target.is_dir() else target.parent
    staging = _new_name(host, target.name)
    with _cleared_on_failure(staging, out):
        with _as_input_error(out):
            staging.mkdir()
        yield staging
        with _as_input_error(out):
            _publish_folder(staging, target)


@contextmanager
def staged_file(path: str | Path, *, folder: bool = False) -> Iterator[Path]:
    """Give a name to write to; what is there becomes `path` when the body succeeds, replacing what was.

    Parameters
    ----------
    path
        The file to make.
    folder
        Whether the product is a folder, as a zarr is; otherwise an existing folder at `path` is refused.

    Yields
    ------
    pathlib.Path
        A name beside `path`, of the same suffix, where nothing is yet.

    Raises
    ------
    InputError
        The place cannot be written, its folder is missing, or the disk is full.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "answer.txt"
    >>> with staged_file(path) as unfinished:
    ...     _ = unfinished.write_text("42")
    >>> path.read_text()
    '42'
    """
    target = Path(os.path.realpath(path))
    if target.is_dir() and not folder:
        raise InputError(path, "is a folder", accepted="the name of a file", remedy="choose another name")
    staging = _new_name(target.parent, target.name)
    with _cleared_on_failure(staging, path), _as_input_error(path):
        staging.touch()  # says now, not after minutes of work, that the place cannot be written
        staging.unlink()
        yield staging
        _publish([(staging, target)], target.parent)


def _new_name(host: Path, name: str) -> Path:
    return host / f".{secrets.token_hex(4)}.partial.{name or 'out'}"


@contextmanager
def _cleared_on_failure(staging: Path, out: str | Path) -> Iterator[None]:
    """Remove `staging` when the body fails, and say so where a full disk was the reason."""
    try:
        yield
    except BaseException as error:
        _remove(staging)
        if isinstance(error, OSError | RuntimeError) and _errno(error) in _NO_SPACE:
            raise disk_full(out) from error
        raise
    _remove(staging)


@contextmanager
def _as_input_error(where: str | Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if _errno(error) in _NO_SPACE:
            raise
        raise unwritable(where, error) from error


def unwritable(where: str | Path, error: Exception) -> InputError:
    """Say that a place cannot be written and why, as far as the system tells."""
    number = _errno(error)
    reason = os.strerror(number) if number else str(error)
    parent = Path(os.path.realpath(where)).parent
    if number in (errno.ENOENT, errno.ENOTDIR) and not parent.is_dir():
        return InputError(where, f"there is no folder {parent}", remedy="create it, or correct the path")
    return InputError(
        where, f"cannot be written ({reason})", accepted="a place that you may write", remedy="choose another"
    )


def disk_full(where: str | Path, kept: str = "nothing was left half-written") -> InputError:
    """Say that the disk is full, how much is free there, and what became of the output."""
    folder = Path(os.path.realpath(where))
    while not folder.is_dir():
        folder = folder.parent
    free_mb = shutil.disk_usage(folder).free / 1e6
    return InputError(
        where, f"the disk is full ({free_mb:.1f} MB free); {kept}", remedy="free space or choose another disk"
    )


def is_disk_full(error: Exception) -> bool:
    """Tell whether `error` comes from a full disk, an exceeded quota or a limit on the size of files."""
    return _errno(error) in _NO_SPACE


def _errno(error: Exception) -> int | None:
    number = getattr(error, "errno", None)
    if number is not None:
        return int(number)
    found = re.search(r"errno = (\d+)", str(error))  # HDF5 tells the number in the text only
    return int(found[1]) if found else None


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def _publish_folder(staging: Path, target: Path) -> None:
    if not target.exists():
        try:
            staging.rename(target)
        except OSError:
            if not target.is_dir():
                raise
            # Another process was quicker; a rename does not replace a folder with something in it.
        else:
            return
    _publish([(item, target / item.name) for item in sorted(staging.iterdir())], target)


def _publish(moves: list[tuple[Path, Path]], folder: Path) -> None:
    """Rename each source to its target, all or none."""
    done: list[tuple[Path, Path, Path | None]] = []
    with _exclusive(folder):
        try:
            for source, target in moves:
                done.append((source, target, _set_aside(target, source)))
                source.replace(target)
        except BaseException:
            for source, target, former in reversed(done):
                if target.exists() and not source.exists():
                    target.rename(source)
                if former is not None:
                    former.replace(target)
                    _remove(former)  # still there if both are links to one file
            raise
        for _, _, former in done:
            if former is not None:
                _remove(former)


def _set_aside(target: Path, source: Path) -> Path | None:
    """Keep what is at `target` under another name, so that it can be put back if `source` does not take its place."""
    if not target.exists() and not target.is_symlink():
        return None
    former = _new_name(target.parent, f"former.{target.name}")
    if source.is_file() and target.is_file() and not target.is_symlink():
        # With a second link the file is never missing: the rename that follows replaces it in one step.
        with contextlib.suppress(OSError):
            os.link(target, former)
            return former
    target.rename(former)
    return former


@contextmanager
def _exclusive(folder: Path) -> Iterator[None]:
    """Let one process at a time rename into `folder`, so that results of two runs do not mix (not on Windows)."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some network file systems have no locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
