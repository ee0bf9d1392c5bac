"""The curtain: a black window that lies under the projector's, held by a process that nothing else depends on.

When the projector's process dies, its window goes, and what lies under it is seen: not the desktop, but this.  The X
server paints it by itself, and it stays when the print is over or killed: the vial may still be in its light.
"""

from __future__ import annotations

import fcntl
import os
import sys
import tempfile
import time
from pathlib import Path

from vialight.core.errors import VialightError
from vialight.devices.projectors.monitors import full_screen_window, start_glfw
from vialight.devices.projectors.x11 import let_server_paint
from vialight.devices.protocols import DeviceError

_START_TIMEOUT_S = 20.0
_LOOK_EVERY_S = 0.5


def draw_curtain(monitor: int | str, size: tuple[int, int]) -> int:
    """Draw the curtain over a monitor, unless it is drawn; return the process that holds it.

    Escape, typed into its window, takes it away; so does ending that process.

    Raises
    ------
    DeviceError
        It does not come.
    """
    path = _state_path(monitor)
    if (holder := _holder(path)) is not None:
        return holder
    path.unlink(missing_ok=True)
    command = [
        sys.executable,
        "-P",
        "-m",
        "vialight.devices.projectors.curtain",
        str(path),
        repr(monitor),
        *map(str, size),
    ]
    quiet = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0) for number in (0, 1, 2)]
    os.posix_spawn(command[0], command, os.environ, file_actions=quiet, setsid=True)
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if (holder := _holder(path)) is not None:
            return holder
        if path.exists() and (fault := path.read_text(encoding="utf-8")) and not fault.isdigit():
            raise DeviceError("projector", f"has no curtain: {fault}")
        time.sleep(0.02)
    raise DeviceError("projector", f"has no curtain within {_START_TIMEOUT_S:g} s")


def _state_path(monitor: int | str) -> Path:
    """Return the file that the curtain of a monitor holds locked, with its process in it."""
    private = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    named = "".join(letter if letter.isalnum() else "-" for letter in f"{os.environ.get('DISPLAY', '')}-{monitor}")
    return private / f"vialight-curtain-{os.getuid()}-{named}"


def _holder(path: Path) -> int | None:
    try:
        with path.open("r+", encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                content = file.read()
                return int(content) if content.isdigit() else None
    except OSError:
        pass
    return None


def _hold(path: Path, monitor: int | str, size: tuple[int, int]) -> None:
    with path.open("w", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            glfw = start_glfw()
            window, _ = full_screen_window(glfw, monitor, size, "vialight: curtain")
            let_server_paint(glfw, window)
        except VialightError as error:
            path.write_text(str(error), encoding="utf-8")
            return
        file.write(str(os.getpid()))
        file.flush()
        while not glfw.window_should_close(window):
            glfw.wait_events_timeout(_LOOK_EVERY_S)
            if glfw.get_key(window, glfw.KEY_ESCAPE) == glfw.PRESS:
                break
        glfw.terminate()
        path.unlink(missing_ok=True)


if __name__ == "__main__":
    _, place, chosen, columns, rows = sys.argv
    _hold(Path(place), chosen[1:-1] if chosen.startswith("'") else int(chosen), (int(columns), int(rows)))
