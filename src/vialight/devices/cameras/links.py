"""What a driver must do for `GenicamCamera`: reach a camera, hand out its features, and its buffers as they come."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from vialight.devices.cameras.features import Features
from vialight.devices.cameras.pixels import Bytes


class RawFrame(NamedTuple):
    """A buffer as it came, in memory of its own."""

    is_complete: bool
    """Whether nothing of it was lost on the way."""
    data: Bytes
    """(byte,); empty where it is not complete."""
    pixel_format: str
    columns: int
    rows: int
    padding: int
    """Bytes at the end of each row."""
    frame_id: int | None
    stamp_s: float | None
    """By the camera's clock, None where it has none."""
    exposure_s: float | None
    """As the frame itself tells; None where it does not."""


class Link(Protocol):
    """An open connection to a camera, used from one thread at a time; any call may raise `DeviceError`."""

    @property
    def name(self) -> str:
        """Vendor, model and serial number, for a person."""
        ...

    @property
    def features(self) -> Features:
        """The camera's settings."""
        ...

    def start(self, buffers: int) -> None:
        """Begin to acquire, into so many buffers."""
        ...

    def next_frame(self, timeout_s: float) -> RawFrame | None:
        """Return the next buffer; None where none has come in time."""
        ...

    def is_lost(self) -> bool:
        """Whether the camera is known not to be there any more."""
        ...

    def close(self) -> None:
        """Stop acquiring, and let the camera go; from any state, and without an error."""
        ...


OpenLink = Callable[[], Link]
"""Reaches a camera, again where it was lost; raises `DeviceError` where it cannot be found."""
