"""Cameras by a GenTL producer, the library (``.cti``) that comes with a vendor's software."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vialight.core.config import CameraSettings
from vialight.core.errors import InputError
from vialight.devices.cameras.features import Range, Value
from vialight.devices.cameras.finding import FoundCamera, choose_camera
from vialight.devices.cameras.links import RawFrame
from vialight.devices.cameras.pixels import frame_bytes
from vialight.devices.protocols import DeviceError

REMEDY = "pip install 'vialight[harvesters]', and the camera vendor's software with its GenTL producer"
_SEARCH_PATH = "GENICAM_GENTL64_PATH"
"""Where vendors' installers, by the GenTL standard, note their producers' folders."""
_LOOK_S, _SLEEP_S = 1e-4, 0.002
"""By turns, while nothing has come."""


def load_harvesters() -> Any:
    """Return the library.

    Raises
    ------
    DeviceError
        It is not installed.
    """
    try:
        import harvesters.core as library
    except ImportError as error:
        raise DeviceError("harvesters", f"is not installed ({error})", REMEDY) from error
    return library


@contextlib.contextmanager
def _told(name: str) -> Iterator[None]:
    """Raise the library's errors as `DeviceError`."""
    from genicam.genapi import GenericException
    from genicam.gentl import GenericException as TransportException

    try:
        yield
    except (GenericException, TransportException, ValueError, AttributeError, OSError) as error:
        lines = str(error).splitlines() or [type(error).__name__]
        raise DeviceError(name, lines[0]) from error


def find_producers(producer: str | None = None) -> list[Path]:
    """Return the producers that there are.

    Raises
    ------
    InputError
        The one that is named is not there.
    DeviceError
        None is named, and none is found.
    """
    if producer is not None:
        if not Path(producer).is_file():
            raise InputError(
                "[camera.settings] producer", f"{producer} is not there", accepted="a GenTL producer, .cti",
                remedy="check the path",
            )  # fmt: skip
        return [Path(producer)]
    folders = [Path(folder) for folder in os.environ.get(_SEARCH_PATH, "").split(os.pathsep) if folder]
    found = [path for folder in folders for path in sorted(folder.glob("*.cti"))]
    if not found:
        raise DeviceError(
            "harvesters", f"has no GenTL producer: {_SEARCH_PATH} names no folder with a .cti file",
            "install the camera vendor's software, or set [camera.settings] producer",
        )  # fmt: skip
    return found


def list_harvesters_cameras() -> list[FoundCamera]:
    """Return the cameras that the producers see now."""
    harvester = _harvester(find_producers())
    try:
        return _cameras(harvester)
    finally:
        harvester.reset()


def _harvester(producers: list[Path]) -> Any:
    library = load_harvesters()
    with _told("harvesters"):
        harvester = library.Harvester()
        for path in producers:
            harvester.add_file(str(path))
        harvester.update()
        return harvester


def _cameras(harvester: Any) -> list[FoundCamera]:
    return [
        FoundCamera(
            "harvesters", f"{_text(info, 'vendor')} {_text(info, 'model')}", _text(info, "serial_number"), "",
            _text(info, "id_"), _text(info, "tl_type"),
        )
        for info in harvester.device_info_list
    ]  # fmt: skip


def _text(info: Any, name: str) -> str:
    try:
        with _told("harvesters"):
            return str(getattr(info, name))
    except DeviceError:
        return ""


