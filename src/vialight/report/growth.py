"""How a print grew, as one figure: surfaces and sum projections of some turns, and what was measured over all of them.

After Fig. 5 of Orth et al. 2022.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import FloatArray
from vialight.core.drawing import new_figure, png, round_up, scale_bar, style
from vialight.core.mesh import Mesh
from vialight.report.colours import deviation_colours
from vialight.report.views import VIEWS, Drawing, draw
from vialight.store import (
    HistoryMoment,
    HistoryNumbers,
    StoredSurface,
    list_history,
    list_surfaces,
    read_history,
    read_history_numbers,
    read_surface,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TURNS_SHOWN = 5
_VIEW = VIEWS[2]
_PIXELS = 360
_WIDTH_INCH, _CURVES_INCH = 9.6, 2.6
_LARGEST_RMSE_MM = 1.0
_NO_REFERENCE = (190, 200, 214)
_STOP = "0.2"


@dataclass(frozen=True)
class GrowthFigure:
    """A figure for the report."""

    title: str
    caption: str
    png: bytes


def growth_figure(run: str | Path, turn_s: float, part_mm3: float | None = None) -> GrowthFigure | None:
    """Draw how a print grew.

    Parameters
    ----------
    run
        Its folder, with ``history`` and ``surfaces``.
    turn_s
        Of the stage.
    part_mm3
        Volume that is meant.

    Returns
    -------
    GrowthFigure or None
        None where fewer than two moments are known, or nothing ever gelled.

    Raises
    ------
    InputError
        A file of the history is damaged.
    """
    numbers, moments = list_surfaces(run), list_history(run)
    if not numbers or len(moments) < 2:
        return None
    known = [read_history_numbers(run, number) for number in moments]
    turns, stop = _turns(known, turn_s)
    chosen = [numbers[i] for i in np.unique(np.linspace(0, len(numbers) - 1, _TURNS_SHOWN).astype(int))]
    nearest = [int(np.abs(np.array(moments) - number).argmin()) for number in chosen]
    columns = [
        _Column(float(turns[at]), read_surface(run, number), read_history(run, moments[at]))
        for number, at in zip(chosen, nearest, strict=True)
    ]
    with style():
        heights = _row_heights_inch(columns[-1].surface, len(columns))
        figure = new_figure(_WIDTH_INCH, sum(heights) + _CURVES_INCH)
        parts: Any = figure.subfigures(2, 1, height_ratios=(sum(heights), _CURVES_INCH))
        limit_mm = _show_columns(parts[0], columns, heights)
        _show_curves(parts[1], turns, known, stop, part_mm3)
        image = png(figure)
    measured = f" Colours as above, to ±{limit_mm:g} mm." if limit_mm else ""
    return GrowthFigure(
        "How the print grew",
        f"Top: the surface after some turns.{measured} Below it the sum projections of the scattering density, from "
        "above and from the front, each row to one scale. Bottom: every measurement made while it printed; the line is "
        "where the light went off, and turns go on being counted in the dark. Each is of the turn before it, and "
        "coarser than the figures above, which are of the finished print.",
        image,
    )


@dataclass(frozen=True)
class _Column:
    turn: float
    surface: StoredSurface
    moment: HistoryMoment


def _turns(known: list[HistoryNumbers], turn_s: float) -> tuple[FloatArray, float | None]:
    """Return (moment,) turns since the light went on, and the turn at which it went off, if it did."""
    time_s = np.array([one.time_s for one in known])
    lit_s = np.nan_to_num(np.array([one.lit_s for one in known]))
    most = float(lit_s.max())
    off = int(np.argmax(lit_s >= most - 1e-6))
    dark_s = np.maximum(time_s - time_s[off], 0.0)
    stop = most / turn_s if most > 0 and off < len(known) - 1 else None
    return (lit_s + (dark_s if stop is not None else 0.0)) / turn_s, stop


def _show_columns(figure: Any, columns: list[_Column], heights: list[float]) -> float | None:
    """Draw surfaces and projections; return the end of the colours' scale."""
    panels = figure.subplots(3, len(columns), squeeze=False, height_ratios=heights)
    last = columns[-1].surface
    limit_mm = round_up(float(np.quantile(np.abs(last.deviation_mm), 0.95))) if len(last.deviation_mm) else None
    drawings = [_drawn(column.surface, limit_mm, last) for column in columns]
    extents = np.array([drawing.extent_mm for drawing in drawings if drawing is not None])
    strip = 0.12 * float(extents[:, 3].max() - extents[:, 2].min())  # for the scale bar
    box = (extents[:, 0].min(), extents[:, 1].max(), extents[:, 2].min() - strip, extents[:, 3].max())
    corners = _corners_mm(last)
    brightest = [
        max(float(getattr(column.moment.density, plane).max()) for column in columns) for plane in ("xy", "xz")
    ]
    bar_mm = round_up((box[1] - box[0]) / 6)
    for number, (column, drawing) in enumerate(zip(columns, drawings, strict=True)):
        top = panels[0, number]
        if drawing is not None:
            top.imshow(drawing.image, extent=drawing.extent_mm, interpolation="antialiased")
        top.set(xlim=box[:2], ylim=box[2:], title=f"turn {column.turn:.1f}")
        for row, plane in enumerate(("xy", "xz")):
            panel = panels[row + 1, number]
            _show_sum(panel, column.moment, plane, brightest[row], corners)
        if number == 0:
            for row, name in enumerate(("surface", "sum along z", "sum along y")):
                panels[row, 0].set_ylabel(name)
    for panel in panels.ravel():
        panel.set(xticks=[], yticks=[], aspect="equal")
        panel.spines[:].set_color("0.8")
    scale_bar(panels[0, -1], bar_mm, "0.2", on_the_right=True)
    scale_bar(panels[1, -1], bar_mm, "white", on_the_right=True)
    return limit_mm


