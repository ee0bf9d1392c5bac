"""A projector that shows a window: patterns bit for bit, on the refresh of its monitor."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.config import Projector as ProjectorTable
from vialight.core.config import ProjectorSettings
from vialight.core.errors import InputError
from vialight.devices.projectors.levels import FULL, light_of_levels, read_flat_field, sent_levels
from vialight.devices.projectors.monitors import check_window, full_screen_window, start_glfw
from vialight.devices.protocols import DeviceError
from vialight.store import read_plan

_TRIED_REFRESHES = 20
_LARGEST_REFRESH_HZ = 500.0
"""A monitor that seems to be faster has no vertical sync."""
_GL_DITHER = 0x0BD0
_VERTICES = """
#version 330
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }
"""
_LEVELS = """
#version 330
uniform usampler2D pattern;
uniform ivec2 corner;
uniform int rows;
out vec4 colour;
void main() {
    ivec2 pixel = ivec2(int(gl_FragCoord.x), rows - 1 - int(gl_FragCoord.y)) - corner;
    colour = vec4(vec3(float(texelFetch(pattern, pixel, 0).r) / 255.0), 1.0);
}
"""


class WindowScreen:
    """A full-screen window, black but for the pattern that it is told to show.

    Parameters
    ----------
    monitor
        Its index or its name.
    size
        Columns and rows of the projector.
    patterns
        (angle, row, column) levels.
    corner
        Row and column of the projector at which patterns begin.

    Attributes
    ----------
    has_sync : bool
        Whether images change with the monitor's refresh.

    Raises
    ------
    InputError
        There is no such monitor, or the patterns do not fit the projector.
    DeviceError
        The image would be scaled or changed, or there is no window to be had.
    """

    def __init__(
        self, monitor: int | str, size: tuple[int, int], patterns: NDArray[np.uint8], corner: tuple[int, int]
    ) -> None:
        _check_room(size, patterns.shape[1:], corner)
        self._size, self._corner, self._shape = size, corner, patterns.shape[1:]
        self._glfw = start_glfw()
        try:
            self._window, found = full_screen_window(self._glfw, monitor, size, "vialight: projector")
            self._set_up()
            self._textures = [self._texture(pattern) for pattern in patterns]
            measured_hz = self._measured_refresh_hz()
        except BaseException:
            self._glfw.terminate()
            raise
        self.has_sync = measured_hz < _LARGEST_REFRESH_HZ
        self.refresh_hz = measured_hz if self.has_sync else float(found.refresh_hz or 60)

    def show(self, pattern: int | None) -> None:
        """Show a pattern, or black; returns when it is on the screen."""
        self._draw(None if pattern is None else self._textures[pattern])
        self._glfw.swap_buffers(self._window)
        self._context.finish()  # without, it returns a refresh before

    def tend(self) -> None:
        """Answer the window system; `DeviceError` where the window is not what it was."""
        self._glfw.poll_events()
        if self._glfw.window_should_close(self._window):
            raise DeviceError("projector", "its window was closed")
        check_window(self._glfw, self._window, self._size)

    def close(self) -> None:
        """Take the window away."""
        self._glfw.terminate()

    def _set_up(self) -> None:
        import moderngl

        try:
            self._context: Any = moderngl.create_context(require=330)
        except Exception as error:  # moderngl's own has no better name
            raise DeviceError("projector", f"has no OpenGL 3.3 ({error})", "install the graphics driver") from error
        self._context.disable(moderngl.BLEND | moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._context.disable_direct(_GL_DITHER)
        self._program: Any = self._context.program(vertex_shader=_VERTICES, fragment_shader=_LEVELS)
        self._triangle: Any = self._context.vertex_array(self._program, [])
        self._program["rows"] = self._size[1]
        self._program["corner"] = self._corner[::-1]
        self._glfw.swap_interval(1)
        self._check_exact()

    def _texture(self, levels: NDArray[np.uint8]) -> Any:
        rows, columns = levels.shape
        return self._context.texture(
            (columns, rows), 1, np.ascontiguousarray(levels).tobytes(), alignment=1, dtype="u1"
        )

    def _draw(self, texture: Any | None) -> None:
        screen = self._context.screen
        screen.use()
        screen.viewport = (0, 0, *self._size)
        self._context.clear(0.0, 0.0, 0.0, 1.0)
        if texture is not None:
            (row, column), (rows, columns) = self._corner, self._shape
            screen.viewport = (column, self._size[1] - row - rows, columns, rows)
            texture.use()
            self._triangle.render(mode=self._context.TRIANGLES, vertices=3)

    def drawn(self) -> NDArray[np.uint8]:
        """Return (row, column, colour) of what has been drawn and not yet shown."""
        columns, rows = self._size
        content = self._context.screen.read(viewport=(0, 0, columns, rows), components=3, alignment=1)
        return np.frombuffer(content, np.uint8).reshape(rows, columns, 3)[::-1]

    def _check_exact(self) -> None:
        """Refuse a screen that does not take all 256 levels as they are."""
        ramp = np.resize(np.arange(256, dtype=np.uint8), self._shape)
        texture = self._texture(ramp)
        self._draw(texture)
        (row, column), (rows, columns) = self._corner, self._shape
        drawn = self.drawn()[row : row + rows, column : column + columns]
        texture.release()
        if off := int((drawn != ramp[..., None]).any(axis=-1).sum()):
            raise DeviceError("projector", f"changes the levels of {off} of {ramp.size} pixels",
                              "set the display to 8 bits a colour (24 bit)")  # fmt: skip

    def _measured_refresh_hz(self) -> float:
        """Return how often a second black can be shown."""
        self.show(None)
        begin = time.monotonic()
        for _ in range(_TRIED_REFRESHES):
            self.show(None)
        return _TRIED_REFRESHES / max(time.monotonic() - begin, 1e-6)


@dataclass(frozen=True)
class WindowMaker:
    """Makes the window in the process in which it lives, with a plan's patterns as they are to be sent.

    Parameters
    ----------
    table
        The rig's.
    plan_path
        For the patterns; without, there is one, and it is white.
    folder
        In which paths of the rig begin.
    """

    table: ProjectorTable
    plan_path: Path | None
    folder: Path

    def __call__(self) -> WindowScreen:
        """Return a screen that is black."""
        settings, size = self.table.settings or ProjectorSettings(), (self.table.columns, self.table.rows)
        if self.plan_path is None:
            return WindowScreen(settings.monitor, size, np.full((1, *size[::-1]), FULL, np.uint8), (0, 0))
        patterns = read_plan(self.plan_path).patterns
        corner = (patterns.first_row, patterns.first_column)
        _check_room(size, patterns.levels.shape[1:], corner)
        light, flat = light_of_levels(settings.linearisation), None
        if settings.flat_field is not None:
            whole = read_flat_field(self.folder / settings.flat_field, size[::-1])
            (row, column), (rows, columns) = corner, patterns.levels.shape[1:]
            flat = whole[row : row + rows, column : column + columns]
        sent = np.stack([sent_levels(planned, light, flat) for planned in patterns.levels])
        return WindowScreen(settings.monitor, size, sent, corner)


def _check_room(size: tuple[int, int], shape: tuple[int, ...], corner: tuple[int, int]) -> None:
    """Refuse patterns that reach beyond the projector's image."""
    ends = [begin + length for begin, length in zip(corner, shape, strict=True)]
    if min(corner) < 0 or ends[0] > size[1] or ends[1] > size[0]:
        raise InputError(
            "plan", f"its patterns take rows {corner[0]} to {ends[0] - 1}, columns {corner[1]} to {ends[1] - 1}",
            accepted=f"the projector's {size[1]} rows and {size[0]} columns", remedy="plan for this rig",
        )  # fmt: skip
