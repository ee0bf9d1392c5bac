"""A process apart in which files that anyone may have made are read under watch."""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from vialight.core.errors import InputError

LONGEST_S = 5.0
MOST_BYTES = 1_000_000_000
_GIVEN_UP_S = 60.0

_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(
    ["h5py", "hdf5plugin", "trimesh", "zarr", "vialight.store", "vialight.commands.kinetics", "vialight.core.mesh"]
)
"""Imported once, so that neither time nor memory of it is counted."""


def refused(read: Callable[..., Any], *arguments: object) -> str:
    """Call a function in a process apart and return its `InputError`, which came in one line, in time and in bounds.

    Parameters
    ----------
    read
        Of a module that a process can import.
    arguments
        Of the function.
    """
    ours, theirs = _FORKS.Pipe(duplex=False)
    process = _FORKS.Process(target=_watched, args=(theirs, read, arguments))
    process.start()
    theirs.close()
    try:
        assert ours.poll(_GIVEN_UP_S), "it never ended"
        told, took_s, took_bytes = ours.recv()
    finally:
        process.kill()
        process.join()
    assert told is not None, "it was read"
    assert "\n" not in told
    assert len(told) < 2000
    assert took_s < LONGEST_S
    assert took_bytes < MOST_BYTES
    return str(told)


def read_frames(path: Path) -> None:
    """Read all of a recording."""
    from vialight.store import open_frames

    with open_frames(path) as frames:
        frames.dark()
        frames.white()
        frames.read(slice(None))


def _watched(answer: Connection, read: Callable[..., Any], arguments: tuple[object, ...]) -> None:
    before, began, told = _peak_bytes(), time.monotonic(), None
    try:
        read(*arguments)
    except InputError as error:
        told = str(error)
    answer.send((told, time.monotonic() - began, _peak_bytes() - before))


def _peak_bytes() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
