"""Reading a recording while it grows."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import FloatArray
from vialight.store.frames import open_frames, open_hdf5


class NewFrames(NamedTuple):
    """Frames that have come since the last look."""

    first: int
    """Number of the first in the recording."""
    counts: NDArray[Any]
    """(frame, row, column)."""
    angles_rad: FloatArray
    time_s: FloatArray


class FrameTail:
    """A recording, read from its beginning to wherever its writer is.

    Parameters
    ----------
    path
        A recording that `FrameWriter` writes, or has written, with times.

    Attributes
    ----------
    image_shape : tuple of int
        (rows, columns).
    dark : numpy.ndarray or None
        (row, column) mean of the frames without the object.
    read : int
        Frames handed over.

    Raises
    ------
    InputError
        It cannot be read, or has no frame yet.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        with open_frames(path) as frames:
            self.image_shape: tuple[int, int] = frames.shape[1:]
            self.dark = frames.dark()
        self.read = 0
        self._file: Any = None
        self._open()

    def _open(self) -> None:
        """Open each dataset once: HDF5 loses its way when one is refreshed that is open twice."""
        self.close()
        self._file, self._is_live = open_hdf5(self._path)
        exchange = self._file["exchange"]
        self._data, self._theta, self._time = (exchange[name] for name in ("data", "theta", "time"))

    def new(self, limit: int = 64) -> NewFrames | None:
        """Return what has come since the last call, `limit` frames at most; None where nothing has."""
        if self._file is None:
            self._open()
        try:
            if self._is_live:
                # Frames first: the writer adds them last, so that what is counted has its angle and time.
                for dataset in (self._data, self._theta, self._time):
                    dataset.refresh()
            stop = min(len(self._data), len(self._theta), len(self._time), self.read + limit)
            if stop <= self.read:
                return None
            part = slice(self.read, stop)
            found = NewFrames(
                self.read, self._data[part], np.deg2rad(self._theta[part]), np.asarray(self._time[part], np.float64)
            )
        except (OSError, RuntimeError):
            # The writer was in the middle of something; the next look is with fresh eyes.
            self.close()
            return None
        self.read = stop
        return found

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
