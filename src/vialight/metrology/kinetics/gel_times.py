"""When each voxel gelled for good, from volumes that come one after another."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import Float32Array


class GelTimes:
    """Follows a volume over time; noise that passes the threshold for less than a turn does not count.

    Parameters
    ----------
    shape
        (z, y, x).
    threshold
        I_p.
    lasting_s
        For which a voxel must stay above it, or until the end.

    Examples
    --------
    >>> seen = GelTimes((1, 1, 2), 1.0, 2.0)
    >>> for time_s, first, second in [(1, 2, 0), (2, 0, 0), (3, 0, 2), (4, 0, 2), (5, 0, 2), (6, 2, 0)]:
    ...     seen.note(np.array([[[first, second]]], np.float32), float(time_s))
    >>> seen.lasting()
    array([[[6., 3.]]], dtype=float32)
    """

    def __init__(self, shape: tuple[int, int, int], threshold: float, lasting_s: float) -> None:
        self._threshold, self._lasting_s = np.float32(threshold), lasting_s
        self._rose_s = np.full(shape, np.nan, np.float32)
        self._lasting: Float32Array = np.full(shape, np.nan, np.float32)

    def note(self, density: Float32Array, time_s: float) -> None:
        """Take the (z, y, x) density at a time."""
        above = density >= self._threshold
        np.copyto(self._rose_s, np.float32(np.nan), where=~above)
        np.copyto(self._rose_s, np.float32(time_s), where=above & np.isnan(self._rose_s))
        with np.errstate(invalid="ignore"):
            stayed = np.isnan(self._lasting) & (time_s - self._rose_s >= self._lasting_s)
        np.copyto(self._lasting, self._rose_s, where=stayed)

    def lasting(self) -> Float32Array:
        """Return (z, y, x) when each voxel rose for good; NaN where none did."""
        return np.where(np.isnan(self._lasting), self._rose_s, self._lasting)
