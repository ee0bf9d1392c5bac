"""GigE Vision and USB3 Vision cameras by Aravis, without software of their vendors."""

from __future__ import annotations

import contextlib
import ipaddress
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

from vialight.core.config import CameraSettings
from vialight.devices.cameras.features import Range, Value
from vialight.devices.cameras.finding import FoundCamera, choose_camera
from vialight.devices.cameras.links import RawFrame
from vialight.devices.protocols import DeviceError

REMEDY = (
    "on Debian or Ubuntu: apt-get install gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev gcc pkg-config, "
    "then pip install 'vialight[aravis]'"
)


def load_aravis() -> Any:
    """Return Aravis' library.

    Raises
    ------
    DeviceError
        It, or what lets Python call it, is not installed.
    """
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        raise DeviceError("aravis", f"is not installed ({error})", REMEDY) from error
    return Aravis


@contextlib.contextmanager
def _told(name: str) -> Iterator[None]:
    """Raise the library's errors as `DeviceError`."""
    from gi.repository import GLib

    try:
        yield
    except GLib.Error as error:
        raise DeviceError(name, error.message) from error


def list_aravis_cameras() -> list[FoundCamera]:
    """Return the cameras that answer now; takes a second."""
    aravis = load_aravis()
    aravis.update_device_list()
    return [
        FoundCamera(
            "aravis",
            " ".join(map(str, (aravis.get_device_vendor(i), aravis.get_device_model(i)))),
            aravis.get_device_serial_nbr(i) or "",
            aravis.get_device_address(i) or "",
            aravis.get_device_id(i),
            str(aravis.get_device_protocol(i)),
        )
        for i in range(aravis.get_n_devices())
    ]


class AravisLink:
    """An open camera; `Link` is the contract.

    Parameters
    ----------
    settings
        Of the rig; ``device`` is used.

    Raises
    ------
    DeviceError
        Aravis is not installed, or the camera cannot be found or opened.
    """

    def __init__(self, settings: CameraSettings) -> None:
        self._aravis = load_aravis()
        self._stream: Any = None
        self._chunks: Any = None
        self._lost = threading.Event()
        identifier = settings.device
        if identifier is None or not _is_address(identifier):
            identifier = choose_camera(list_aravis_cameras(), settings.device).identifier
        with _told(f"camera {identifier}"):
            self._camera: Any = self._aravis.Camera.new(identifier)
            device = self._camera.get_device()
            parts = (self._camera.get_vendor_name(), self._camera.get_model_name())
            serial = self._camera.get_device_serial_number()
        self.name = " ".join(part for part in (*parts, serial) if part)
        lost = self._lost
        device.connect("control-lost", lambda *_: lost.set())  # does not refer to self: that would keep the camera
        self.features = _AravisFeatures(self._aravis, device, self.name)

    def start(self, buffers: int) -> None:
        """Begin to acquire, with the largest packets that the network carries, and lost ones asked for again."""
        self._stop()
        camera, aravis = self._camera, self._aravis
        with _told(self.name):
            if camera.is_gv_device():
                with contextlib.suppress(DeviceError), _told(self.name):
                    camera.gv_auto_packet_size()  # a network that carries no test packet keeps the camera's size
            stream = camera.create_stream(None, None)
            stream.set_emit_signals(False)
            if camera.is_gv_device():
                stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.AUTO)
                stream.set_property("packet-resend", aravis.GvStreamPacketResend.ALWAYS)
            payload = camera.get_payload()
            for _ in range(buffers):
                stream.push_buffer(aravis.Buffer.new_allocate(payload))
            self._format = str(self.features.get("PixelFormat"))
            has_chunks = camera.are_chunks_available() and camera.get_chunk_mode()
            self._chunks = camera.create_chunk_parser() if has_chunks else None
            camera.start_acquisition()
        self._stream = stream

    def next_frame(self, timeout_s: float) -> RawFrame | None:
        """Return the next buffer; None where none has come in time."""
        buffer = self._stream.timeout_pop_buffer(int(1e6 * timeout_s))
        if buffer is None:
            return None
        try:
            if buffer.get_status() != self._aravis.BufferStatus.SUCCESS:
                return RawFrame(False, np.empty(0, np.uint8), self._format, 0, 0, 0, None, None, None)
            region = buffer.get_image_region()
            data = np.frombuffer(buffer.get_image_data(), np.uint8)
            stamp_ns = self._chunk(buffer, "ChunkTimestamp") or buffer.get_timestamp()
            frame_id = self._chunk(buffer, "ChunkFrameID")
            exposure_us = self._chunk(buffer, "ChunkExposureTime")
            return RawFrame(
                True, data, self._format, region.width, region.height, buffer.get_image_padding().x_padding,
                buffer.get_frame_id() if frame_id is None else int(frame_id),
                1e-9 * stamp_ns if stamp_ns else None,
                None if exposure_us is None else 1e-6 * exposure_us,
            )  # fmt: skip
        finally:
            self._stream.push_buffer(buffer)

    def is_lost(self) -> bool:
        """Whether the camera has stopped answering."""
        return self._lost.is_set()

    def close(self) -> None:
        """Stop acquiring and let the camera go: with the last reference to it."""
        self._stop()
        self._camera = None
        self.features = _AravisFeatures(self._aravis, None, self.name)

    def _stop(self) -> None:
        stream, self._stream, self._chunks = self._stream, None, None
        if stream is not None and not self._lost.is_set():
            with contextlib.suppress(DeviceError), _told(self.name):
                self._camera.stop_acquisition()

    def _chunk(self, buffer: Any, name: str) -> float | None:
        if self._chunks is None or not buffer.has_chunks():
            return None
        read = self._chunks.get_float_value if name == "ChunkExposureTime" else self._chunks.get_integer_value
        try:
            with _told(self.name):
                return float(read(buffer, name))
        except DeviceError:
            return None  # a chunk that this camera does not send


