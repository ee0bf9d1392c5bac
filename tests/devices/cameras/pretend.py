"""A camera that is only features and frames, for what no camera at hand does."""

from __future__ import annotations

import math
import queue
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vialight.devices import DeviceError
from vialight.devices.cameras.features import Range, Value
from vialight.devices.cameras.links import RawFrame


@dataclass
class PretendFeatures:
    """Features with ranges and choices; what is set is noted in its order."""

    values: dict[str, Value]
    ranges: dict[str, Range] = field(default_factory=dict)
    entries: dict[str, list[str]] = field(default_factory=dict)
    noted: list[tuple[str, Value]] = field(default_factory=list)
    fault: str = ""

    def has(self, name: str) -> bool:
        self._check()
        return name in self.values

    def get(self, name: str) -> Value:
        self._check()
        if name not in self.values:
            raise DeviceError("pretend", f"has no {name}")
        return self.values[name]

    def set(self, name: str, value: Value) -> None:
        self._check()
        if name in self.entries and value not in self.entries[name]:
            raise DeviceError("pretend", f"{name} is not {value}")
        limits = self.ranges.get(name)
        if limits and not limits.low <= float(value) <= limits.high:
            raise DeviceError("pretend", f"{name} cannot be {value}")
        if limits and limits.step and abs(math.remainder(float(value) - limits.low, limits.step)) > 1e-9:
            raise DeviceError("pretend", f"{name} goes in steps of {limits.step}")
        self.values[name] = value
        self.noted.append((name, value))

    def execute(self, name: str) -> None:
        self._check()
        self.noted.append((name, True))

    def range(self, name: str) -> Range:
        return self.ranges.get(name, Range(-1e9, 1e9, 0.0))

    def choices(self, name: str) -> list[str]:
        return self.entries.get(name, [str(self.values[name])])

    def _check(self) -> None:
        if self.fault:
            raise DeviceError("pretend", self.fault)


def standard_features(**others: Any) -> PretendFeatures:
    """The features of an ordinary camera of 640 x 400 pixels."""
    values: dict[str, Value] = {
        "Width": 640, "Height": 400, "OffsetX": 0, "OffsetY": 0, "PixelFormat": "Mono12p", "BinningHorizontal": 1,
        "BinningVertical": 1, "ExposureTime": 10_000.0, "ExposureAuto": "Continuous", "Gain": 0.0,
        "AcquisitionFrameRate": 30.0, "AcquisitionFrameRateEnable": False, "TriggerMode": "On",
        "TriggerSelector": "AcquisitionStart", "TriggerSource": "Line1", "GammaEnable": True,
    }  # fmt: skip
    ranges = {
        "Width": Range(16, 640, 16), "Height": Range(2, 400, 2), "OffsetX": Range(0, 624, 8),
        "OffsetY": Range(0, 398, 2), "ExposureTime": Range(20.0, 1e6, 0.0), "Gain": Range(0.0, 24.0, 0.1),
        "AcquisitionFrameRate": Range(0.5, 120.0, 0.0),
    }  # fmt: skip
    entries = {
        "PixelFormat": ["Mono8", "Mono12p", "Mono16"], "TriggerSelector": ["AcquisitionStart", "FrameStart"],
        "TriggerMode": ["Off", "On"], "TriggerSource": ["Line0", "Line1", "Software"],
        "ExposureAuto": ["Off", "Continuous"],
    }  # fmt: skip
    return PretendFeatures(values | others, ranges, entries)


class PretendLink:
    """Hands over frames that a test has put; `Link` is the contract."""

    def __init__(self, features: PretendFeatures | None = None) -> None:
        self.name = "Pretend P1 17"
        self.features = features or standard_features()
        self.frames: queue.Queue[RawFrame] = queue.Queue()
        self.lost = False
        self.started = self.closed = 0

    def start(self, buffers: int) -> None:
        self.started += 1

    def next_frame(self, timeout_s: float) -> RawFrame | None:
        try:
            return self.frames.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def is_lost(self) -> bool:
        return self.lost

    def close(self) -> None:
        self.closed += 1

    def put(self, frame_id: int | None, stamp_s: float | None = None, **others: Any) -> None:
        """Let a frame arrive, all of its pixels being its id."""
        columns, rows = int(self.features.values["Width"]), int(self.features.values["Height"])
        data = np.full(columns * rows, (frame_id or 0) % 256, np.uint8)
        frame = RawFrame(True, data, "Mono8", columns, rows, 0, frame_id, stamp_s, None)
        self.frames.put(frame._replace(**others))


class HandClock:
    """A clock that a test turns by hand."""

    rate = 1.0

    def __init__(self) -> None:
        self.time_s = 100.0

    def now_s(self) -> float:
        return self.time_s
