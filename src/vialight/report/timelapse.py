"""The growing surface of a print as a video, coloured by its deviation, from one fixed place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import FloatArray
from vialight.core.drawing import round_up
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.report.colours import deviation_colours
from vialight.report.views import VIEWS, View, draw
from vialight.store import StoredSurface, list_surfaces, read_surface, staged_file

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

PAPER = (16, 20, 26)
"""The operator's page's own background."""
_INK = (228, 232, 239)
_FRAMES_HZ = 12
_MARGIN = 0.12
_NO_REFERENCE = (190, 200, 214)


def write_timelapse(
    run: str | Path,
    out: str | Path,
    *,
    pixels: int = 640,
    most: int = 120,
    view: View = VIEWS[2],
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Write a run's surfaces as an MP4 that any browser plays.

    Parameters
    ----------
    run
        The run's folder, with ``surfaces``.
    out
        The file to make; it appears whole, or not at all.
    pixels
        Width and height, even.
    most
        Surfaces that are drawn; of more, so many evenly from the first to the last.
    view
        Where from.
    progress
        Called with surfaces done and to do.

    Returns
    -------
    int
        Surfaces drawn.

    Raises
    ------
    InputError
        The run holds no surfaces, one is damaged, PyAV is not installed, or the file cannot be written.
    """
    numbers = list_surfaces(run)
    if not numbers:
        raise InputError(run, "holds no surfaces", accepted="a run that was watched while it printed")
    av = _need_av(out)
    chosen = [numbers[index] for index in np.unique(np.linspace(0, len(numbers) - 1, most).astype(int))]
    last = read_surface(run, numbers[-1])
    stage = _Stage(last, view, pixels)
    with staged_file(out) as unfinished, av.open(str(unfinished), "w", format="mp4") as video:
        stream = video.add_stream("libx264", rate=_FRAMES_HZ, options={"crf": "20", "preset": "veryfast"})
        stream.width = stream.height = pixels
        stream.pix_fmt = "yuv420p"
        for index, number in enumerate(chosen):
            image = stage.picture(read_surface(run, number), f"frame {number + 1}")
            # The end is what people look at: it stays for two seconds.
            for _ in range(1 if index + 1 < len(chosen) else 2 * _FRAMES_HZ):
                video.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            if progress is not None:
                progress(index + 1, len(chosen))
        video.mux(stream.encode(None))
    return len(chosen)


def picture_of(surface: StoredSurface, pixels: int, view: View = VIEWS[2]) -> NDArray[np.uint8]:
    """Draw one surface, filling a square picture, without words.

    Returns
    -------
    numpy.ndarray
        (pixels, pixels, 3) uint8.
    """
    return _Stage(surface, view, pixels).drawn(surface)


class _Stage:
    """A square that shows the same part of space in every picture, on one scale of colours."""

    def __init__(self, last: StoredSurface, view: View, pixels: int) -> None:
        self._view, self._pixels = view, pixels
        seen = last.vertices_mm @ view.axes.T
        low, high = seen.min(axis=0)[:2], seen.max(axis=0)[:2]
        size_mm = float((high - low).max()) * (1 + 2 * _MARGIN)
        self._corner: FloatArray = np.asarray((low + high) / 2 - size_mm / 2, dtype=np.float64)
        self._pixel_mm = size_mm / pixels
        self.limit_mm = (
            round_up(float(np.quantile(np.abs(last.deviation_mm), 0.95))) if len(last.deviation_mm) else None
        )

    def drawn(self, surface: StoredSurface) -> NDArray[np.uint8]:
        picture = np.empty((self._pixels, self._pixels, 3))
        picture[:] = PAPER
        if len(surface.faces):
            mesh = Mesh(surface.vertices_mm.astype(np.float64), surface.faces.astype(np.int64))
            drawing = draw(mesh, self._colours(surface), self._view, self._pixel_mm)
            _lay(picture, drawing.image, self._place(drawing.extent_mm))
        return np.rint(picture).astype(np.uint8)

    def picture(self, surface: StoredSurface, title: str) -> NDArray[np.uint8]:
        from PIL import Image, ImageDraw

        image = Image.fromarray(self.drawn(surface))
        pen = ImageDraw.Draw(image)
        self._write(pen, title)
        return np.asarray(image)

    def _colours(self, surface: StoredSurface) -> NDArray[np.uint8]:
        if self.limit_mm is None or not len(surface.deviation_mm):
            return np.tile(np.array(_NO_REFERENCE, dtype=np.uint8), (len(surface.vertices_mm), 1))
        return deviation_colours(surface.deviation_mm, self.limit_mm)

    def _place(self, extent_mm: tuple[float, float, float, float]) -> tuple[int, int]:
        """Return the row and column of a drawing's upper left corner."""
        left, _, _, top = extent_mm
        column = round((left - self._corner[0]) / self._pixel_mm)
        return self._pixels - round((top - self._corner[1]) / self._pixel_mm), column

    def _write(self, pen: ImageDraw, title: str) -> None:
        from PIL import ImageFont

        font = ImageFont.load_default(size=max(11.0, self._pixels / 36))
        edge = self._pixels // 32
        pen.text((edge, edge), title, fill=_INK, font=font)
        if self.limit_mm is not None:
            width, height, bottom = self._pixels // 3, self._pixels // 64, self._pixels - edge
            ramp = deviation_colours(np.linspace(-1, 1, width), 1.0)
            for column, colour in enumerate(ramp):
                pen.line([(edge + column, bottom - height), (edge + column, bottom)], fill=tuple(colour.tolist()))
            label = f"\N{MINUS SIGN}{self.limit_mm:g} to +{self.limit_mm:g} mm"
            pen.text((edge, bottom - height - edge), label, fill=_INK, font=font)


def _lay(picture: NDArray[Any], image: NDArray[np.uint8], place: tuple[int, int]) -> None:
    """Blend a drawing into a picture where both are."""
    (row, column), (rows, columns) = place, image.shape[:2]
    top, left = max(row, 0), max(column, 0)
    bottom, right = min(row + rows, picture.shape[0]), min(column + columns, picture.shape[1])
    if top >= bottom or left >= right:
        return
    part = image[top - row : bottom - row, left - column : right - column].astype(np.float64)
    opacity = part[..., 3:] / 255
    target = picture[top:bottom, left:right]
    target[:] = target * (1 - opacity) + part[..., :3] * opacity


def _need_av(out: str | Path) -> Any:
    try:
        import av
    except ImportError as error:
        raise InputError(
            out, "video needs the package av, which is not installed", accepted="the surfaces as PLY, without it",
            remedy="pip install 'vialight[video]'",
        ) from error  # fmt: skip
    return av
