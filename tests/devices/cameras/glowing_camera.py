"""A GigE Vision camera that sees what lines on a screen make glow: pictures made beforehand, each of one line.

Arguments: FRAMEBUFFER COLUMNS ROWS GLOW.npz, the last with ``first_columns`` (line,), ``glow`` (line, row, column) and
``dark`` (row, column), of 8 bits.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.cameras.screen_camera import pixels_of, serve

_LIT = 100


def main() -> None:
    framebuffer, columns, rows, made = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), np.load(sys.argv[4])
    screen, first, glow, dark = pixels_of(framebuffer, columns, rows), made["first_columns"], made["glow"], made["dark"]

    def picture(height: int, width: int, exposure_s: float) -> NDArray[np.uint8]:
        lit = np.flatnonzero(screen[rows // 2, ::4] > _LIT)
        seen = glow[int(np.abs(first - lit[0]).argmin())] if 0 < len(lit) < columns / 2 else dark
        image = np.zeros((height, width), np.uint8)
        image[: seen.shape[0], : seen.shape[1]] = seen[:height, :width]
        return image

    serve(picture)
