"""Slices wherever a page wants them: of the live volume while it prints, of the reconstructed one afterwards."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import Grid
from vialight.core.errors import InputError
from vialight.printing.live.sharing import SharedVolume
from vialight.printing.live_link import LiveLink
from vialight.store import read_volume
from vialight.web.encoding import Levels, pack, to_levels
from vialight.web.runs import Mark, mark_of, own_folder

_FINAL = "volume.zarr"
_NOT_YET = "wait for the first turn of frames"


class _Held(NamedTuple):
    """A volume of which slices can be had."""

    density: NDArray[np.float32] | NDArray[np.uint8]
    """(z, y, x), or its levels."""
    range: tuple[float, float] | None
    """Of levels; None where there are values."""
    grid: Grid
    frames: int | None


class LiveSlices:
    """Slices of the volume that a running print shares; its method may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._shared: tuple[tuple[str, int], SharedVolume] | None = None

    def at(self, link: LiveLink, x: int, y: int, z: int) -> bytes:
        """Return three planes as a message of the kind ``slices``.

        Parameters
        ----------
        link
            To the print.
        x, y, z
            Where: thousandths of the volume's extent, from its lowest coordinate; more than 1000 is 1000.

        Raises
        ------
        InputError
            There is no volume yet.
        """
        path = Path(link.mailboxes) / "volume"
        try:
            number = path.stat().st_ino  # another file where the live measurement was started again
        except OSError as error:
            raise InputError("print", "has no volume yet", remedy=_NOT_YET) from error
        with self._lock:
            if self._shared is None or self._shared[0] != (str(path), number):
                self._shared = (str(path), number), SharedVolume(path)
            shared = self._shared[1]
        return _planes(_Held(shared.density, None, shared.grid, shared.moment().frames), x, y, z)


class FinalSlices:
    """Slices of the volume that was reconstructed from a run.

    Parameters
    ----------
    folder
        The run's.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._held: tuple[Mark, _Held] | None = None

    def at(self, x: int, y: int, z: int) -> bytes:
        """Return three planes, as `LiveSlices.at` does.

        Raises
        ------
        InputError
            There is no volume.
        """
        path = own_folder(self._folder, _FINAL)
        changed = None if path is None else mark_of(path / "zarr.json")
        if path is None or changed is None:
            raise InputError(self._folder.name, f"has no {_FINAL}", remedy="reconstruct it")
        if self._held is None or self._held[0] != changed:
            volume = read_volume(path)
            # A quarter of the memory, and what a screen can show.
            kept = to_levels(volume.density)
            self._held = changed, _Held(kept.levels, (kept.low, kept.high), volume.grid, None)
        return _planes(self._held[1], x, y, z)


def _planes(held: _Held, x: int, y: int, z: int) -> bytes:
    grid = held.grid
    axes = {"x": grid.x_mm, "y": grid.y_mm, "z": grid.z_mm}
    index = {
        name: round(min(share, 1000) * (len(axes[name]) - 1) / 1000) for name, share in (("x", x), ("y", y), ("z", z))
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


def _levels(
    planes: dict[str, NDArray[np.float32] | NDArray[np.uint8]], range_of_levels: tuple[float, float] | None
) -> dict[str, Levels]:
    """Return planes as images that share a range."""
    if range_of_levels is not None:
        return {name: Levels(plane.astype(np.uint8, copy=False), *range_of_levels) for name, plane in planes.items()}
    low = min(float(plane.min()) for plane in planes.values())
    high = max(float(plane.max()) for plane in planes.values())
    return {name: to_levels(plane, low, high) for name, plane in planes.items()}
