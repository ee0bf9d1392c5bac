"""The report's own figures, as PNG."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.columns import column_grid, thickness
from vialight.core.drawing import new_figure, png, round_up, scale_bar, style
from vialight.core.mesh import Mesh
from vialight.metrology import Comparison
from vialight.report.colours import colour_ramp, deviation_colours
from vialight.report.views import VIEWS, Drawing, View, draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

_VIEW_PIXELS = 620
"""Along the longest side of any view."""
_STRIP_SHARE = 0.13
_PROJECTION_CELLS = 300
_PROJECTIONS = (
    ("XY, from above", 2, "x", "y"),
    ("XZ, from the front", 1, "x", "z"),
    ("YZ, from the right", 0, "y", "z"),
)


def views_png(comparison: Comparison, limit_mm: float) -> bytes:
    """Draw the print's surface from four sides, coloured by its deviation, all to one scale."""
    mesh = comparison.measured
    colours = deviation_colours(comparison.deviation_mm, limit_mm)
    size_mm = max(float(np.ptp(mesh.vertices_mm @ view.axes[:2].T, axis=0).max()) for view in VIEWS)
    drawings = [draw(mesh, colours, view, size_mm / _VIEW_PIXELS) for view in VIEWS]
    room_mm = _room(drawings)
    with style():
        figure = new_figure(9.6, 2 * (4.05 * room_mm[1] / room_mm[0] + 0.32))
        for index, (view, drawing) in enumerate(zip(VIEWS, drawings, strict=True)):
            _show_view(figure.add_subplot(2, 2, index + 1), view, drawing, room_mm, round_up(size_mm / 10))
        _colour_bar(figure, limit_mm, comparison)
        return png(figure)


def histogram_png(comparison: Comparison, limit_mm: float) -> bytes:
    """Draw how the print's area is spread over deviations."""
    part = comparison.reported.forward
    reach = 1.5 * limit_mm
    if comparison.tolerance is not None and comparison.tolerance.tolerance_mm < 4 * limit_mm:
        reach = max(reach, 1.15 * comparison.tolerance.tolerance_mm)
    low = -reach if part.is_signed else 0.0
    edges = np.linspace(low, reach, 76)
    shares = 100 * part.weights_mm2 / part.weights_mm2.sum()
    heights, _ = np.histogram(np.clip(part.distance_mm, low, reach), edges, weights=shares)
    middles = (edges[1:] + edges[:-1]) / 2
    with style():
        figure = new_figure(8.2, 3.0)
        axis = figure.add_subplot()
        bars = deviation_colours(middles, limit_mm) / 255
        axis.bar(middles, heights, width=np.diff(edges), color=bars, edgecolor="0.45", linewidth=0.4)
        if part.mean_mm is not None:
            axis.axvline(part.mean_mm, color="0.15", linewidth=1, label=f"mean {part.mean_mm:+.3f} mm")
        if comparison.tolerance is not None:
            allowed = comparison.tolerance.tolerance_mm
            for index, end in enumerate((-allowed, allowed)):
                if low <= end <= reach:
                    label = f"tolerance ±{allowed:g} mm" if index else None
                    axis.axvline(end, color="#0a7a3d", linewidth=1.2, linestyle="--", label=label)
        axis.set(xlim=(low, reach), xlabel="deviation of the print's surface, mm", ylabel="share of its area, %")
        axis.spines[["top", "right"]].set_visible(False)
        if axis.get_legend_handles_labels()[0]:
            figure.legend(frameon=False, loc="outside upper right", ncols=2)
        return png(figure)


