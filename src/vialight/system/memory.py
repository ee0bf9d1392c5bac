"""How much memory is free, asked before it is taken."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psutil

from vialight.core.errors import InputError

_LEFT_BYTES = 200_000_000
"""That stay for everything else."""
SMALL_BYTES = 50_000_000
"""For which it is not worth asking."""
_GROUPS, _OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
"""Where Linux tells what its groups of processes may take, which is how containers are limited, and which hold us."""
_FILES = {
    "": ("", "memory.max", "memory.current", {"active_file", "inactive_file"}),
    "memory": (
        "memory", "memory.limit_in_bytes", "memory.usage_in_bytes", {"total_active_file", "total_inactive_file"}
    ),
}  # fmt: skip
"""Of the newer and the older kind of groups, by the name of what they control: the folder, the files that hold limit
and usage, and lines of ``memory.stat``: files kept in memory for as long as nobody else needs it."""


def need_memory(needed_bytes: float, where: object, what: str, remedy: str) -> None:
    """Refuse to take more memory than there is.

    Parameters
    ----------
    needed_bytes
        What is about to be taken.
    where, what, remedy
        Of the error: what asks for it, what it is for, what to do.

    Raises
    ------
    InputError
        There is not so much.

    Examples
    --------
    >>> need_memory(1000, "frames.h5", "a block of frames", "read fewer")
    >>> need_memory(1e18, "frames.h5", "a block of frames", "read fewer")
    Traceback (most recent call last):
        ...
    vialight.core.errors.InputError: ...
    """
    if needed_bytes <= SMALL_BYTES:
        return
    free_bytes = min([psutil.virtual_memory().available, *_left_in_groups()])
    if needed_bytes > free_bytes - _LEFT_BYTES:
        raise InputError(
            where,
            f"{what} needs {needed_bytes / 1e9:.3g} GB of memory, and {free_bytes / 1e9:.3g} GB are free",
            accepted="what fits into memory",
            remedy=remedy,
        )


def _left_in_groups() -> Iterator[int]:
    """Yield what each group that holds this process has left, where it has a limit."""
    try:
        lines = _OWN_GROUPS.read_text().splitlines()
    except (OSError, ValueError):  # no Linux
        return
    for line in lines:
        _, _, kind_and_name = line.partition(":")
        kind, _, name = kind_and_name.partition(":")
        if kind not in _FILES:
            continue
        inner, limit, usage, kept = _FILES[kind]
        top = _GROUPS / inner
        group = top / name.strip("/")
        for folder in (group, *group.parents):
            if not folder.is_relative_to(top):
                break
            try:
                yield _number(folder / limit) - _number(folder / usage) + _kept_bytes(folder, kept)
            except (OSError, ValueError):  # no limit, or a folder that is not seen from inside a container
                continue


def _number(path: Path) -> int:
    return int(path.read_text())


def _kept_bytes(folder: Path, names: set[str]) -> int:
    try:
        pairs = [line.split() for line in (folder / "memory.stat").read_text().splitlines()]
    except OSError:
        return 0
    return sum(int(number) for name, number in pairs if name in names)
