"""Runs by names of ours, and the files in their folders that are their own.

A folder may come from anywhere: what is in it is data, links in it lead nowhere.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from vialight.core.errors import InputError, VialightError
from vialight.printing.live_link import LiveLink, find_live_print

_MARKS = ("run.json", "live.json", "frames.h5", "history", "reconstruction.json")
_MOST_NAMES = 100_000
"""Names in a folder that are looked through."""


Mark = tuple[int, int]


class CannotTellError(InputError):
    """Whether a print runs, or does what it is told, cannot be told: not to be taken for a no."""


@dataclass(frozen=True)
class Run:
    """A run's folder under a name of ours."""

    key: str
    """What addresses call it: of letters and digits."""
    name: str
    """What people are shown: `printable`, so that no path is made of it."""
    folder: Path

    @classmethod
    def of(cls, folder: Path) -> Run:
        """Return the run in a folder."""
        digest = hashlib.sha256(folder.name.encode("utf-8", "surrogateescape")).hexdigest()
        return cls(digest[:12], printable(folder.name), folder)


def printable(name: str) -> str:
    r"""Return a name as it can be shown and sent: what in it is not UTF-8 as question marks.

    Examples
    --------
    >>> import os
    >>> printable(os.fsdecode(b"ring-\xff"))
    'ring-?'
    """
    return name.encode("utf-8", "replace").decode()


def is_run(folder: Path) -> bool:
    """Tell whether a folder is a run's: a real folder, in sight, with one of the files that only runs have.

    Examples
    --------
    >>> is_run(Path("no such run"))
    False
    """
    return not folder.name.startswith(".") and _is_folder(folder) and any(_is_there(folder / mark) for mark in _MARKS)


def runs_in(root: Path) -> Iterator[Path]:
    """Yield the folders of the runs in a folder, in no order."""
    with os.scandir(root) as items:
        for count, item in enumerate(items):
            if count == _MOST_NAMES:
                return
            if is_run(Path(item.path)):
                yield Path(item.path)


def find_run(root: Path, key: str) -> Run | None:
    """Return the run of a key in a folder of runs, or of a folder that is a run itself, by names alone."""
    if is_run(root):
        run = Run.of(root)
        return run if run.key == key else None
    return next((run for run in map(Run.of, runs_in(root)) if run.key == key), None)


def own_file(folder: Path, name: str, *, most_bytes: int | None = None) -> Path | None:
    """Return a file that is a run's own: a regular one, in folders that are no links, and no larger than it may be.

    Parameters
    ----------
    folder
        The run's.
    name
        Below it, with ``/`` between folders.
    most_bytes
        Of a file that is to be read as a whole.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> (folder / "run.json").write_text("{}"), (folder / "surface.stl").symlink_to("/etc/passwd")
    (2, None)
    >>> own_file(folder, "run.json") == folder / "run.json", own_file(folder, "surface.stl")
    (True, None)
    """
    path = folder
    try:
        if stat.S_ISLNK(folder.lstat().st_mode):
            return None
        *folders, last = PurePosixPath(name).parts
        if ".." in (*folders, last) or name.startswith("/"):
            return None
        for part in folders:
            path = path / part
            if not stat.S_ISDIR(path.lstat().st_mode):
                return None
        path = path / last
        about = path.lstat()
    except (OSError, ValueError):
        return None
    is_small = most_bytes is None or about.st_size <= most_bytes
    return path if stat.S_ISREG(about.st_mode) and is_small else None


def mark_of(path: Path | None) -> Mark | None:
    """Return what a file's content is known again by: another one has another, also by the same name; None: no file."""
    about = None if path is None else _about(path)
    return None if about is None else (about.st_ino, about.st_mtime_ns)


def own_folder(folder: Path, name: str) -> Path | None:
    """Return a folder that is a run's own, with nothing but folders and regular files in it, however deep."""
    top = folder / name
    if not (_is_folder(folder) and _is_folder(top)):
        return None
    try:
        for count, path in enumerate(_below(top)):
            if count == _MOST_NAMES or path is None:
                return None
    except (OSError, RecursionError):
        return None
    return top


def _below(folder: Path) -> Iterator[Path | None]:
    """Yield what is in a folder and those in it; None for what is neither a folder nor a regular file."""
    with os.scandir(folder) as items:
        for item in items:
            if item.is_dir(follow_symlinks=False):
                yield from _below(Path(item.path))
            else:
                yield Path(item.path) if item.is_file(follow_symlinks=False) else None


def find_print(run: Run) -> LiveLink | None:
    """Return how to reach the print of a run; None where the system confirms that none is running.

    Raises
    ------
    CannotTellError
        It does not: for want of descriptors or of permission, or because its disk does not answer.
    """
    try:
        return find_live_print(run.folder)
    except (VialightError, OSError) as error:
        why = getattr(error.__cause__ or error, "strerror", None)
        raise cannot_tell(why or str(error)) from error


def cannot_tell(why: str) -> CannotTellError:
    """Say that it is not known whether a print runs."""
    return CannotTellError(
        "print", f"cannot tell whether it is running ({why})", remedy="use the switch on the machine"
    )


def changed_at(folder: Path) -> float:
    """Return when a run was last begun, or its results written."""
    times = [about.st_mtime for mark in ("run.json", "live.json") if (about := _about(folder / mark)) is not None]
    about = _about(folder)
    return max(times, default=about.st_mtime if about else 0.0)


def _about(path: Path) -> os.stat_result | None:
    try:
        return path.lstat()
    except OSError:
        return None


def _is_folder(path: Path) -> bool:
    about = _about(path)
    return about is not None and stat.S_ISDIR(about.st_mode)


def _is_there(path: Path) -> bool:
    return _about(path) is not None
