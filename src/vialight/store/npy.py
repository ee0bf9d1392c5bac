"""NumPy's own files, alone and in archives: what they state is held against what is there before anything is read."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from vialight.system import need_memory, open_archive, open_plain

_SUFFIX = ".npy"
_KINDS = "biufcSU"
_REMEDY = "read it on a machine with more memory, or make it smaller"


def read_npy(path: str | Path, most_bytes: int = 1 << 40) -> NDArray[Any]:
    """Read an array of numbers.

    Raises
    ------
    InputError
        It is no plain file, states more than it holds, or does not fit into memory.
    OSError, ValueError
        It cannot be read, or is no such file.
    """
    with open_plain(path, most_bytes) as file:
        size = file.seek(0, 2)
        file.seek(0)
        return _array(file, size, path)


class Archive(Mapping[str, NDArray[Any]]):
    """The arrays of an ``.npz``, each read when it is asked for; made by `opened_npz`."""

    def __init__(self, held: zipfile.ZipFile, where: object) -> None:
        self._held, self._where = held, where
        self._entries = {entry.filename.removesuffix(_SUFFIX): entry for entry in held.infolist()}

    def __getitem__(self, name: str) -> NDArray[Any]:
        entry = self._entries[name]
        with self._held.open(entry) as member:
            return _array(cast("BinaryIO", member), entry.file_size, f"{self._where} {name}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array without reading it."""
        with self._held.open(self._entries[name]) as member:
            return _header(cast("BinaryIO", member))[0]


@contextmanager
def opened_npz(path: str | Path, *, most_bytes: int) -> Iterator[Archive]:
    """Open an archive of arrays of numbers.

    Parameters
    ----------
    path
        An ``.npz``.
    most_bytes
        Of its arrays all together.

    Raises
    ------
    InputError
        It is no plain file, or would unpack to more.
    OSError, ValueError, zipfile.BadZipFile
        It cannot be read, or is no such file.
    """
    with open_plain(path, most_bytes) as file, open_archive(file, path, most_bytes=most_bytes) as held:
        yield Archive(held, path)


def _array(file: BinaryIO, size: int, where: object) -> NDArray[Any]:
    """Read an array of which its file, or its place in an archive, has so many bytes."""
    shape, dtype, header_bytes = _header(file)
    stated = math.prod(shape) * dtype.itemsize
    if dtype.kind not in _KINDS or any(edge < 0 for edge in shape) or (math.prod(shape) > 0 and not dtype.itemsize):
        raise ValueError(f"it holds {dtype} of shape {shape}")
    if stated > size - header_bytes:
        raise ValueError(f"it states {dtype} of shape {shape}, and has {size - header_bytes} bytes")
    need_memory(2 * stated, where, f"an array of shape {shape}", _REMEDY)
    file.seek(0)
    return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _header(file: BinaryIO) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    version = np.lib.format.read_magic(file)
    if version != (1, 0):  # later formats are for headers of more than 64 kB, which may unpack to gigabytes
        raise ValueError(f"it is of NumPy's format {version}")
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    return tuple(shape), dtype, file.tell()
