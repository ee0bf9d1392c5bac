"""The live volume, handed from the process that renews it to the one that measures it: one copy, taken in turns."""

from __future__ import annotations

import mmap
import struct
import time
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from vialight.arrays import Float32Array, Grid
from vialight.live.analysis import grid_of

_HEAD = struct.Struct("<QQQdddQ")
"""Number given, number taken, frames, time, lit time, angle turned, unused."""
_GRID = struct.Struct("<QQQdd")
_BEGIN = 128
_POLL_S = 0.002

Region = tuple[slice, slice, slice]


class Given(NamedTuple):
    """A volume that was handed over; its density is overwritten once it is given back."""

    density: Float32Array
    frames: int
    time_s: float
    lit_s: float
    turned_rad: float
    """Since the first frame of the recording, whichever way."""


class SharedVolume:
    """A region of the live volume in memory that two processes map.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    grid : Grid
        Of the region.
    """

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), 0)
        *shape, voxel, centre = _GRID.unpack_from(self._map, _HEAD.size)
        self.grid = Grid((shape[0], shape[1], shape[2]), voxel, centre)
        self._density = np.frombuffer(self._map, np.float32, offset=_BEGIN).reshape(self.grid.shape)
        self._region: Region = (slice(None), slice(None), slice(None))

    @classmethod
    def make(cls, path: Path, grid: Grid, region: Region) -> Self:
        """Make the file, for a region of a grid."""
        part = grid_of(grid, region)
        fresh = path.with_suffix(".new")
        with fresh.open("wb") as file:
            file.write(_HEAD.pack(0, 0, 0, 0.0, 0.0, 0.0, 0) + _GRID.pack(*part.shape, part.voxel_mm, part.centre_z_mm))
            file.truncate(_BEGIN + 4 * int(np.prod(part.shape)))
        fresh.rename(path)
        made = cls(path)
        made._region = region
        return made

    def is_free(self) -> bool:
        """Whether the volume given last has been taken and measured."""
        given, taken, *_ = _HEAD.unpack_from(self._map)
        return bool(given == taken)

    def wait_until_free(self, timeout_s: float) -> bool:
        """Wait for that; False where it takes too long."""
        deadline = time.monotonic() + timeout_s
        while not self.is_free():
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL_S)
        return True

    def give(self, volume: Float32Array, frames: int, time_s: float, lit_s: float, turned_rad: float) -> None:
        """Copy the region of a (z, y, x) volume and hand it over."""
        given, taken, *_ = _HEAD.unpack_from(self._map)
        np.copyto(self._density, volume[self._region])
        _HEAD.pack_into(self._map, 0, given, taken, frames, time_s, lit_s, turned_rad, 0)
        struct.pack_into("<Q", self._map, 0, given + 1)

    def take(self, timeout_s: float) -> Given | None:
        """Wait for a volume; None where none comes in time."""
        deadline = time.monotonic() + timeout_s
        while self.is_free():
            if time.monotonic() > deadline:
                return None
            time.sleep(_POLL_S)
        return self.newest()

    def newest(self) -> Given:
        """Return the volume given last without taking it: it may be overwritten while it is looked at."""
        _, _, frames, time_s, lit_s, turned, _ = _HEAD.unpack_from(self._map)
        return Given(self._density, frames, time_s, lit_s, turned)

    def give_back(self) -> None:
        """Let the next volume be given."""
        given, *_ = _HEAD.unpack_from(self._map)
        struct.pack_into("<Q", self._map, 8, given)
