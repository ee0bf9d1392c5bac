"""Volumes over time as one OME-Zarr 0.5 image (t, z, y, x) that grows, and can be read while it does.

A volume is one file, which is put in its place whole; only then does the image say that it is one longer.  So whoever
reads, whenever, and after whatever end, finds complete volumes.  The format knows even steps of time only: its scale is
the mean step, and the exact times stand beside it, under the key `vialight`.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray, Grid, Volume
from vialight.core.errors import InputError
from vialight.store.folders import disk_full, is_disk_full, unwritable
from vialight.store.results import read_json
from vialight.store.volumes import create_array, damage_told, described, grid_of_image, not_written
from vialight.store.zarrs import read_stored, stored_image

SERIES = "volumes.zarr"
_WANTED = "volumes over time written by vialight: OME-Zarr 0.5, axes t z y x"


class VolumeSeriesWriter:
    """Volumes that are added one after another; an image of the same grid that is there already is gone on with.

    Parameters
    ----------
    path
        The zarr folder.
    grid
        Of each volume.
    attributes
        As for `vialight.store.VolumeWriter`.

    Attributes
    ----------
    moments : dict of list
        What is known of each volume, such as its ``time_s``.

    Raises
    ------
    InputError
        The path cannot be written, or holds something else.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "volumes.zarr"
    >>> series = VolumeSeriesWriter(path, Grid((2, 3, 3), 0.1))
    >>> for turn in (1, 2, 3):
    ...     series.append(np.full((2, 3, 3), turn, np.float32), time_s=18.0 * turn)
    >>> read_series(path).time_s, float(read_series(path).volume(2).density.max())
    (array([18., 36., 54.]), 3.0)
    """

    def __init__(self, path: str | Path, grid: Grid, attributes: Mapping[str, Any] | None = None) -> None:
        import zarr

        self.path, self.grid = Path(path), grid
        self._attributes = dict(attributes or {})
        self.moments: dict[str, list[float]] = {}
        held = _begun(self.path)
        if held is not None:
            if held.grid != grid:
                raise InputError(path, "holds volumes of another grid", accepted=f"{grid}", remedy="move it away")
            self.moments = {name: values.tolist() for name, values in held.moments.items()}
            self._array: Any = zarr.open_group(self.path, mode="r+")["0"]
        else:
            try:
                self._array = create_array(zarr.create_group(self.path, zarr_format=3), grid, grid.shape[0], 0)
            except OSError as error:
                raise not_written(self.path, error) from error

    def append(self, density: Float32Array, *, time_s: float, **others: float) -> None:
        """Add a volume: (z, y, x) counts per mm, seen at a time; `others` are stored beside it.

        Raises
        ------
        InputError
            It does not fit, or cannot be written; those before it are safe.
        """
        if density.shape != self.grid.shape:
            raise InputError("volume", f"has the shape {density.shape}", accepted=f"{self.grid.shape}")
        count = len(self.moments.get("time_s", []))
        moment = {"time_s": time_s, **others}
        try:
            self._place(density, count)
            self._array.resize((count + 1, *self.grid.shape))
            self.moments = {name: [*self.moments.get(name, []), value] for name, value in moment.items()}
            self._describe()
        except OSError as error:
            told = disk_full(self.path, f"{count} volumes are safe") if is_disk_full(error) else None
            raise told or unwritable(self.path, error) from error

    def _place(self, density: Float32Array, number: int) -> None:
        """Write a volume's file elsewhere, and move it to its place."""
        import zarr

        aside = self.path.with_name(f".{self.path.name}.next")
        shutil.rmtree(aside, ignore_errors=True)
        try:
            single = create_array(zarr.create_group(aside, zarr_format=3), self.grid, self.grid.shape[0], 1)
            single[0] = density
            place = self.path / "0" / self._array.metadata.encode_chunk_key((number, 0, 0, 0))
            place.parent.mkdir(parents=True, exist_ok=True)
            (aside / "0" / self._array.metadata.encode_chunk_key((0, 0, 0, 0))).replace(place)
        finally:
            shutil.rmtree(aside, ignore_errors=True)

    def _describe(self) -> None:
        import zarr

        times = self.moments["time_s"]
        step = (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 1.0
        over_time = (times[0], step if step > 0 else 1.0)
        attributes = described(self.path.stem, self.grid, self._attributes | {"moments": self.moments}, over_time)
        zarr.open_group(self.path, mode="r+").attrs.update(attributes)


def _begun(path: Path) -> VolumeSeries | None:
    """Return the series that a path holds; clear away one that was ended before its first volume."""
    if not path.exists():
        return None
    if not (path / "zarr.json").is_file():
        raise InputError(path, "exists and is not a zarr", accepted="a new name", remedy="choose another")
    if "ome" in read_json(path / "zarr.json").get("attributes", {}):
        return read_series(path)
    shutil.rmtree(path)
    return None


@dataclass(frozen=True)
class VolumeSeries:
    """Volumes over time, of which none is read before it is asked for.

    Parameters
    ----------
    path
        The zarr folder.
    grid
        Of each volume.
    moments
        (volume,) what is known of each.
    """

    path: Path
    grid: Grid
    moments: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def time_s(self) -> FloatArray:
        """(volume,) when each was seen."""
        return self.moments.get("time_s", np.empty(0))

    def volume(self, number: int) -> Volume:
        """Read one.

        Raises
        ------
        InputError
            There is no such volume, or it is damaged.
        """
        if not 0 <= number < len(self):
            raise InputError(self.path, f"has no volume {number}", accepted=f"0 to {len(self) - 1}")
        with damage_told(self.path):
            image = stored_image(self.path, 4)
            if number >= image.shape[0] or image.shape[1:] != self.grid.shape:
                raise InputError(self.path, f"volume {number} is missing", remedy="copy it again")
            return Volume(read_stored(image, number), self.grid)


def read_series(path: str | Path) -> VolumeSeries:
    """Read what volumes there are, also while more are being written.

    Raises
    ------
    InputError
        It is missing, is something else, or is damaged.
    """
    path = Path(path)
    if not (path / "zarr.json").is_file():
        raise InputError(path, "there is no such zarr", accepted=_WANTED, remedy="check the path")
    with damage_told(path):
        image = stored_image(path, 4)
        if "ome" not in image.attributes:  # not one volume yet
            raise InputError(path, "holds no volume yet", remedy="wait for the first turn")
        grid = grid_of_image(path, image.attributes, image.shape, over_time=True)
        own: Any = image.attributes["vialight"]
        moments = {name: np.array(values, dtype=np.float64) for name, values in own["moments"].items()}
        count = len(moments["time_s"])
        if any(values.shape != (count,) for values in moments.values()):
            raise InputError(path, "does not say the same of each volume", accepted=_WANTED)
        return VolumeSeries(path, grid, moments)
