"""Slices wherever a page wants them: of the live volume while it prints, of the reconstructed one afterwards."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vialight.arrays import Grid
from vialight.errors import InputError
from vialight.links import find_live_print
from vialight.live import SharedVolume
from vialight.store import read_volume
from vialight.web.encoding import Levels, pack, to_levels

_FINAL = "volume.zarr"


class _Held(NamedTuple):
    """A volume of which slices can be had."""

    density: NDArray[np.float32] | NDArray[np.uint8]
    """(z, y, x), or its levels."""
    range: tuple[float, float] | None
    """Of levels; None where there are values."""
    grid: Grid
    frames: int | None


class Slices:
    """Slices of a run's volume; every method may be called from any thread.

    Parameters
    ----------
    folder
        The run's.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._live: tuple[int, SharedVolume] | None = None
        self._final: tuple[int, _Held] | None = None

    def at(self, x: int, y: int, z: int) -> bytes:
        """Return three planes as a message of the kind ``slices``.

        Parameters
        ----------
        x, y, z
            Where: thousandths of the volume's extent, from its lowest coordinate; more than 1000 is 1000.

        Raises
        ------
        InputError
            There is no volume yet.
        """
        held = self._held()
        grid = held.grid
        axes = {"x": grid.x_mm, "y": grid.y_mm, "z": grid.z_mm}
        index = {
            name: round(min(share, 1000) * (len(axes[name]) - 1) / 1000)
            for name, share in (("x", x), ("y", y), ("z", z))
        }
        planes = {
            "slice_xy": held.density[index["z"]],
            "slice_xz": held.density[:, index["y"]],
            "slice_yz": held.density[:, :, index["x"]],
        }
        header = {
            "kind": "slices", "frames": held.frames, "voxel_mm": grid.voxel_mm,
            "at_mm": {name: float(axes[name][place]) for name, place in index.items()},
        }  # fmt: skip
        return pack(header, _levels(planes, held.range))

    def _held(self) -> _Held:
        with self._lock:
            live = self._live_volume()
            if live is not None:
                return live
            return self._final_volume()

    def _live_volume(self) -> _Held | None:
        link = find_live_print(self._folder)
        if link is None:
            self._live = None
            return None
        path = Path(link.mailboxes) / "volume"
        try:
            number = path.stat().st_ino  # another file where the live measurement was started again
        except OSError as error:
            name, remedy = self._folder.name, "wait for the first turn of frames"
            raise InputError(name, "has no volume yet", remedy=remedy) from error
        if self._live is None or self._live[0] != number:
            self._live = number, SharedVolume(path)
        shared = self._live[1]
        return _Held(shared.density, None, shared.grid, shared.moment().frames)

    def _final_volume(self) -> _Held:
        path = self._folder / _FINAL
        try:
            changed = (path / "zarr.json").stat().st_mtime_ns
        except OSError as error:
            raise InputError(self._folder.name, f"has no {_FINAL}", remedy="reconstruct it") from error
        if self._final is None or self._final[0] != changed:
            volume = read_volume(path)
            # A quarter of the memory, and what a screen can show.
            kept = to_levels(volume.density)
            self._final = changed, _Held(kept.levels, (kept.low, kept.high), volume.grid, None)
        return self._final[1]


def _levels(
    planes: dict[str, NDArray[np.float32] | NDArray[np.uint8]], range_of_levels: tuple[float, float] | None
) -> dict[str, Levels]:
    """Return planes as images that share a range."""
    if range_of_levels is not None:
        return {name: Levels(plane.astype(np.uint8, copy=False), *range_of_levels) for name, plane in planes.items()}
    low = min(float(plane.min()) for plane in planes.values())
    high = max(float(plane.max()) for plane in planes.values())
    return {name: to_levels(plane, low, high) for name, plane in planes.items()}
