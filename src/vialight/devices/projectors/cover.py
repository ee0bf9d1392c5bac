"""The guardian's cover: a black window that is drawn above the projector's where that hangs.

It is the guardian's own, and the X server paints it: nothing is asked of the process that hangs.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

from vialight.devices.projectors.monitors import Monitor, chosen_monitor, last_fault, start_glfw
from vialight.devices.projectors.x11 import leave_to_nobody, let_server_paint, show_above_all
from vialight.devices.protocols import DeviceError

_HAS_X11 = sys.platform.startswith("linux")


class WindowCover:
    """A black window over a monitor, not shown until it is wanted.

    Parameters
    ----------
    monitor
        Its index or its name.
    size
        Columns and rows of the projector.

    Raises
    ------
    DeviceError
        It cannot be made.
    """

    def __init__(self, monitor: int | str, size: tuple[int, int]) -> None:
        self._glfw = start_glfw()
        self._is_drawn = False
        try:
            handle, found = chosen_monitor(self._glfw, monitor)
            for hint, value in (
                (self._glfw.CLIENT_API, self._glfw.NO_API),
                (self._glfw.VISIBLE, False),
                (self._glfw.DECORATED, False),
                (self._glfw.FLOATING, True),
                (self._glfw.FOCUS_ON_SHOW, False),
            ):
                self._glfw.window_hint(hint, value)
            self._window: Any = self._glfw.create_window(*size, "vialight: cover", None, None)
            _check_made(self._window, found, self._glfw)
            self._glfw.set_window_pos(self._window, *self._glfw.get_monitor_pos(handle))
            self._glfw.set_input_mode(self._window, self._glfw.CURSOR, self._glfw.CURSOR_HIDDEN)
            if _HAS_X11:
                leave_to_nobody(self._glfw, self._window)
                let_server_paint(self._glfw, self._window)
        except BaseException:
            self._glfw.terminate()
            raise

    def cover(self) -> None:
        """Show it above everything."""
        self._is_drawn = True
        if _HAS_X11:
            show_above_all(self._glfw, self._window)
        else:
            self._glfw.show_window(self._window)

    def tend(self) -> None:
        """Answer the window system, and stay above."""
        self._glfw.poll_events()
        if self._is_drawn:
            self.cover()

    def close(self) -> None:
        """Take it away."""
        self._glfw.terminate()


def _check_made(window: Any, monitor: Monitor, glfw: Any) -> None:
    if not window:
        raise DeviceError("projector", f"has no cover on {monitor} ({last_fault(glfw)})")


@dataclass(frozen=True)
class WindowCoverMaker:
    """Makes the cover in the guardian's process."""

    monitor: int | str
    size: tuple[int, int]

    def __call__(self) -> WindowCover:
        """Return a cover that is not drawn."""
        return WindowCover(self.monitor, self.size)
