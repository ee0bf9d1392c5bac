"""Writing camera frames to HDF5 in the Data Exchange layout, while others read.

h5py and hdf5plugin are imported when a file is created.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from vialight.core.errors import InputError
from vialight.store.durable import end_of_hdf5, forget_tables, read_tables, sync_descriptor, write_tables
from vialight.store.folders import disk_full, is_disk_full, staged_file, unwritable
from vialight.system import wait_for

SYNC_S = 1.0
"""Between two syncs of a recording to the disk; a power cut may lose what came in this time."""
_RESERVE_BYTES = 1 << 20
"""Room for the file's own tables, reserved with that of two frames: HDF5 must never be refused a write."""
_BUSY_SHARE = 0.05
"""Of the time, for which copying tables may hold up frames; a recording of many hours is synced less often."""
_CLOSE_S = 10.0
"""For the last sync, after which a recording is closed without."""


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
    sync_every_s
        Between two syncs to the disk, on a thread of their own; None for none but those that are asked for.

    Attributes
    ----------
    count : int
        Frames that are in the file: readers see them, and no crash of this process loses them.
    durable_frames : int
        Frames that are on the disk: no power cut loses them.

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
    ...     writer.count, writer.sync(), writer.durable_frames
    (1, None, 1)
    """

    def __init__(
        self, path: str | Path, image_shape: tuple[int, int], *, dtype: DTypeLike = np.uint16,
        dark: ArrayLike | None = None, settings: Mapping[str, object] | None = None, with_time: bool = True,
        sync_every_s: float | None = SYNC_S,
    ) -> None:  # fmt: skip
        import h5py
        import hdf5plugin

        self.path = Path(path)
        self.count = self.durable_frames = 0
        self._image_shape = tuple(image_shape)
        self._dtype = np.dtype(dtype)
        if self._dtype.kind != "u":
            raise InputError("dtype", f"is {self._dtype}", accepted="unsigned integers")
        stills = None if dark is None else self._checked(np.asarray(dark), "dark").reshape(-1, *image_shape)
        if self.path.exists():
            raise InputError(self.path, "exists already", accepted="a new name", remedy="move it out of the way")
        text = json.dumps(dict(settings or {}), allow_nan=False)
        blosc = hdf5plugin.Blosc(cname="lz4", clevel=5, shuffle=hdf5plugin.Blosc.SHUFFLE)
        self._lock = threading.Lock()
        """Held by whoever uses HDF5; never while the disk is waited for."""
        self._sync_every_s = sync_every_s
        self._sync_fault: str | None = None
        self._synced_at = time.monotonic()
        self._thread: threading.Thread | None = None
        self._wake = threading.Event()
        self._is_closed = self._is_given_up = False
        self._reserved = 0
        try:
            self._file: Any = h5py.File(self.path, "x", libver="latest")
        except OSError as error:
            raise unwritable(self.path, error) from error
        self._descriptor = os.open(self.path, os.O_RDWR)
        try:
            self._reserve(0 if stills is None else stills.nbytes)
            self._lay_out(stills, text, blosc, with_time=with_time)
        except BaseException as error:
            self._give_up()
            self.close()
            self.path.unlink()
            if isinstance(error, OSError | RuntimeError):
                raise self._refused(error, "nothing was recorded") from error
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
        self._dark = None if stills is None else group.create_dataset("data_dark", data=stills, **images)
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

    @property
    def unsynced_s(self) -> float:
        """For how long there have been frames that are not on the disk for certain."""
        return time.monotonic() - self._synced_at if self.count > self.durable_frames else 0.0

    def sync(self, timeout_s: float = _CLOSE_S) -> str | None:
        """Wait until the frames that are in the file now are on the disk; say why they are not.

        Parameters
        ----------
        timeout_s
            After which it is given up; the disk goes on.

        Returns
        -------
        str or None
            What is wrong; None where no power cut can lose them.
        """
        wanted = self.count
        if self.durable_frames >= wanted:
            return None
        if self._is_closed or self._is_given_up:
            return "the file is closed"
        self._sync_fault = None
        self._start_thread()
        self._wake.set()
        return wait_for(lambda: self.durable_frames >= wanted, lambda: self._sync_fault, timeout_s, every_s=0.002)

    def close(self) -> None:
        """Close the file; what was appended stays, whatever ended the recording.

        A disk that does not take it within some seconds is waited for no longer.
        """
        if self._is_closed:
            return
        if self._thread is not None:
            self.sync(_CLOSE_S)
        with self._lock:
            self._is_closed = True
            self._close_hdf5()
        if self._thread is None:
            os.close(self._descriptor)
        else:
            self._wake.set()
            self._thread.join(_CLOSE_S)

    def append(self, frame: NDArray[Any], angle_rad: float, time_s: float | None = None) -> None:
        """Add a frame; when this returns, readers see it and a crash of this process does not lose it.

        A power cut does not lose it once `durable_frames` counts it, about a second later.

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
        try:
            self._append(frame, angle_rad, time_s)
        except (OSError, RuntimeError) as error:
            raise self._refused(error, f"{self.count} frames are safe") from error
        if self._sync_every_s is not None:
            self._start_thread()

    def _refused(self, error: Exception, kept: str) -> InputError:
        return disk_full(self.path, kept) if is_disk_full(error) else unwritable(self.path, error)

    def _append(self, frame: NDArray[Any], angle_rad: float, time_s: float | None) -> None:
        with self._lock:
            if self._is_given_up:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            self._reserve(2 * frame.nbytes)
            if self.count == self.durable_frames:
                self._synced_at = time.monotonic()
            try:
                # Angle and time first: a reader counts frames by `data`, and finds the others at least as long.
                self._extend(self._theta, np.rad2deg(angle_rad))
                if self._time is not None:
                    self._extend(self._time, time_s)
                self._extend(self._data, frame)
            except (OSError, RuntimeError):
                self._give_up()
                raise
            self.count += 1

    def _extend(self, dataset: Any, value: Any) -> None:
        dataset.resize(self.count + 1, axis=0)
        dataset[self.count] = value
        dataset.flush()

    def _reserve(self, length: int) -> None:
        """Take room on the disk before HDF5 needs it, so that whatever limits files is met here."""
        needed = length + _RESERVE_BYTES
        end = int(self._file.id.get_filesize()) + needed
        if end <= self._reserved:
            return
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._descriptor, 0, end + needed)
        elif shutil.disk_usage(self.path.parent).free < 2 * needed:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._reserved = end + needed

    def _give_up(self) -> None:
        """Let HDF5 write to nowhere from now on.

        A file that refuses a write refuses the next one, too, and HDF5 that cannot write what it still holds brings
        the process down when it ends.  What is in the file stays as it is.
        """
        self._is_given_up = True
        if sys.platform != "win32":
            with tempfile.TemporaryFile(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as nowhere:
                os.dup2(nowhere.fileno(), self._file.id.get_vfd_handle())

    def _close_hdf5(self) -> None:
        if self._is_given_up:
            with contextlib.suppress(OSError, RuntimeError):
                self._file.close()
            return
        for dataset in (self._theta, self._time, self._data):
            if dataset is not None and len(dataset) > self.count:  # an append was cut short
                dataset.resize(self.count, axis=0)
        self._file.close()
        os.ftruncate(self._descriptor, end_of_hdf5(self._descriptor))

    def _start_thread(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._keep_synced, name="sync", daemon=True)
            self._thread.start()

    def _keep_synced(self) -> None:
        pause_s = self._sync_every_s
        while not self._is_closed:
            self._wake.wait(pause_s)
            self._wake.clear()
            if self.count > self.durable_frames:
                pause_s = self._sync_once()
        try:
            if not self._is_given_up:
                sync_descriptor(self._descriptor)
                self.durable_frames = self.count
                forget_tables(self.path)
        except OSError as error:
            self._sync_fault = str(self._refused(error, f"{self.durable_frames} frames are safe"))
        finally:
            os.close(self._descriptor)

    def _sync_once(self) -> float | None:
        """Put what is in the file on the disk; return how long to wait until the next time, s."""
        try:
            with self._lock:
                if self._is_closed or self._is_given_up:
                    self._sync_fault = "the file is closed"
                    return self._sync_every_s
                begun, count = time.monotonic(), self.count
                extents: list[tuple[int, int]] = []
                for images in (self._data, self._dark):
                    if images is not None:
                        images.id.chunk_iter(lambda chunk: extents.append((chunk.byte_offset, chunk.size)))
                size = min(int(self._file.id.get_filesize()), os.fstat(self._descriptor).st_size)
                places, pieces = read_tables(self._descriptor, extents, size)
                held_s = time.monotonic() - begun
            sync_descriptor(self._descriptor)
            write_tables(self.path, count, size, places, pieces)
        except (OSError, RuntimeError) as error:
            self._sync_fault = str(self._refused(error, f"{self.durable_frames} frames are safe"))
            return self._sync_every_s
        self.durable_frames, self._synced_at = count, time.monotonic()
        return None if self._sync_every_s is None else max(self._sync_every_s, held_s / _BUSY_SHARE)

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
            unfinished,
            shape,
            dtype=counts.dtype,
            dark=dark,
            settings=settings,
            with_time=time_s is not None,
            sync_every_s=None,
        ) as writer,
    ):
        for index, frame in enumerate(counts):
            # Not `append`: a full disk is told by `staged_file`, with the name that the user gave.
            writer._append(frame, angles[index], None if times is None else times[index])