def projections_png(comparison: Comparison) -> bytes:
    """Draw the three sum projections of print and reference, and what the print has more, all to one scale."""
    bodies = (comparison.measured, comparison.reference)
    corners = np.stack([mesh.bounds_mm for mesh in bodies])
    bounds = np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])
    margin = 0.1 * float((bounds[1] - bounds[0]).max())
    bounds += np.array([[-margin], [margin]])
    pitch = float((bounds[1] - bounds[0]).max()) / _PROJECTION_CELLS
    images = [[_projection(mesh, bounds, axis, pitch) for mesh in bodies] for _, axis, _, _ in _PROJECTIONS]
    thickest = max(float(image.max()) for pair in images for image in pair)
    off = round_up(max(float(np.quantile(np.abs(one - other), 0.97)) for one, other in images))
    bar_mm = round_up(float((bounds[1] - bounds[0]).max()) / 10)
    with style():
        heights = [pair[0].shape[0] for pair in images]
        figure = new_figure(9.6, 9.6 * sum(heights) / (3 * max(pair[0].shape[1] for pair in images)) + 1.4)
        panels = figure.subplots(3, 3, gridspec_kw={"height_ratios": heights})
        for row, ((title, _, right, up), (one, other)) in enumerate(zip(_PROJECTIONS, images, strict=True)):
            extent = _extent(bounds, "xyz".index(right), "xyz".index(up), one.shape, pitch)
            shown: list[tuple[str, FloatArray, dict[str, Any]]] = [
                ("print", one, {"cmap": "magma", "vmin": 0, "vmax": thickest}),
                ("reference", other, {"cmap": "magma", "vmin": 0, "vmax": thickest}),
                ("print less reference", one - other, {"cmap": _colour_map(), "vmin": -off, "vmax": off}),
            ]
            for column, (name, image, look) in enumerate(shown):
                axis = panels[row, column]
                drawn = axis.imshow(image, origin="lower", extent=extent, interpolation="nearest", **look)
                axis.set(title=f"{name}, {title}" if column == 0 else name, xlabel=f"{right}, mm", ylabel=f"{up}, mm")
                scale_bar(axis, bar_mm, "white" if column < 2 else "0.2")
                if row == 2 and column > 0:
                    place = panels[:, :2] if column == 1 else panels[:, 2]
                    label = "thickness, mm" if column == 1 else "difference, mm"
                    figure.colorbar(
                        drawn, ax=place.ravel().tolist(), location="bottom", shrink=0.6, aspect=40, label=label
                    )
        return png(figure)


def _projection(mesh: Mesh, bounds: FloatArray, axis: int, pitch: float) -> FloatArray:
    image = thickness(mesh, column_grid(bounds, axis, pitch))
    # Along y, the next axes cyclically are z and x; the picture has x to the right.
    return image.T if axis == 1 else image


def _extent(
    bounds: FloatArray, right: int, up: int, shape: tuple[int, ...], pitch: float
) -> tuple[float, float, float, float]:
    left, bottom = float(bounds[0, right]), float(bounds[0, up])
    return left, left + shape[1] * pitch, bottom, bottom + shape[0] * pitch


def _room(drawings: list[Drawing]) -> tuple[float, float]:
    """Return width and height in mm that hold any of the views, with a strip below for axes and scale bar."""
    extents = np.array([drawing.extent_mm for drawing in drawings])
    width, height = (float((extents[:, end] - extents[:, end - 1]).max()) for end in (1, 3))
    return max(1.08 * width, 0.7 * height), 1.05 * height + _STRIP_SHARE * max(1.08 * width, 0.7 * height)


def _show_view(axis: Axes, view: View, drawing: Drawing, room_mm: tuple[float, float], bar_mm: float) -> None:
    left, right, bottom, top = drawing.extent_mm
    axis.imshow(drawing.image, extent=drawing.extent_mm, interpolation="antialiased")
    # All views get the same room, so that they are to one scale.
    width, height = room_mm
    strip = _STRIP_SHARE * width
    low = (bottom + top) / 2 - (height - strip) / 2 - strip
    axis.set(xlim=((left + right - width) / 2, (left + right + width) / 2), ylim=(low, low + height))
    axis.set_title(view.title)
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set_color("0.8")
    _triad(axis, view)
    scale_bar(axis, bar_mm, "0.2", on_the_right=True)


def _triad(axis: Axes, view: View) -> None:
    """Draw the object frame's axes as they run in the picture."""
    (left, right), bottom = axis.get_xlim(), axis.get_ylim()[0]
    length = 0.07 * (right - left)
    origin = np.array([left + 0.14 * (right - left), bottom + 0.06 * (right - left)])
    for index, name in enumerate("xyz"):
        tip = length * view.axes[:2, index]
        if np.linalg.norm(tip) < 0.05 * length:
            continue
        arrow = {"arrowstyle": "-|>", "color": "0.2", "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
        axis.annotate("", tuple(origin + tip), tuple(origin), arrowprops=arrow)
        at = origin + tip * (1 + 0.32 * length / np.linalg.norm(tip))
        axis.text(at[0], at[1], name, ha="center", va="center", color="0.2")


def _colour_map() -> ListedColormap:
    from matplotlib.colors import ListedColormap

    return ListedColormap(colour_ramp(), name="deviation")


def _colour_bar(figure: Figure, limit_mm: float, comparison: Comparison) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    scale = ScalarMappable(Normalize(-limit_mm, limit_mm), _colour_map())
    bar = figure.colorbar(scale, ax=figure.axes, location="right", shrink=0.7, aspect=36, extend="both")
    sense = "missing  ←  deviation, mm  →  too much" if comparison.reported.forward.is_signed else "distance, mm"
    bar.set_label(sense)
    bar.outline.set_linewidth(0.5)
