"""Monitors, and black full-screen windows on them, through GLFW."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from vialight.core.errors import InputError
from vialight.devices.projectors.randr import scaling_of
from vialight.devices.protocols import DeviceError

_REMEDY = "start it in a graphical session, or set DISPLAY"


@dataclass(frozen=True)
class Monitor:
    """A monitor, or a projector that is connected as one."""

    index: int
    name: str
    columns: int
    rows: int
    refresh_hz: int
    scaling: str = ""
    """What X does to its image, in words; empty where it is shown as it is."""

    def __str__(self) -> str:
        return f"{self.index}: {self.name}, {self.columns} x {self.rows} at {self.refresh_hz} Hz"


def list_monitors() -> list[Monitor]:
    """Return the monitors that are connected.

    Raises
    ------
    DeviceError
        There is no graphical session, or glfw is not installed.
    """
    glfw = start_glfw()
    try:
        return [_described(glfw, index, handle) for index, handle in enumerate(glfw.get_monitors())]
    finally:
        glfw.terminate()


def start_glfw() -> Any:
    """Return the module glfw, started; its faults become `DeviceError` where they are asked for.

    Raises
    ------
    DeviceError
        There is no graphical session, or glfw is not installed.
    """
    try:
        import_module("moderngl")  # so that a part that is missing is told before a window opens
        glfw: Any = import_module("glfw")
    except ImportError as error:
        raise DeviceError(
            "projector", f'driver "window" needs {error.name}', "install it: pip install 'vialight[window]'"
        ) from error
    glfw.ERROR_REPORTING = False
    glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_X11)  # by Wayland, a program may neither choose nor see where it is
    if not glfw.init():
        raise DeviceError("projector", f"no window can be opened ({last_fault(glfw)})", _REMEDY)
    return glfw


def last_fault(glfw: Any) -> str:
    """Return what GLFW last complained of."""
    code, text = glfw.get_error()
    return text.decode(errors="replace") if text else f"code {code}"


def check_size(monitor: Monitor, size: tuple[int, int]) -> None:
    """See that a monitor shows an image of columns and rows pixel by pixel.

    Raises
    ------
    DeviceError
        It would be scaled.

    Examples
    --------
    >>> check_size(Monitor(1, "DLP", 1280, 800, 60), (1280, 800))
    """
    if (monitor.columns, monitor.rows) != size:
        raise DeviceError(
            "projector", f"monitor {monitor} would scale the image: it shows {monitor.columns} x {monitor.rows} "
            f"pixels, the rig's projector has {size[0]} x {size[1]}", "set it to the projector's own mode",
        )  # fmt: skip
    if monitor.scaling:
        remedy = f"xrandr --output {monitor.name} --scale 1x1, or scale 100 % in the settings of the desktop"
        raise DeviceError("projector", f"monitor {monitor} would scale the image: {monitor.scaling}", remedy)


def check_window(glfw: Any, window: Any, size: tuple[int, int]) -> None:
    """See that a full-screen window still fills its monitor, pixel by pixel.

    Raises
    ------
    DeviceError
        It does not.
    """
    if not glfw.get_window_monitor(window):
        raise DeviceError("projector", "its monitor has gone", "connect it, and switch it on")
    if (shown := glfw.get_framebuffer_size(window)) != size:
        raise DeviceError(
            "projector", f"its window has {shown[0]} x {shown[1]} pixels, the rig's projector {size[0]} x {size[1]}",
            "set the scale of the desktop to 100 %, and leave its monitors alone",
        )  # fmt: skip


def chosen_monitor(glfw: Any, monitor: int | str) -> tuple[Any, Monitor]:
    """Return GLFW's handle of a monitor, by index or name, and what it is.

    Raises
    ------
    InputError
        There is no such monitor.
    """
    handles = glfw.get_monitors()
    known = [_described(glfw, index, handle) for index, handle in enumerate(handles)]
    for handle, found in zip(handles, known, strict=True):
        if monitor in (found.index, found.name):
            return handle, found
    raise InputError(
        "[projector.settings]", f"monitor is {monitor!r}", accepted=", ".join(map(str, known)) or "none is connected",
        remedy="connect it, or choose by index or name",
    )  # fmt: skip


def full_screen_window(glfw: Any, monitor: int | str, size: tuple[int, int], title: str) -> tuple[Any, Monitor]:
    """Open a window that fills a monitor, without frame, cursor or screen saver.

    Parameters
    ----------
    monitor
        Its index or its name.
    size
        Columns and rows of the projector.

    Raises
    ------
    InputError
        There is no such monitor.
    DeviceError
        The image would be scaled, or the window cannot be opened.
    """
    handle, found = chosen_monitor(glfw, monitor)
    check_size(found, size)
    mode = glfw.get_video_mode(handle)
    for hint, value in (
        (glfw.CONTEXT_VERSION_MAJOR, 3), (glfw.CONTEXT_VERSION_MINOR, 3),
        (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE), (glfw.OPENGL_FORWARD_COMPAT, True),
        (glfw.RED_BITS, mode.bits.red), (glfw.GREEN_BITS, mode.bits.green), (glfw.BLUE_BITS, mode.bits.blue),
        (glfw.REFRESH_RATE, mode.refresh_rate), (glfw.SRGB_CAPABLE, False), (glfw.SAMPLES, 0),
        (glfw.AUTO_ICONIFY, False),  # it must stay when something else is clicked on
    ):  # fmt: skip
        glfw.window_hint(hint, value)
    window = glfw.create_window(*size, title, handle, None)
    if not window:
        raise DeviceError("projector", f"no window can be opened on {found} ({last_fault(glfw)})")
    glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
    glfw.make_context_current(window)
    glfw.poll_events()
    check_window(glfw, window, size)
    return window, found


def _described(glfw: Any, index: int, handle: Any) -> Monitor:
    name, mode = glfw.get_monitor_name(handle), glfw.get_video_mode(handle)
    columns, rows = mode.size
    name = name.decode() if isinstance(name, bytes) else name
    return Monitor(index, name, columns, rows, mode.refresh_rate, scaling_of(glfw, handle))
