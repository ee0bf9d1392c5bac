"""What all figures share, in pages and in calibrations: style, scale bars, PNG, and a picture with its words."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DOTS_PER_INCH = 144
_STYLE: dict[Any, Any] = {"font.size": 9, "axes.titlesize": 9.5, "axes.linewidth": 0.6, "font.family": "DejaVu Sans"}


@contextmanager
def style() -> Iterator[None]:
    """Draw, while it lasts, in the pages' style."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        yield


def new_figure(width_inch: float, height_inch: float) -> Figure:
    """Return an empty figure of its own, without pyplot: nothing global, and no display asked for."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_inch, height_inch), layout="constrained", facecolor="white")


def png(figure: Figure) -> bytes:
    """Return the figure as PNG, the same for the same figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    figure.set_dpi(_DOTS_PER_INCH)
    # `savefig` would draw everything twice, first without a picture, to lay it out.
    canvas: Any = FigureCanvasAgg(figure)  # its methods have no types
    canvas.print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def scale_bar(axis: Axes, length_mm: float, colour: str, *, mm: float = 1.0, on_the_right: bool = False) -> None:
    """Draw a scale bar at the bottom of a picture of equal aspect whose axes count `mm` millimetres a unit."""
    length = length_mm / mm
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    start = right - 0.05 * (right - left) - length if on_the_right else left + 0.05 * (right - left)
    height = bottom + math.copysign(0.045 * (right - left), top - bottom)
    axis.plot([start, start + length], [height, height], color=colour, linewidth=2.5, solid_capstyle="butt")
    gap = 0.02 * (right - left)
    at, side = (start - gap, "right") if on_the_right else (start + length + gap, "left")
    axis.text(at, height, f"{length_mm:g} mm", color=colour, ha=side, va="center_baseline")


@dataclass(frozen=True)
class Picture:
    """A picture with the words that go with it.

    Parameters
    ----------
    name
        Short, for a file name.
    title, caption
        What it is, and what a person should look for in it.
    png
        The picture.
    """

    name: str
    title: str
    caption: str
    png: bytes


def round_up(value: float) -> float:
    """Return the next of 1, 2 or 5 times a power of ten; 0.001 at the least.

    Examples
    --------
    >>> [round_up(value) for value in (0.0, 0.03, 0.2, 7.1)]
    [0.001, 0.05, 0.2, 10.0]
    """
    value = max(value, 1e-3)
    power = 10.0 ** np.floor(np.log10(value) + 1e-9)
    return float(next(round(step * power, 9) for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)))
