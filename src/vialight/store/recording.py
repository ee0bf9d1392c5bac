"""Writing camera frames to HDF5 in the Data Exchange layout, while others read.

h5py and hdf5plugin are imported when a file is created.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from vialight.errors import InputError
from vialight.store.folders import disk_full, is_disk_full, staged_file, unwritable

_RESERVE_BYTES = 1 << 20
"""Room kept free for the file's own tables: HDF5 that meets a full disk can bring the process down."""


class FrameWriter:
    """A recording that grows frame by frame and can be read at the same time (SWMR).

    Parameters
    ----------
    path
        The file to make; an existing one is refused.
    image_shape
        (rows, columns).
    dtype
        Unsigned integers.
    dark
        Frames without the object, (row, column) or (frame, row, column).
    settings
        Written to the attribute `settings` of `/process`, as JSON.
    with_time
        Whether frames carry a time.

    Attributes
    ----------
    count : int
        Frames that are safely in the file.

    Raises
    ------
    InputError
        The file exists, cannot be written, or what it is to hold does not fit.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "frames.h5"
    >>> with FrameWriter(path, (2, 3), settings={"exposure_s": 0.02}) as writer:
    ...     writer.append(np.zeros((2, 3), np.uint16), angle_rad=0.0, time_s=0.0)
    ...     writer.count
    1
    """

    def __init__(
        self, path: str | Path, image_shape: tuple[int, int], *, dtype: DTypeLike = np.uint16,
        dark: ArrayLike | None = None, settings: Mapping[str, object] | None = None, with_time: bool = True,
    ) -> None:  # fmt: skip
        import h5py
        import hdf5plugin

        self.path = Path(path)
        self.count = 0
        self._image_shape = tuple(image_shape)
        self._dtype = np.dtype(dtype)
        if self._dtype.kind != "u":
            raise InputError("dtype", f"is {self._dtype}", accepted="unsigned integers")
        stills = None if dark is None else self._checked(np.asarray(dark), "dark").reshape(-1, *image_shape)
        if self.path.exists():
            raise InputError(self.path, "exists already", accepted="a new name", remedy="move it out of the way")
        text = json.dumps(dict(settings or {}), allow_nan=False)
        blosc = hdf5plugin.Blosc(cname="lz4", clevel=5, shuffle=hdf5plugin.Blosc.SHUFFLE)
        try:
            self._file: Any = h5py.File(self.path, "x", libver="latest")
        except OSError as error:
            raise unwritable(self.path, error) from error
        try:
            self._lay_out(stills, text, blosc, with_time=with_time)
        except BaseException:
            self._file.close()
            self.path.unlink()
            raise

    def _lay_out(
        self, stills: NDArray[Any] | None, settings: str, blosc: Mapping[str, Any], *, with_time: bool
    ) -> None:
        rows, columns = self._image_shape
        images = {"dtype": self._dtype, "chunks": (1, rows, columns), **blosc}
        self._file["implements"] = "exchange"
        self._file.create_group("process").attrs["settings"] = settings
        group = self._file.create_group("exchange")
        self._data = group.create_dataset("data", (0, rows, columns), maxshape=(None, rows, columns), **images)
        self._data.attrs["axes"] = "theta:y:x"
        self._theta = self._create_series(group, "theta", "deg")
        self._time = self._create_series(group, "time", "s") if with_time else None
        if stills is not None:
            group.create_dataset("data_dark", data=stills, **images)
        self._file.swmr_mode = True  # from here on nothing can be added but frames

    @staticmethod
    def _create_series(group: Any, name: str, unit: str) -> Any:
        dataset = group.create_dataset(name, (0,), maxshape=(None,), chunks=(1024,), dtype=np.float64)
        dataset.attrs["units"] = unit
        return dataset

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; what was appended stays, whatever ended the recording."""
        if self._file:
            for dataset in (self._theta, self._time, self._data):
                if dataset is not None and len(dataset) > self.count:  # an append was cut short
                    dataset.resize(self.count, axis=0)
            self._file.close()

    def append(self, frame: NDArray[Any], angle_rad: float, time_s: float | None = None) -> None:
        """Add a frame; when this returns, readers see it and a crash does not lose it.

        Parameters
        ----------
        frame
            (row, column), of the file's type.
        angle_rad
            Stage angle.
        time_s
            Time of exposure; required unless the file was made without times.

        Raises
        ------
        InputError
            The frame does not fit, the angle is not finite, or the disk is full; earlier frames are safe.
        """
        frame = self._checked(frame, "frame")
        if frame.ndim != 2:
            raise InputError("frame", f"has the shape {frame.shape}", accepted=f"{self._image_shape}")
        if not np.isfinite(angle_rad):
            raise InputError("angle_rad", f"is {angle_rad}", accepted="a finite angle")
        if (time_s is None) is not (self._time is None):
            raise InputError("time_s", f"is {time_s}", accepted="a time for every frame, or for none")
        kept = f"{self.count} frames are safe"
        try:
            self._append(frame, angle_rad, time_s)
        except (OSError, RuntimeError) as error:
            raise (disk_full(self.path, kept) if is_disk_full(error) else unwritable(self.path, error)) from error

    def _append(self, frame: NDArray[Any], angle_rad: float, time_s: float | None) -> None:
        if shutil.disk_usage(self.path.parent).free < 2 * frame.nbytes + _RESERVE_BYTES:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        # Angle and time first: a reader counts frames by `data`, and finds the others at least as long.
        self._extend(self._theta, np.rad2deg(angle_rad))
        if self._time is not None:
            self._extend(self._time, time_s)
        self._extend(self._data, frame)
        self.count += 1

    def _extend(self, dataset: Any, value: Any) -> None:
        dataset.resize(self.count + 1, axis=0)
        dataset[self.count] = value
        dataset.flush()

    def _checked(self, images: NDArray[Any], name: str) -> NDArray[Any]:
        if images.shape[-2:] != self._image_shape or images.dtype != self._dtype:
            raise InputError(
                name, f"is {images.dtype} of shape {images.shape}",
                accepted=f"{self._dtype} of shape {self._image_shape}, as the file was made for",
            )  # fmt: skip
        return images


def write_frames(
    path: str | Path, counts: NDArray[Any], angles_rad: ArrayLike, *, dark: ArrayLike | None = None,
    time_s: ArrayLike | None = None, settings: Mapping[str, object] | None = None,
) -> None:  # fmt: skip
    """Write a whole recording; it appears when it is complete, and replaces what had the name.

    Parameters
    ----------
    path
        The file to make.
    counts
        (frame, row, column), unsigned integers.
    angles_rad
        (frame,) stage angles.
    dark
        Frames without the object, (row, column) or (frame, row, column).
    time_s
        (frame,) times, if known.
    settings
        As for `FrameWriter`.

    Raises
    ------
    InputError
        The arrays do not fit each other, or the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "frames.h5"
    >>> write_frames(path, np.zeros((2, 4, 4), np.uint16), [0.0, 0.1])
    """
    angles = np.asarray(angles_rad, dtype=np.float64)
    times = None if time_s is None else np.asarray(time_s, dtype=np.float64)
    if counts.ndim != 3:
        raise InputError("counts", f"has the shape {counts.shape}", accepted="three axes (frame, row, column)")
    for name, values in (("angles_rad", angles), ("time_s", times)):
        if values is not None and values.shape != (len(counts),):
            raise InputError(name, f"has the shape {values.shape}", accepted=f"({len(counts)},), one a frame")
    if not np.isfinite(angles).all():
        raise InputError("angles_rad", "holds values that are not finite", accepted="finite angles")
    shape = (counts.shape[1], counts.shape[2])
    with (
        staged_file(path) as unfinished,
        FrameWriter(
            unfinished, shape, dtype=counts.dtype, dark=dark, settings=settings, with_time=time_s is not None
        ) as writer,
    ):
        for index, frame in enumerate(counts):
            # Not `append`: a full disk is told by `staged_file`, with the name that the user gave.
            writer._append(frame, angles[index], None if times is None else times[index])
