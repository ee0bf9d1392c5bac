"""Settings by their standard names (GenICam SFNC), set in an order that works, read back, and compared."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable
from typing import NamedTuple, Protocol

from vialight.core.config import CameraSettings
from vialight.devices.protocols import DeviceError

Value = int | float | str | bool


class Range(NamedTuple):
    """Values that a number may have; `step` is 0 where every value between is possible."""

    low: float
    high: float
    step: float


class Features(Protocol):
    """A camera's features by name; every call may raise `DeviceError`."""

    def has(self, name: str) -> bool:
        """Whether there is such a feature now."""
        ...

    def get(self, name: str) -> Value:
        """Return a value."""
        ...

    def set(self, name: str, value: Value) -> None:
        """Set a value, within what the camera allows."""
        ...

    def execute(self, name: str) -> None:
        """Give a command."""
        ...

    def range(self, name: str) -> Range:
        """Return what a number may be."""
        ...

    def choices(self, name: str) -> list[str]:
        """Return what an enumeration may be now."""
        ...


class Rounded(NamedTuple):
    """A value that the camera has in place of the one that was asked for."""

    feature: str
    asked: Value
    has: Value

    def __str__(self) -> str:
        return f"{self.feature} is {_short(self.has)} instead of {_short(self.asked)}"


_EXPOSURE = ("ExposureTime", "ExposureTimeAbs")
_FRAME_RATE = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
"""Before SFNC 2 the same features ended in Abs.  GainRaw is another: its unit is not known."""
_RATE_SWITCHES = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
_UNTOLD = 1e-3
"""Of a value, by which it may differ without a word; whole numbers of pixels always differ by more."""
_CHUNKS = ("Timestamp", "FrameID", "ExposureTime")


def apply_settings(features: Features, settings: CameraSettings) -> list[Rounded]:
    """Set all that a rig asks for; what it leaves out stays as the camera has it.

    Returns
    -------
    list of Rounded
        What the camera has otherwise.

    Raises
    ------
    DeviceError
        The camera lacks a feature, or does not take a value.
    """
    # Counts must be linear in light, and stay comparable from frame to frame.
    told = [
        _set_if_there(features, name, value)
        for name, value in (
            ("GammaEnable", False), ("GammaEnabled", False), ("ExposureAuto", "Off"), ("GainAuto", "Off"),
            ("AcquisitionMode", "Continuous"), ("ExposureMode", "Timed"),
        )
    ]  # fmt: skip
    if settings.pixel_format is not None:
        _choose(features, "PixelFormat", settings.pixel_format)
    if settings.binning is not None:
        told += _bin(features, settings.binning)
    if settings.region is not None:
        told += _cut_out(features, settings.region)
    if settings.exposure_s is not None:
        told.append(_set_number(features, _EXPOSURE, 1e6 * settings.exposure_s))
    if settings.gain_db is not None:
        told.append(_set_number(features, ("Gain",), settings.gain_db))
    _set_trigger(features, settings)
    return [one for one in told if one is not None]


def set_frame_rate(features: Features, frame_rate_hz: float) -> float:
    """Set the rate and return what the camera has.

    Raises
    ------
    DeviceError
        It cannot: the exposure is too long, or the image too large.
    """
    for name in _RATE_SWITCHES:
        _set_if_there(features, name, True)
    _set_if_there(features, "AcquisitionFrameRateAuto", "Off")
    name = _first_of(features, _FRAME_RATE, 'set [camera.settings] trigger = "software"')
    features.set(name, _within(frame_rate_hz, features.range(name)))
    has = float(features.get(name))
    check_rate(features, has, frame_rate_hz)
    return has


def check_rate(features: Features, most_hz: float, frame_rate_hz: float) -> None:
    """Refuse a rate that is above what the camera gives, or its exposure allows.

    Raises
    ------
    DeviceError
        Says what it gives.
    """
    exposure = exposure_s(features)
    most = most_hz if exposure is None else min(most_hz, 1 / exposure)
    if most < 0.99 * frame_rate_hz:
        with_exposure = "" if exposure is None else f" at an exposure of {1e3 * exposure:g} ms"
        raise DeviceError(
            "camera", f"gives at most {most:.4g} frames/s{with_exposure}; asked for {frame_rate_hz:g}",
            "shorten [camera.settings] exposure_s, cut out a smaller region, or choose fewer bits a pixel",
        )  # fmt: skip


def settings_in_force(features: Features, settings: CameraSettings) -> CameraSettings:
    """Return settings with all that they leave out as the camera has it now, for when it comes back as new."""
    numbers = {
        name: int(features.get(name)) for name in ("OffsetX", "OffsetY", "Width", "Height") if features.has(name)
    }
    region = numbers.get("OffsetX", 0), numbers.get("OffsetY", 0), numbers["Width"], numbers["Height"]
    found: dict[str, object] = {"region": region, "pixel_format": features.get("PixelFormat")}
    if features.has("BinningHorizontal"):
        found["binning"] = int(features.get("BinningHorizontal"))
    if features.has("Gain"):
        found["gain_db"] = float(features.get("Gain"))
    found["exposure_s"] = exposure_s(features)
    return settings.model_copy(update=found)