def _drawn(surface: StoredSurface, limit_mm: float | None, last: StoredSurface) -> Drawing | None:
    if not len(surface.faces):
        return None
    size_mm = float(np.ptp(last.vertices_mm @ _VIEW.axes[:2].T, axis=0).max())
    mesh = Mesh(surface.vertices_mm.astype(np.float64), surface.faces.astype(np.int64))
    colours: NDArray[np.uint8] = np.tile(np.array(_NO_REFERENCE, np.uint8), (len(surface.vertices_mm), 1))
    if limit_mm is not None and len(surface.deviation_mm):
        colours = deviation_colours(surface.deviation_mm, limit_mm)
    return draw(mesh, colours, _VIEW, size_mm / _PIXELS)


def _row_heights_inch(last: StoredSurface, columns: int) -> list[float]:
    """Return how high the rows of pictures are, each as wide as its column."""
    low, high = _corners_mm(last)
    seen = np.ptp(last.vertices_mm @ _VIEW.axes[:2].T, axis=0)
    width = _WIDTH_INCH / max(columns, 3)
    shapes = (1.12 * float(seen[1] / seen[0]), *((high - low)[[1, 2]] / (high - low)[0]))
    return [width * float(shape) + 0.15 for shape in shapes]


def _corners_mm(last: StoredSurface) -> tuple[FloatArray, FloatArray]:
    """Return the corners, with a margin, of what is worth showing."""
    low, high = last.vertices_mm.min(axis=0), last.vertices_mm.max(axis=0)
    margin = 0.15 * float((high - low).max())
    return np.asarray(low - margin, np.float64), np.asarray(high + margin, np.float64)


def _show_sum(
    panel: Axes, moment: HistoryMoment, plane: str, brightest: float, corners: tuple[FloatArray, FloatArray]
) -> None:
    image = getattr(moment.density, plane)
    rows, columns = image.shape
    half_x = columns * moment.voxel_mm / 2
    middle = 0.0 if plane == "xy" else moment.centre_z_mm
    half_y = rows * moment.voxel_mm / 2
    panel.imshow(
        image, origin="lower", extent=(-half_x, half_x, middle - half_y, middle + half_y), cmap="magma", vmin=0,
        vmax=brightest, interpolation="nearest",
    )  # fmt: skip
    up = 1 if plane == "xy" else 2
    panel.set(xlim=(corners[0][0], corners[1][0]), ylim=(corners[0][up], corners[1][up]))


def _show_curves(
    figure: Any, turns: FloatArray, known: list[HistoryNumbers], stop: float | None, part_mm3: float | None
) -> None:
    panels = figure.subplots(1, 3)
    values = {name: np.array([getattr(one, name) for one in known]) for name in HistoryNumbers.__annotations__}
    order = np.argsort(turns, kind="stable")
    panels[0].plot(turns[order], values["rmse_mm"][order], color="#1f5fa8", label="print to reference")
    panels[0].plot(turns[order], values["reverse_rmse_mm"][order], color="#b06a00", label="reference to print")
    # Before much has gelled, millimetres are missing: that is not what the scale is for.
    panels[0].set(ylabel="RMSE, mm", ylim=(0, _LARGEST_RMSE_MM))
    panels[0].legend(frameon=False, fontsize=7.5, loc="upper left")
    panels[1].plot(turns[order], values["iou"][order], color="#1f5fa8")
    panels[1].set(ylabel="intersection over union", ylim=(0, 1))
    panels[2].plot(turns[order], values["cured_volume_mm3"][order], color="#1f5fa8")
    panels[2].set(ylabel="cured volume, mm³", ylim=(0, None))
    if part_mm3 is not None:
        panels[2].axhline(part_mm3, color="0.35", linewidth=0.9, linestyle="--", label="the part's")
        panels[2].legend(frameon=False, fontsize=7.5, loc="upper left")
    for panel in panels:
        panel.set(xlabel="turns", xlim=(0, float(turns.max()) * 1.03 or 1.0))
        panel.spines[["top", "right"]].set_visible(False)
        if stop is not None:
            panel.axvline(stop, color=_STOP, linewidth=0.9)
    if stop is not None:
        panels[1].annotate("light off", (stop, 0.04), xycoords=("data", "axes fraction"), xytext=(-4, 0),
                           textcoords="offset points", ha="right", color=_STOP, fontsize=8)  # fmt: skip
