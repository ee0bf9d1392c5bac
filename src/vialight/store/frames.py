"""Reading camera frames from HDF5 in the Data Exchange layout.

h5py is imported when a file is opened, hdf5plugin when one needs it, so that importing this module costs nothing.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import BoolArray, FloatArray, IntArray
from vialight.core.errors import InputError
from vialight.store.durable import is_from_before_a_start, open_torn
from vialight.store.hdf5 import attribute, dataset_in, dataset_names, object_in
from vialight.store.results import parse_json
from vialight.system import check_plain, need_memory

_ANGLE_UNITS = {"deg": np.pi / 180, "degree": np.pi / 180, "degrees": np.pi / 180, "°": np.pi / 180}
_ANGLE_UNITS |= {"rad": 1.0, "radian": 1.0, "radians": 1.0}
_TIME_UNITS = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6}
_MOST_FRAMES, _MOST_PIXELS = 10_000_000, 200_000_000
"""More than a day at a hundred frames a second; more than the largest sensor has."""
_MOST_STILLS = 10_000
_STILL_BYTES = 64_000_000
"""Of dark or white frames that are read at once."""
_MOST_ANGLE_RAD, _LONGEST_S = 1e7, 1e10
"""Two years of turning; a clock may count from 1970."""


def open_frames(path: str | Path) -> FrameFile:
    """Open and check a recording; nothing but angles and times is read yet.

    `implements` is not asked: what counts is that `/exchange/data` and `/exchange/theta` are there and fit.

    Parameters
    ----------
    path
        An HDF5 file in the Data Exchange layout; it may still be written to, in SWMR mode.

    Returns
    -------
    FrameFile
        To be used in a `with` statement, or closed.

    Raises
    ------
    InputError
        The file is missing, is not HDF5, is cut off, or its datasets are missing or do not fit each other.

    Examples
    --------
    >>> import tempfile
    >>> from vialight.store.recording import write_frames
    >>> path = Path(tempfile.mkdtemp()) / "frames.h5"
    >>> write_frames(path, np.ones((4, 2, 3), np.uint16), np.radians([0, 90, 180, 270]))
    >>> with open_frames(path) as frames:
    ...     frames.shape, frames.read(slice(1, 3), slice(0, 1)).shape
    ((4, 2, 3), (2, 1, 3))
    """
    path = Path(path)
    file, is_live = open_hdf5(path)
    try:
        return FrameFile(path, file, is_live=is_live)
    except BaseException as error:
        file.close()
        if isinstance(error, OSError | RuntimeError | KeyError | TypeError | ValueError | MemoryError):
            raise _damaged(path, error) from error
        raise


class FrameFile:
    """An open recording; made by `open_frames`.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    shape : tuple of int
        Counts of (frames, rows, columns), as they were when the file was opened.
    dtype : numpy.dtype
        Of the counts, in the machine's byte order.
    angles_rad : numpy.ndarray
        (frame,) float64: the stage angle of every frame, as stored: in any order, of any turn.
    time_s : numpy.ndarray or None
        (frame,) float64, where recorded.
    is_transmission : bool
        Whether there are white frames, so that the logarithm of the ratio to them is what adds up along a ray.
    settings : dict
        What the recording says of how it was taken, such as ``exposure_s`` and ``binning``; empty where nothing.
    is_live : bool
        Whether a writer had the file open.
    """

    def __init__(self, path: Path, file: Any, *, is_live: bool = False) -> None:
        self.path = path
        self.is_live = is_live
        self._file = file
        data = _dataset(path, file, "exchange/data")
        _check_image_data(path, data)
        self._data = data
        self.shape: tuple[int, int, int] = data.shape
        self.dtype: np.dtype[Any] = data.dtype.newbyteorder("=")
        self.angles_rad = self._one_a_frame("theta", "angles", _ANGLE_UNITS, "degrees")
        _check_range(f"{path} /exchange/theta", "angle", self.angles_rad, _MOST_ANGLE_RAD)
        self.time_s = None
        if dataset_in(path, file, "exchange/time", may_be_virtual=True) is not None:
            self.time_s = self._one_a_frame("time", "times", _TIME_UNITS, "seconds")
            _check_range(f"{path} /exchange/time", "time", self.time_s, _LONGEST_S)
        self._dark = self._still("data_dark")
        self._white = self._still("data_white")
        self.is_transmission = self._white is not None
        self.settings = _settings(path, file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; closing twice does no harm."""
        self._file.close()

    def read(self, frames: slice | IntArray | BoolArray, rows: slice = slice(None)) -> NDArray[Any]:
        """Read a block of frames; nothing else comes into memory.

        Parameters
        ----------
        frames
            Which frames: anything that indexes a NumPy array of one axis; each run of consecutive ones is read at
            once, so that ascending indices are fastest.
        rows
            Which rows.

        Returns
        -------
        numpy.ndarray
            (frame, row, column), of the type of the file.

        Raises
        ------
        InputError
            The file is damaged here, needs a filter that is not installed, or holds counts that are not finite.
        """
        indices = np.arange(self.shape[0])[frames]
        rows_read = len(range(self.shape[1])[rows])
        needed_bytes = len(indices) * rows_read * self.shape[2] * self.dtype.itemsize
        need_memory(needed_bytes, self.path, f"a block of {len(indices)} frames", "take fewer turns, or bin the frames")
        out = np.empty((len(indices), rows_read, self.shape[2]), self.dtype)
        done = 0
        # h5py reads an index list row by row, many times slower than a range.
        for run in np.split(indices, np.flatnonzero(np.diff(indices) != 1) + 1):
            if out.size:
                with _explained(self.path, self._data):
                    self._data.read_direct(out, np.s_[run[0] : run[-1] + 1, rows], np.s_[done : done + run.size])
            done += run.size
        if self.dtype.kind == "f" and not np.isfinite(out).all():
            bad = int(indices[np.argmin(np.isfinite(out).all(axis=(1, 2)))])
            raise InputError(
                f"{self.path} /exchange/data", f"frame {bad} holds values that are not finite",
                accepted="finite counts", remedy="leave the frame out or mend its pixels",
            )  # fmt: skip
        return out

    def dark(self, rows: slice = slice(None)) -> FloatArray | None:
        """Return the mean frame without the object (row, column) in float64, or None where none was recorded."""
        return self._mean(self._dark, rows)

    def white(self, rows: slice = slice(None)) -> FloatArray | None:
        """Return the mean frame of the open beam (row, column) in float64, or None where none was recorded."""
        return self._mean(self._white, rows)

    def _mean(self, stills: Any, rows: slice) -> FloatArray | None:
        if stills is None:
            return None
        total: FloatArray = np.zeros(self.shape[1:], dtype=np.float64)[rows]
        at_once = max(1, _STILL_BYTES // (total.size * stills.dtype.itemsize + 1))
        for first in range(0, len(stills), at_once):
            with _explained(self.path, stills):
                for still in stills[first : first + at_once, rows]:
                    total += still
        if not np.isfinite(total).all():
            raise InputError(f"{self.path} {stills.name}", "holds values that are not finite", accepted="finite counts")
        return total / len(stills)

    def _one_a_frame(self, name: str, what: str, units: dict[str, float], usual: str) -> FloatArray:
        count = self.shape[0]
        dataset = _dataset(self.path, self._file, f"exchange/{name}")
        where = f"{self.path} /exchange/{name}"
        if dataset.dtype.kind not in "iuf" or dataset.size != max(dataset.shape, default=0):
            raise InputError(where, f"is {dataset.dtype} of shape {dataset.shape}", accepted=f"({count},) numbers")
        # A live writer adds an angle before its frame, and more while we look.
        if dataset.size != count and not (self.is_live and dataset.ndim == 1 and dataset.size > count):
            raise InputError(
                where, f"{dataset.size} {what} for {count} frames", accepted="one for each frame",
                remedy="check that the recording is complete",
            )  # fmt: skip
        with _explained(self.path, dataset):
            stored = dataset[:count] if dataset.ndim == 1 else dataset[...]
            values: FloatArray = np.asarray(stored, dtype=np.float64).reshape(-1)
        unit = _unit(self.path, dataset) or usual
        if unit not in units:
            raise InputError(where, f"the unit is {unit[:40]!r}", accepted=", ".join(units), remedy="convert the file")
        return values * units[unit]

    def _still(self, name: str) -> Any:
        """Return the dataset of dark or white frames, checked; None if there is none, or it is empty."""
        dataset = dataset_in(self.path, self._file, f"exchange/{name}", may_be_virtual=True)
        if dataset is None or dataset.shape[:1] == (0,):
            return None
        if dataset.ndim != 3 or dataset.shape[1:] != self.shape[1:] or dataset.dtype.kind not in "iuf":
            raise InputError(
                f"{self.path} /exchange/{name}", f"is {dataset.dtype} of shape {dataset.shape}",
                accepted=f"numbers of shape (n, {self.shape[1]}, {self.shape[2]}), as the frames",
                remedy="record it with the camera's settings of the frames",
            )  # fmt: skip
        if len(dataset) > _MOST_STILLS:
            raise InputError(
                f"{self.path} /exchange/{name}",
                f"has {len(dataset)} frames",
                accepted=f"{_MOST_STILLS} at most",
                remedy="keep their mean",
            )
        return _with_filters(dataset)


def open_hdf5(path: Path) -> tuple[Any, bool]:
    """Open a file for reading, and say whether it is (or was, by a writer that was killed) open for writing."""
    import h5py

    wanted = "an HDF5 file in the Data Exchange layout"
    try:
        check_plain(path)
        if is_from_before_a_start(path):
            with suppress(OSError):
                return open_torn(path), True
        try:
            return h5py.File(path, "r"), False
        except OSError as error:
            if "already open for write" not in str(error) and "unable to lock" not in str(error):
                raise
            # Also what a writer leaves that was killed: all that it flushed can be read this way.
            return h5py.File(path, "r", swmr=True), True
    except FileNotFoundError as error:
        raise InputError(path, "there is no such file", accepted=wanted, remedy="check the path") from error
    except IsADirectoryError as error:
        raise InputError(path, "is a folder", accepted=wanted, remedy="name the file in it") from error
    except OSError as error:
        with suppress(OSError):
            return open_torn(path), True
        text = str(error)
        if "truncated" in text:
            raise _damaged(path, error) from error
        if "signature not found" in text:
            raise InputError(path, "is not HDF5", accepted=wanted, remedy="check the path") from error
        if "already open for write" in text or "unable to lock" in text or "SWMR" in text:
            raise InputError(
                path, "is being written by a program that does not share it",
                accepted="a finished file, or one written in SWMR mode", remedy="wait until it is closed",
            ) from error  # fmt: skip
        reason = os.strerror(error.errno) if error.errno else text
        raise InputError(path, f"cannot be opened ({reason})", accepted=wanted, remedy="check the file") from error


def _dataset(path: Path, file: Any, name: str) -> Any:
    found = dataset_in(path, file, name, may_be_virtual=True)
    if found is not None:
        return _with_filters(found)
    names = dataset_names(file)
    held = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    raise InputError(
        path, f"there is no dataset /{name}; the file holds {held or 'no dataset'}",
        accepted="the Data Exchange layout: /exchange/data (frame, row, column), /exchange/theta",
        remedy="convert the file",
    )  # fmt: skip


def _settings(path: Path, file: Any) -> dict[str, Any]:
    process = object_in(path, file, "process")
    text = None if process is None else attribute(path, process, "settings")
    if text is None:
        return {}
    if not isinstance(text, str | bytes):
        raise InputError(f"{path} /process", f"settings is {type(text).__name__}", accepted="a JSON object")
    return parse_json(text, f"{path} /process settings")


def _check_range(where: str, what: str, values: FloatArray, most: float) -> None:
    """Refuse values that are not known, or are none that a print has."""
    fits = np.abs(values) <= most  # NaN is not
    if not fits.all():
        index = int(np.argmin(fits))
        raise InputError(
            where,
            f"{what} {index} is {values[index]}",
            accepted=f"finite {what}s, up to {most:.3g} in rad or s",
            remedy=f"leave out frames whose {what} is not known",
        )


def _check_image_data(path: Path, data: Any) -> None:
    where = f"{path} /exchange/data"
    if data.ndim != 3:
        raise InputError(where, f"has the shape {data.shape}", accepted="three axes (frame, row, column)")
    if 0 in data.shape:
        raise InputError(where, f"is empty, of shape {data.shape}", accepted="at least one frame")
    if data.dtype.kind not in "iuf":
        raise InputError(where, f"holds {data.dtype}", accepted="integers or real numbers")
    if len(data) > _MOST_FRAMES or math.prod(data.shape[1:]) > _MOST_PIXELS:
        raise InputError(
            where,
            f"has the shape {data.shape}",
            accepted=f"{_MOST_FRAMES:.0e} frames of {_MOST_PIXELS:.0e} pixels at most",
        )


def _unit(path: Path, dataset: Any) -> str:
    found = (attribute(path, dataset, name) for name in ("units", "unit"))
    value = np.asarray(next((one for one in found if one is not None), "")).reshape(-1)
    unit = value[0] if value.size else ""
    return (unit.decode(errors="replace") if isinstance(unit, bytes) else str(unit)).strip().lower()


def _missing_filters(dataset: Any) -> list[str]:
    """Name the filters of a dataset that the HDF5 library does not have."""
    import h5py

    plist = dataset.id.get_create_plist()
    filters = [plist.get_filter(index) for index in range(plist.get_nfilters())]
    return [f"{code} ({name.decode()})" for code, _, _, name in filters if not h5py.h5z.filter_avail(code)]


def _with_filters(dataset: Any) -> Any:
    if _missing_filters(dataset):
        import hdf5plugin  # noqa: F401  importing it registers its filters
    return dataset


@contextmanager
def _explained(path: Path, dataset: Any) -> Iterator[None]:
    """Say why a dataset cannot be read."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        missing = _missing_filters(dataset)
        if not missing:
            raise _damaged(path, error, dataset.name) from error
        raise InputError(
            f"{path} {dataset.name}", f"is compressed with HDF5 filter {', '.join(missing)}, which is not installed",
            accepted="the filters of HDF5 and hdf5plugin", remedy="install the filter, or rewrite with h5repack",
        ) from error  # fmt: skip


def _damaged(path: Path, error: Exception, where: str = "") -> InputError:
    return InputError(
        f"{path} {where}".strip(), f"is damaged or cut off ({error})", accepted="a complete file",
        remedy="copy it again, or record again",
    )  # fmt: skip