class HarvestersLink:
    """An open camera; `Link` is the contract.

    Parameters
    ----------
    settings
        Of the rig; ``device`` and ``producer`` are used.

    Raises
    ------
    InputError
        The producer is not there.
    DeviceError
        The library is not installed, or the camera cannot be found or opened.
    """

    def __init__(self, settings: CameraSettings) -> None:
        library = load_harvesters()
        self._harvester = _harvester(find_producers(settings.producer))
        try:
            found = _cameras(self._harvester)
            chosen = choose_camera(found, settings.device)
            with _told(f"camera {chosen.identifier}"), _kept_interrupt():
                self._acquirer: Any = self._harvester.create(found.index(chosen))
                self._nodes: Any = self._acquirer.remote_device.node_map
        except BaseException:
            self._harvester.reset()
            raise
        self.name = " ".join(part for part in (chosen.model, chosen.serial) if part)
        self.features = _HarvestersFeatures(self._nodes, self.name)
        self._incomplete = 0
        link = self

        class Count(library.Callback):  # type: ignore[name-defined, misc]  # the library has no types
            def emit(self, context: object = None) -> None:
                link._incomplete += 1

        self._acquirer.add_callback(self._acquirer.Events.INCOMPLETE_BUFFER, Count())
        self._acquirer.timeout_period_on_update_event_data_call = 0

    def start(self, buffers: int) -> None:
        """Begin to acquire."""
        with _told(self.name):
            self._acquirer.stop()
            self._acquirer.num_buffers = max(buffers, self._acquirer.min_num_buffers)
            self._format = str(self.features.get("PixelFormat"))
            self._acquirer.start()

    def next_frame(self, timeout_s: float) -> RawFrame | None:
        """Return the next buffer; None where none has come in time.

        The library holds Python's lock while it waits, so it is asked, and sleep is left to Python.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            before = self._incomplete
            with _told(self.name):
                buffer = self._acquirer.try_fetch(timeout=_LOOK_S, is_raw=True)
            if self._incomplete > before:
                return RawFrame(False, np.empty(0, np.uint8), self._format, 0, 0, 0, None, None, None)
            if buffer is not None:
                break
            if time.monotonic() >= deadline:
                return None
            time.sleep(_SLEEP_S)
        try:
            with _told(self.name):
                return self._raw_frame(buffer)
        finally:
            with _told(self.name):
                buffer.parent.queue_buffer(buffer)

    def is_lost(self) -> bool:
        """Say no: a producer has no common way to tell; its silence does."""
        return False

    def close(self) -> None:
        """Stop acquiring and let camera and producer go."""
        for let_go in (self._acquirer.destroy, self._harvester.reset):
            with contextlib.suppress(DeviceError), _told(self.name):
                let_go()

    def _raw_frame(self, buffer: Any) -> RawFrame:
        columns, rows = int(buffer.width), int(buffer.height)
        padding = int(_given(buffer, "padding_x") or 0)
        offset = int(_given(buffer, "image_offset") or 0)
        size = rows * (frame_bytes(self._format, columns, 1) + padding + 1)  # a byte a row more than it may be
        data = np.frombuffer(buffer.raw_buffer, np.uint8)[offset : offset + size].copy()
        frame_id = self._chunk("ChunkFrameID")
        exposure_us = self._chunk("ChunkExposureTime")
        return RawFrame(
            True, data, self._format, columns, rows, padding,
            _given(buffer, "frame_id") if frame_id is None else int(frame_id), self._stamp_s(buffer),
            None if exposure_us is None else 1e-6 * exposure_us,
        )  # fmt: skip

    def _stamp_s(self, buffer: Any) -> float | None:
        nanoseconds = _given(buffer, "timestamp_ns")
        if nanoseconds is not None:
            return 1e-9 * nanoseconds
        ticks, a_second = _given(buffer, "timestamp"), _given(buffer.parent.parent, "timestamp_frequency")
        return None if ticks is None or not a_second else ticks / a_second

    def _chunk(self, name: str) -> float | None:
        return float(self.features.get(name)) if self.features.has(name) else None


def _given(module: Any, name: str) -> int | None:
    """Return what a producer tells; None where it does not."""
    try:
        with _told("harvesters"):
            value: int = getattr(module, name)
            return value
    except DeviceError:
        return None


@contextlib.contextmanager
def _kept_interrupt() -> Iterator[None]:
    """Leave Ctrl-C as it is: the library takes it for itself."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _HarvestersFeatures:
    """Features of a node map; `Features` is the contract."""

    def __init__(self, nodes: Any, name: str) -> None:
        self._nodes, self._name = nodes, name

    def has(self, name: str) -> bool:
        """Whether there is such a feature now, that can be read or given."""
        with _told(f"{self._name}, {name}"):
            return bool(self._nodes.has_node(name)) and self._node(name).get_access_mode() in self._useful()

    def get(self, name: str) -> Value:
        """Return a value."""
        with _told(f"{self._name}, {name}"):
            value: Value = self._node(name).value
            return value

    def set(self, name: str, value: Value) -> None:
        """Set a value."""
        with _told(f"{self._name}, {name}"):
            node = self._node(name)
            node.value = int(value) if type(node).__name__ == "IInteger" else value

    def execute(self, name: str) -> None:
        """Give a command."""
        with _told(f"{self._name}, {name}"):
            self._node(name).execute()

    def range(self, name: str) -> Range:
        """Return what a number may be."""
        with _told(f"{self._name}, {name}"):
            node = self._node(name)
            has_steps = type(node).__name__ == "IInteger" or node.has_inc()
            return Range(node.min, node.max, node.inc if has_steps else 0.0)

    def choices(self, name: str) -> list[str]:
        """Return what an enumeration may be now."""
        with _told(f"{self._name}, {name}"):
            return list(self._node(name).symbolics)

    def _node(self, name: str) -> Any:
        return getattr(self._nodes, name)

    @staticmethod
    def _useful() -> tuple[int, ...]:
        from genicam.genapi import EAccessMode

        return EAccessMode.RO, EAccessMode.RW, EAccessMode.WO