def exposure_s(features: Features) -> float | None:
    """Return the exposure; None where the camera does not tell."""
    name = next(filter(features.has, _EXPOSURE), None)
    return None if name is None else 1e-6 * float(features.get(name))


def most_counts(features: Features, full_level: int) -> int:
    """Return the largest count that the camera can send: less than its format holds, where it says so."""
    if features.has("PixelDynamicRangeMax"):
        most = int(features.get("PixelDynamicRangeMax"))
        return min(most, full_level) if most > 0 else full_level
    return full_level


def enable_chunks(features: Features) -> list[str]:
    """Ask for timestamp, id and exposure with every frame; return the chunks that the camera sends."""
    if not (features.has("ChunkModeActive") and features.has("ChunkSelector")):
        return []
    _set_if_there(features, "ChunkModeActive", True)
    offered = [name for name in _CHUNKS if name in features.choices("ChunkSelector")]
    for name in offered:
        _set_if_there(features, "ChunkSelector", name)
        _set_if_there(features, "ChunkEnable", True)
    return [f"Chunk{name}" for name in offered]


def _set_trigger(features: Features, settings: CameraSettings) -> None:
    is_triggered = settings.trigger != "free-running"
    if not features.has("TriggerMode"):
        if is_triggered:
            raise DeviceError("camera", "has no trigger", 'set [camera.settings] trigger = "free-running"')
        return
    if features.has("TriggerSelector"):
        # Others, such as that of an acquisition's start, would hold frames back.
        for selector in features.choices("TriggerSelector"):
            features.set("TriggerSelector", selector)
            _set_if_there(features, "TriggerMode", "Off")
        if "FrameStart" in features.choices("TriggerSelector"):
            features.set("TriggerSelector", "FrameStart")
    if is_triggered:
        source = "Software" if settings.trigger == "software" else settings.trigger_line
        _choose(features, "TriggerSource", source)
        features.set("TriggerMode", "On")
    else:
        features.set("TriggerMode", "Off")


def _bin(features: Features, binning: int) -> list[Rounded | None]:
    told = []
    for axis in ("Horizontal", "Vertical"):
        names = [name for name in (f"Binning{axis}", f"Decimation{axis}") if features.has(name)]
        if not names and binning > 1:
            raise DeviceError("camera", "can neither bin nor decimate", "set [camera.settings] binning = 1")
        told += [_set_number(features, names[:1], binning)] if names else []
    return told


def _cut_out(features: Features, region: tuple[int, int, int, int]) -> list[Rounded | None]:
    """Set left, top, width and height; offsets go first, as they limit the size."""
    left, top, width, height = region
    for name in ("OffsetX", "OffsetY"):
        if features.has(name):
            features.set(name, int(features.range(name).low))
    sizes = [_set_number(features, (name,), value) for name, value in (("Width", width), ("Height", height))]
    return sizes + [
        _set_number(features, (name,), value)
        for name, value in (("OffsetX", left), ("OffsetY", top))
        if value or features.has(name)
    ]


def _set_number(features: Features, names: Iterable[str], value: float) -> Rounded | None:
    name = _first_of(features, names)
    features.set(name, _within(value, features.range(name)))
    has = features.get(name)
    return None if abs(float(has) - value) <= _UNTOLD * abs(value) else Rounded(name, value, has)


def _within(value: float, limits: Range) -> float:
    """Return a value that is allowed: the nearest within the limits, and there the last step that is not above it."""
    value = min(max(value, limits.low), limits.high)
    # Steps such as 0.1 are not exact.
    return limits.low + limits.step * math.floor((value - limits.low) / limits.step + 1e-6) if limits.step else value


def _choose(features: Features, name: str, value: str) -> None:
    choices = features.choices(_first_of(features, (name,)))
    if value not in choices:
        raise DeviceError("camera", f"does not take {value} for {name}", f"accepted: {', '.join(choices)}")
    features.set(name, value)
    if features.get(name) != value:
        raise DeviceError("camera", f"keeps {name} at {features.get(name)} instead of {value}")


def _set_if_there(features: Features, name: str, value: Value) -> Rounded | None:
    """Set a feature that not all cameras have, or let change."""
    if not features.has(name) or (isinstance(value, str) and value not in features.choices(name)):
        return None
    with contextlib.suppress(DeviceError):
        features.set(name, value)
    has = features.get(name)
    return None if has == value else Rounded(name, value, has)


def _first_of(features: Features, names: Iterable[str], remedy: str = "leave it out of [camera.settings]") -> str:
    names = tuple(names)
    for name in names:
        if features.has(name):
            return name
    raise DeviceError("camera", f"has no feature {' or '.join(names)}", remedy)


def _short(value: Value) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"
