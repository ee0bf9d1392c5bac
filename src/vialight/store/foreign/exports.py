"""A plan's patterns for printers that show images or play video.

Video is made by PyAV, an optional part (``pip install 'vialight[video]'``): its licence is BSD, but its wheels bring
FFmpeg with x264, which is GPL.  PyAV and Pillow are imported when something is exported.
"""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import InputError
from vialight.core.plan import Plan
from vialight.store.folders import staged_file, staged_folder

ANGLES_FILE = "angles.csv"
_MOST_FRAMES = 1_000_000


def export_png(plan: Plan, folder: str | Path) -> None:
    """Write every pattern as the whole image that the projector shows, 8-bit grey.

    Parameters
    ----------
    plan
        Its rig says how large the image is.
    folder
        For ``pattern_0000_000.000deg.png`` and so on, and ``angles.csv`` with the columns ``file`` and
        ``stage_angle_deg``; all appear together, or nothing does.

    Raises
    ------
    InputError
        The plan's rig has no projector, the patterns do not fit its image, or the folder cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from vialight.core.arrays import Grid
    >>> from vialight.core.config import Rig
    >>> from vialight.core.mesh import Mesh
    >>> from vialight.core.plan import Patterns
    >>> rig = Rig.model_validate({"projector": {
    ...     "distance_mm": 100.0, "pixel_mm": 0.1, "columns": 8, "rows": 6, "axis_column": 3.5, "azimuth_deg": -90.0}})
    >>> patterns = Patterns(np.full((2, 3, 4), 9, np.uint8), np.array([0, np.pi]), 1, 2, 1.0)
    >>> part = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> plan = Plan(patterns, part, np.zeros((1, 2, 2), np.float32), Grid((1, 2, 2), 0.1), rig)
    >>> folder = Path(tempfile.mkdtemp())
    >>> export_png(plan, folder)
    >>> sorted(path.name for path in folder.iterdir())
    ['angles.csv', 'pattern_0000_000.000deg.png', 'pattern_0001_180.000deg.png']
    """
    from PIL import Image

    canvas = _Canvas(plan)
    angles_deg = np.rad2deg(plan.patterns.angles_rad)
    digits = max(4, len(str(len(angles_deg) - 1)))
    names = [f"pattern_{index:0{digits}}_{angle:07.3f}deg.png" for index, angle in enumerate(angles_deg)]
    with staged_folder(folder) as unfinished:
        for index, name in enumerate(names):
            Image.fromarray(canvas.image(index)).save(unfinished / name, compress_level=1)
        rows = [f"{name},{angle!r}" for name, angle in zip(names, angles_deg.tolist(), strict=True)]
        (unfinished / ANGLES_FILE).write_text("\n".join(["file,stage_angle_deg", *rows, ""]), encoding="utf-8")


def export_mp4(
    plan: Plan,
    path: str | Path,
    *,
    frame_rate_hz: float | None = None,
    speed_deg_s: float | None = None,
    turns: float = 1.0,
    quality: Literal["lossless", "compatible"] = "lossless",
) -> int:
    """Write the patterns as the video that a printer plays while its stage turns.

    The stage is taken to be at the first pattern's angle in the middle of the first frame; any other start only turns
    the part about the axis.  Each frame shows the pattern that is due in its middle.

    Parameters
    ----------
    plan
        Its rig says how large the image is.
    path
        The MP4 file to make; it appears whole, or not at all.  An image of odd size gets a black row below or column on
        the right.
    frame_rate_hz
        By default the projector's.
    speed_deg_s
        Turn of the stage, counter-clockwise seen from above if positive; by default the rig's, in its direction.
    turns
        How long the video is.
    quality
        ``"lossless"``: H.264, High 4:4:4 Predictive profile, grey, full range; every level comes back as it is, from
        players on computers (mpv, VLC, FFmpeg).  ``"compatible"``: H.264, High profile, 4:2:0, full range, for decoders
        in hardware; levels come back within a few of 255, more at edges, and a player that ignores the range flag
        stretches contrast by 17 %.

    Returns
    -------
    int
        Count of frames.

    Raises
    ------
    InputError
        PyAV is not installed, the rig has no projector, the patterns do not fit its image, a number is impossible, or
        the file cannot be written.
    """
    av = _need_av(path)
    canvas = _Canvas(plan)
    stage = plan.rig.stage
    rate = _positive("frame_rate_hz", canvas.frame_rate_hz if frame_rate_hz is None else frame_rate_hz)
    speed = stage.speed_deg_s * stage.direction if speed_deg_s is None else speed_deg_s
    count = round(_positive("turns", turns) * 360 / _positive("speed_deg_s", abs(speed)) * rate)
    if not 0 < count <= _MOST_FRAMES:
        raise InputError(
            "turns", f"{turns:g} at {speed:g} deg/s and {rate:g} frames/s make {count} frames",
            accepted=f"1 to {_MOST_FRAMES} frames", remedy="check turns, speed_deg_s and frame_rate_hz",
        )  # fmt: skip
    step_rad = math.radians(speed / rate)
    is_lossless = quality == "lossless"
    with staged_file(path) as unfinished, av.open(str(unfinished), "w", format="mp4") as container:
        options = {"preset": "veryfast", **({"qp": "0"} if is_lossless else {"crf": "4", "profile": "high"})}
        exact_rate = Fraction(rate).limit_denominator(1001)
        stream = container.add_stream("libx264", rate=exact_rate, options=options)
        # Decoders keep colour for squares of 2 x 2 pixels, of grey too: an odd image gets a black row or column.
        padding = [(0, size % 2) for size in canvas.shape]
        stream.height, stream.width = (size + size % 2 for size in canvas.shape)
        stream.pix_fmt = "gray" if is_lossless else "yuvj420p"
        stream.codec_context.color_range = 2  # full: 0 to 255, not the 16 to 235 of television
        for index in range(count):
            due = plan.patterns.index_at(float(plan.patterns.angles_rad[0]) + index * step_rad)
            image = np.pad(canvas.image(due), padding)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
        container.mux(stream.encode(None))
    return count


class _Canvas:
    """The projector's image, black but for the patterns."""

    def __init__(self, plan: Plan) -> None:
        projector = plan.rig.need_projector()
        self._levels = plan.patterns.levels
        self.shape = projector.rows, projector.columns
        self.frame_rate_hz = projector.frame_rate_hz
        _, rows, columns = self._levels.shape
        first = plan.patterns.first_row, plan.patterns.first_column
        end = first[0] + rows, first[1] + columns
        if min(first) < 0 or end[0] > self.shape[0] or end[1] > self.shape[1]:
            raise InputError(
                f"{plan.rig.source} [projector]",
                f"its image has {self.shape[0]} rows and {self.shape[1]} columns, "
                f"the patterns go from row {first[0]}, column {first[1]} to row {end[0] - 1}, column {end[1] - 1}",
                accepted="an image that holds the patterns", remedy="plan again for this projector",
            )  # fmt: skip
        self._part = np.s_[first[0] : end[0], first[1] : end[1]]

    def image(self, index: int) -> NDArray[np.uint8]:
        image = np.zeros(self.shape, dtype=np.uint8)
        image[self._part] = self._levels[index]
        return image


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise InputError(name, f"is {value}", accepted="a positive number")
    return value


def _need_av(path: str | Path) -> ModuleType:
    try:
        import av
    except ImportError as error:
        raise InputError(
            path, "video needs the package av, which is not installed", accepted="images, as PNG, without it",
            remedy="pip install 'vialight[video]'",
        ) from error  # fmt: skip
    return av
