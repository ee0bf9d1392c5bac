"""Files in memory that several processes map, in folders that only this user can read."""

from __future__ import annotations

import json
import mmap
import os
import re
import secrets
import shutil
import stat
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from vialight.core.errors import InputError
from vialight.system.processes import ProcessIdentity, identity_of, is_same_process

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_PREFIX = "vialight-"
_OWNER = "owner.json"
_NAME = re.compile(rf"{_PREFIX}(\d+)-[0-9a-f]{{8}}")


def shared_folder() -> Path:
    """Make a private folder in memory, where the system has such a place, for what the processes of a print share.

    Folders of this user whose process is gone are cleared away.
    """
    return _made_in(_host())


def scratch_folder() -> Path:
    """Make a private folder on the disk for what is not kept; those of processes that are gone are cleared away."""
    return _made_in(Path(tempfile.gettempdir()))


def _made_in(host: Path) -> Path:
    _clear_away_leavings(host)
    folder = host / f"{_PREFIX}{os.getpid()}-{secrets.token_hex(4)}"
    folder.mkdir(mode=0o700)
    (folder / _OWNER).write_text(json.dumps({"process": identity_of(), "numbers": _numbers()}), encoding="utf-8")
    return folder


def is_shared_folder(path: str | Path, pid: int) -> bool:
    """Tell whether a path is a folder that `shared_folder` has made for a process of this user.

    Examples
    --------
    >>> made = shared_folder()
    >>> is_shared_folder(made, os.getpid()), is_shared_folder(made, 1), is_shared_folder("/tmp", os.getpid())
    (True, False, False)
    >>> shutil.rmtree(made)
    """
    path = Path(path)
    return path.parent == _host() and _is_ours(path, pid)


def _is_ours(path: Path, pid: int) -> bool:
    name = _NAME.fullmatch(path.name)
    if name is None or int(name[1]) != pid:
        return False
    try:
        found = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and _is_private(found)


def make_shared_file(path: Path, size: int, reserved: int | None = None) -> None:
    """Make a file of zeros for processes to map; it appears whole, and its memory is set aside.

    Without, a small place in memory (``/dev/shm`` of a container has 64 MB) would end a process when it writes.

    Parameters
    ----------
    path
        Where.
    size
        Bytes.
    reserved
        Bytes that are set aside now, by default all; the rest by `reserve` before it is used.

    Raises
    ------
    InputError
        There is not so much memory, or the file cannot be made.
    """
    fresh = path.with_name(f"{path.name}.new")
    try:
        with fresh.open("wb") as file:
            file.truncate(size)
            reserve(path, file.fileno(), 0, size if reserved is None else reserved)
        fresh.replace(path)
    except InputError:
        fresh.unlink(missing_ok=True)
        raise
    except OSError as error:
        raise InputError(path, f"cannot be made ({error.strerror})", remedy="check the folder") from error


def reserve(path: Path, descriptor: int, start: int, size: int) -> None:
    """Set memory of a shared file aside; what is set aside already costs nothing.

    Raises
    ------
    InputError
        There is not so much.
    """
    if not hasattr(os, "posix_fallocate"):
        return  # where there is none, files in memory are files like others
    try:
        os.posix_fallocate(descriptor, start, size)
    except OSError as error:
        free = shutil.disk_usage(path.parent).free
        raise InputError(
            path.parent,
            f"has no room for {size / 1e6:.1f} MB of shared memory ({error.strerror}; {free / 1e6:.1f} MB free)",
            remedy="give it more (docker run --shm-size=1g), or choose a larger voxel or binning",
        ) from error


def map_shared_file(path: Path, least: int = 1) -> mmap.mmap:
    """Map a file that another process has made.

    Raises
    ------
    InputError
        It is not there (any more), or is smaller than it must be.
    """
    try:
        with path.open("r+b") as file:
            mapped = mmap.mmap(file.fileno(), 0)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is empty"
        raise InputError(
            path,
            f"cannot be opened ({why})",
            accepted="the shared memory of a running print",
            remedy="check that the print is running",
        ) from error
    if len(mapped) < least:
        raise InputError(path, f"has {len(mapped)} bytes", accepted=f"{least} or more, as a running print makes them")
    return mapped


def words_of(mapped: mmap.mmap) -> NDArray[np.uint64]:
    """Return mapped memory as numbers of 64 bits, each of which is written and read by one instruction.

    `struct.pack_into` first clears what it then fills: another process may see that, and a writer may be stopped there.
    """
    import numpy as np  # heavy, and commands that only tell of themselves do without

    return np.frombuffer(mapped, np.uint64, len(mapped) // 8)


def _host() -> Path:
    memory = Path("/dev/shm")
    return memory if os.access(memory, os.W_OK) else Path(tempfile.gettempdir())


def _is_private(found: os.stat_result) -> bool:
    """Tell whether only this user may use a folder; where the system has no such rights, its place says so."""
    if not hasattr(os, "getuid"):
        return True
    return found.st_uid == os.getuid() and stat.S_IMODE(found.st_mode) & 0o077 == 0


def _clear_away_leavings(host: Path) -> None:
    for left in host.glob(f"{_PREFIX}*"):
        name = _NAME.fullmatch(left.name)
        if name is None or not _is_ours(left, int(name[1])):
            continue
        if not _has_owner(left, int(name[1])):
            shutil.rmtree(left, ignore_errors=True)


def _has_owner(folder: Path, pid: int) -> bool:
    """Tell whether the process that made a folder is there, or cannot be looked for from here."""
    try:
        owner = json.loads((folder / _OWNER).read_text(encoding="utf-8"))
        return owner["numbers"] != _numbers() or is_same_process(ProcessIdentity(*owner["process"]))
    except (OSError, ValueError, TypeError, KeyError):
        return identity_of(pid) is not None  # just being made, or what made it ended before it could say who it was


def _numbers() -> str:
    """Return what tells apart containers that number their processes by themselves."""
    try:
        return str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return ""
