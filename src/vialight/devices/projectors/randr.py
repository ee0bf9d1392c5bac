"""What the X server does to an image on its way to a monitor: GLFW tells the monitor's mode, and not this."""

from __future__ import annotations

import ctypes
from typing import Any

_ONE = 1 << 16
"""In X's fixed point."""
_Matrix = ctypes.c_int * 9


class _Attributes(ctypes.Structure):
    """XRRCrtcTransformAttributes of ``X11/extensions/Xrandr.h``: what is asked for, and what is in force."""

    _fields_ = [  # as ctypes wants it
        ("pending", _Matrix), ("pending_filter", ctypes.c_char_p), ("pending_count", ctypes.c_int),
        ("pending_values", ctypes.c_void_p),
        ("current", _Matrix), ("current_filter", ctypes.c_char_p), ("current_count", ctypes.c_int),
        ("current_values", ctypes.c_void_p),
    ]  # fmt: skip


def scaling_of(glfw: Any, handle: Any) -> str:
    """Return in words how X scales or bends the image of a monitor; empty where a pixel is a pixel.

    The scale of the desktop that GLFW tells (``Xft.dpi``) is left alone: programs draw larger by it, and pixels stay.
    """
    matrix = _transform(glfw.get_x11_display(), glfw.get_x11_adapter(handle))
    return "" if matrix is None else told_of_transform(matrix)


def told_of_transform(matrix: list[int]) -> str:
    """Say in words what a transform does.

    Parameters
    ----------
    matrix
        Its nine values by rows, in units of 1/65536: from the monitor's pixels to those of the image.

    Examples
    --------
    >>> told_of_transform([81920, 0, 0, 0, 81920, 0, 0, 0, 65536])
    'X11 draws 1.25 x 1.25 of its pixels on each of the monitor'
    >>> told_of_transform([65536, 0, 0, 0, 65536, 0, 0, 0, 65536])
    ''
    """
    across, down = matrix[0] / _ONE, matrix[4] / _ONE
    if matrix == [matrix[0], 0, 0, 0, matrix[4], 0, 0, 0, _ONE]:
        is_plain = across == down == 1
        return "" if is_plain else f"X11 draws {across:g} x {down:g} of its pixels on each of the monitor"
    return "X11 bends or shifts it by a transform"


def _transform(display: int, crtc: int) -> list[int] | None:
    """Return what is in force for a CRTC; None where X does not tell."""
    try:
        randr, x11 = ctypes.CDLL("libXrandr.so.2"), ctypes.CDLL("libX11.so.6")
    except OSError:
        return None  # then GLFW has monitors without it, too
    ask = randr.XRRGetCrtcTransform
    ask.argtypes = [ctypes.c_void_p, ctypes.c_ulong, ctypes.POINTER(ctypes.POINTER(_Attributes))]
    found = ctypes.POINTER(_Attributes)()
    if not ask(display, crtc, ctypes.byref(found)) or not found:
        return None
    matrix = list(found.contents.current)
    x11.XFree.argtypes = [ctypes.c_void_p]
    x11.XFree(found)
    return matrix
