"""A monitor of the tests' own: an X server whose screen is a file."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from devices.cameras.screen_camera import pixels_of

COLUMNS, ROWS = 320, 240

needs_xvfb = pytest.mark.skipif(
    shutil.which("Xvfb") is None and "CI" not in os.environ, reason="Xvfb is not installed; `make system` does it"
)


class Xvfb:
    """An X server with a screen of 24 bit, and what is on it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        read, write = os.pipe()
        self._process = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{COLUMNS}x{ROWS}x24", "-fbdir", str(folder),
             "-noreset", "-nolisten", "tcp"],
            pass_fds=[write], stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(write)
        with os.fdopen(read) as answer:
            self.display = f":{answer.readline().strip()}"
        self.framebuffer = folder / "Xvfb_screen0"
        self._screen = pixels_of(self.framebuffer, COLUMNS, ROWS)

    def light_the_desktop(self) -> None:
        """Make white what lies under all windows, as a desktop may be."""
        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XDefaultRootWindow.restype = ctypes.c_ulong
        display = ctypes.c_void_p(x11.XOpenDisplay(self.display.encode()))
        root = ctypes.c_ulong(x11.XDefaultRootWindow(display))
        x11.XSetWindowBackground(display, root, ctypes.c_ulong(0xFFFFFF))
        x11.XClearWindow(display, root)
        x11.XSync(display, 0)
        x11.XCloseDisplay(display)

    def pixels(self) -> NDArray[np.uint8]:
        """(row, column, blue-green-red) on the screen now."""
        return np.array(self._screen).reshape(ROWS, COLUMNS, 4)[..., :3]

    def is_black(self) -> bool:
        """Whether no light comes from the screen."""
        return not self.pixels().any()

    def wait_until_black(self, timeout_s: float) -> float:
        """Return after how many seconds it was black."""
        begin = time.monotonic()
        while not self.is_black():
            assert time.monotonic() - begin < timeout_s, "still light"
            time.sleep(0.002)
        return time.monotonic() - begin

    def close(self) -> None:
        """End the server."""
        self._process.terminate()
        self._process.wait()


@contextlib.contextmanager
def running_xvfb(folder: Path, patch: pytest.MonkeyPatch) -> Iterator[Xvfb]:
    """Start a server and make it the one that programs use; the curtain's place is the folder too."""
    screen = Xvfb(folder)
    patch.setenv("DISPLAY", screen.display)
    patch.setenv("XDG_RUNTIME_DIR", str(folder))
    patch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
    try:
        yield screen
    finally:
        screen.close()
