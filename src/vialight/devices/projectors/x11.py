"""What GLFW does not ask of an X server: a background that the server paints by itself, a window above all others."""

from __future__ import annotations

import ctypes
from typing import Any

_OVERRIDE_REDIRECT = 1 << 9
"""CWOverrideRedirect of ``X11/X.h``."""


class _Attributes(ctypes.Structure):
    """XSetWindowAttributes of ``X11/Xlib.h``."""

    _fields_ = [  # as ctypes wants it
        ("background_pixmap", ctypes.c_ulong), ("background_pixel", ctypes.c_ulong),
        ("border_pixmap", ctypes.c_ulong), ("border_pixel", ctypes.c_ulong),
        ("bit_gravity", ctypes.c_int), ("win_gravity", ctypes.c_int), ("backing_store", ctypes.c_int),
        ("backing_planes", ctypes.c_ulong), ("backing_pixel", ctypes.c_ulong), ("save_under", ctypes.c_int),
        ("event_mask", ctypes.c_long), ("do_not_propagate_mask", ctypes.c_long), ("override_redirect", ctypes.c_int),
        ("colormap", ctypes.c_ulong), ("cursor", ctypes.c_ulong),
    ]  # fmt: skip


def let_server_paint(glfw: Any, window: Any) -> None:
    """Make black the window's background: without, what was over it stays on the screen until its process paints."""
    x11, display, handle = _asked(glfw, window)
    x11.XSetWindowBackground(display, handle, ctypes.c_ulong(0))
    x11.XClearWindow(display, handle)
    x11.XSync(display, 0)


def leave_to_nobody(glfw: Any, window: Any) -> None:
    """Keep window managers from deciding where a window lies; before it is shown."""
    x11, display, handle = _asked(glfw, window)
    wanted = _Attributes(override_redirect=1)
    x11.XChangeWindowAttributes(display, handle, ctypes.c_ulong(_OVERRIDE_REDIRECT), ctypes.byref(wanted))
    x11.XSync(display, 0)


def show_above_all(glfw: Any, window: Any) -> None:
    """Show a window above all others; returns when the server has done so."""
    x11, display, handle = _asked(glfw, window)
    x11.XMapRaised(display, handle)
    x11.XSync(display, 0)


def _asked(glfw: Any, window: Any) -> tuple[Any, ctypes.c_void_p, ctypes.c_ulong]:
    x11 = ctypes.CDLL("libX11.so.6")
    return x11, ctypes.c_void_p(glfw.get_x11_display()), ctypes.c_ulong(glfw.get_x11_window(window))