def _is_address(identifier: str) -> bool:
    try:
        ipaddress.ip_address(identifier)
    except ValueError:
        return False
    return True


class _AravisFeatures:
    """Features of a device; `Features` is the contract."""

    def __init__(self, aravis: Any, device: Any, name: str) -> None:
        self._aravis, self._device, self._name = aravis, device, name

    def has(self, name: str) -> bool:
        """Whether there is such a feature now."""
        with self._access(name) as device:
            return bool(device.is_feature_available(name))

    def get(self, name: str) -> Value:
        """Return a value."""
        with self._access(name) as device:
            value: Value = getattr(device, f"get_{self._kind(name)}_feature_value")(name)
            return value

    def set(self, name: str, value: Value) -> None:
        """Set a value."""
        with self._access(name) as device:
            kind = self._kind(name)
            as_kind = {"boolean": bool, "float": float, "integer": int, "string": str}[kind]
            getattr(device, f"set_{kind}_feature_value")(name, as_kind(value))

    def execute(self, name: str) -> None:
        """Give a command."""
        with self._access(name) as device:
            device.execute_command(name)

    def range(self, name: str) -> Range:
        """Return what a number may be."""
        with self._access(name) as device:
            if self._kind(name) == "integer":
                low, high = device.get_integer_feature_bounds(name)
                return Range(low, high, device.get_integer_feature_increment(name))
            low, high = device.get_float_feature_bounds(name)
            return Range(low, high, 0.0)

    def choices(self, name: str) -> list[str]:
        """Return what an enumeration may be now."""
        with self._access(name) as device:
            return list(device.dup_available_enumeration_feature_values_as_strings(name))

    def _kind(self, name: str) -> str:
        node, aravis = self._device.get_feature(name), self._aravis
        kinds = (
            (aravis.GcEnumeration, "string"), (aravis.GcBoolean, "boolean"), (aravis.GcFloat, "float"),
            (aravis.GcInteger, "integer"),
        )  # fmt: skip
        return next((kind for type_, kind in kinds if isinstance(node, type_)), "string")

    @contextlib.contextmanager
    def _access(self, name: str) -> Iterator[Any]:
        if self._device is None:
            raise DeviceError(self._name, "is closed")
        with _told(f"{self._name}, {name}"):
            yield self._device
