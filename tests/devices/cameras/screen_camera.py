"""A GigE Vision camera that sees a screen: Aravis' camera in software, its pictures the screen's brightness.

    python screen_camera.py FRAMEBUFFER COLUMNS ROWS HOLD_S

A picture is the mean of the screen over the exposure, as it was `HOLD_S` before: a camera that is slow to send.
"""

from __future__ import annotations

import ctypes
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_LOOK_S, _KEPT_S = 0.001, 1.0
_EVERY = 16
"""Pixels and rows that are looked at: the flash fills the screen."""
_Fill = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)


def pixels_of(framebuffer: Path, columns: int, rows: int) -> NDArray[np.uint8]:
    """Return (row, 4 * column) what a screen of Xvfb shows, always as it is now."""
    content = np.memmap(framebuffer, np.uint8, "r")
    # The head of an XWD file, big-endian: its own length, ..., bytes a line, ..., colours.
    head = struct.unpack(">25I", content[:100].tobytes())
    start, line = head[0] + 12 * head[19], head[12]
    return content[start : start + line * rows].reshape(rows, line)[:, : 4 * columns]


class Watched:
    """How bright a screen has been."""

    def __init__(self, framebuffer: Path, columns: int, rows: int) -> None:
        self._seen = pixels_of(framebuffer, columns, rows)[::_EVERY, :: 4 * _EVERY]
        self._looks: deque[tuple[float, float]] = deque(maxlen=round(_KEPT_S / _LOOK_S))
        threading.Thread(target=self._look, daemon=True).start()

    def mean(self, begin_s: float, end_s: float) -> float:
        """Return the mean of a time."""
        return float(np.mean([level for time_s, level in list(self._looks) if begin_s <= time_s <= end_s] or [0.0]))

    def _look(self) -> None:
        while True:
            self._looks.append((time.monotonic(), float(self._seen.mean())))
            time.sleep(_LOOK_S)


def serve(picture: Callable[[int, int, float], NDArray[np.uint8]]) -> None:
    """Be a camera for good, whose pictures are what is made of height, width and exposure, s."""

    def fill(buffer: int, data: int, exposure_us: int, gain: int, pixel_format: int) -> None:
        height, width = aravis.arv_buffer_get_image_height(buffer), aravis.arv_buffer_get_image_width(buffer)
        image = np.ascontiguousarray(picture(height, width, 1e-6 * exposure_us))
        ctypes.memmove(aravis.arv_buffer_get_data(buffer, None), image.ctypes.data, image.nbytes)

    aravis = ctypes.CDLL("libaravis-0.8.so.0")
    for name in ("arv_gv_fake_camera_new", "arv_gv_fake_camera_get_fake_camera", "arv_buffer_get_data"):
        getattr(aravis, name).restype = ctypes.c_void_p
    aravis.arv_buffer_get_data.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    for name in ("arv_buffer_get_image_width", "arv_buffer_get_image_height", "arv_gv_fake_camera_get_fake_camera"):
        getattr(aravis, name).argtypes = [ctypes.c_void_p]
    aravis.arv_fake_camera_set_fill_pattern.argtypes = [ctypes.c_void_p, _Fill, ctypes.c_void_p]
    seen = _Fill(fill)
    camera = aravis.arv_gv_fake_camera_new(b"127.0.0.1", b"V01")
    aravis.arv_fake_camera_set_fill_pattern(aravis.arv_gv_fake_camera_get_fake_camera(camera), seen, None)
    threading.Event().wait()


def main() -> None:
    framebuffer, columns, rows, hold_s = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    watched = Watched(framebuffer, columns, rows)

    def picture(height: int, width: int, exposure_s: float) -> NDArray[np.uint8]:
        end_s = time.monotonic() - hold_s
        return np.full((height, width), round(watched.mean(end_s - exposure_s, end_s)), np.uint8)

    serve(picture)


if __name__ == "__main__":
    main()
