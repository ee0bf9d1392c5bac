"""The live volume, in memory that the process which renews it shares with those that look at it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from vialight.core.arrays import Float32Array, Grid
from vialight.core.compiling import padded_depth
from vialight.printing.live.analysis import grid_of
from vialight.system import make_shared_file, map_shared_file, wait_for, words_of

_TOLD, _LOOKED_AT, _FRAMES, _TIMES, _HEAD_WORDS = 0, 1, 2, 3, 6
"""Number told, number looked at, frames; then as real numbers time, lit time, angle turned."""
_GRID = struct.Struct("<QQQdd6Q")
"""Shape, voxel, centre; where the region begins and ends."""
_BEGIN = 4096
_POLL_S = 0.002

Region = tuple[slice, slice, slice]


class LiveMoment(NamedTuple):
    """What is known of the volume at the time that it was told of."""

    frames: int
    time_s: float
    lit_s: float
    turned_rad: float
    """Since the first frame of the recording, whichever way."""


class SharedVolume:
    """A volume in memory that several processes map: one changes it, others look.

    Nobody waits and nothing is copied for them: who looks may see a frame more in some voxels than in others, which is
    less than what a frame changes.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    whole : Float32Array
        (y, x, z) all of it, as deep as `vialight.core.compiling.padded_depth` says: what a window keeps its volume in.
    grid : Grid
        Of the region that is looked at.
    density : Float32Array
        (z, y, x) the region.
    """

    def __init__(self, path: Path) -> None:
        self._map = map_shared_file(path, _BEGIN)
        self._head = words_of(self._map)[:_HEAD_WORDS]
        z, y, x, voxel, centre, *bounds = _GRID.unpack_from(self._map, 8 * _HEAD_WORDS)
        shape = (y, x, padded_depth(z))
        values = np.frombuffer(self._map, np.float32, offset=_BEGIN, count=int(np.prod(shape)))
        self.whole: Float32Array = values.reshape(shape)
        region = slice(*bounds[0:2]), slice(*bounds[2:4]), slice(*bounds[4:6])
        self.grid: Grid = grid_of(Grid((z, y, x), voxel, centre), region)
        self.density: Float32Array = self.whole.transpose(2, 0, 1)[region]

    @classmethod
    def make(cls, path: Path, grid: Grid, region: Region) -> Self:
        """Make the file, for a grid of which a region is to be looked at."""
        z, y, x = grid.shape
        bounds = [bound for part in region for bound in (part.start, part.stop)]
        fresh = path.with_name(f"{path.name}-made")
        make_shared_file(fresh, _BEGIN + 4 * y * x * padded_depth(z))
        with map_shared_file(fresh) as made:
            _GRID.pack_into(made, 8 * _HEAD_WORDS, z, y, x, grid.voxel_mm, grid.centre_z_mm, *bounds)
        fresh.replace(path)
        return cls(path)

    def is_free(self) -> bool:
        """Whether the moment told last has been looked at."""
        return bool(self._head[_TOLD] == self._head[_LOOKED_AT])

    def wait_until_free(self, timeout_s: float) -> bool:
        """Wait for that; False where it takes too long."""
        return wait_for(self.is_free, timeout_s=timeout_s, every_s=_POLL_S) is None

    def tell(self, moment: LiveMoment) -> None:
        """Say of when the volume is, and that it is to be looked at."""
        self._head[_FRAMES] = moment.frames
        self._head.view(np.float64)[_TIMES:] = moment[1:]
        self._head[_TOLD] += np.uint64(1)

    def wait_for_moment(self, timeout_s: float) -> LiveMoment | None:
        """Wait until the volume is to be looked at; None where that does not come in time."""
        told = wait_for(lambda: not self.is_free(), timeout_s=timeout_s, every_s=_POLL_S)
        return self.moment() if told is None else None

    def moment(self) -> LiveMoment:
        """Return of when the volume was said to be last."""
        return LiveMoment(int(self._head[_FRAMES]), *self._head.view(np.float64)[_TIMES:].tolist())

    def done(self) -> None:
        """Have looked at it, so that the next moment can be told."""
        self._head[_LOOKED_AT] = self._head[_TOLD]
