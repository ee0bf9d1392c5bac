"""The figures of a plan's page, as PNG."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from vialight.core.drawing import new_figure, png, round_up, scale_bar, style
from vialight.core.plan import Patterns, Plan
from vialight.optics.refraction import virtual_to_camera
from vialight.optics.viewing import vial_edge_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage
    from matplotlib.patches import Patch

IN_PART, IN_VOID, OVER, UNDER = "#d9731a", "#3566b8", "#c0202c", "#2a4bb0"
_CURED, _LIQUID, _NOT_JUDGED, _INK = "#b9bec7", "#ffffff", "#ececec", "0.15"
_BINS = 120
_FRAMES = 8
_STRIP = 0.09
"""Room for a scale bar, as a share of a picture's width."""
_SCREEN_GAMMA = 2.2
_WIDTH, _TALLEST = 9.6, 15.0
"""Inches."""


@dataclass(frozen=True)
class Dosed:
    """A dose, with what it is judged by.

    Parameters
    ----------
    dose
        (z, y, x), 1 being what is meant inside the part.
    part, void
        (z, y, x): voxels meant to cure, and to stay liquid; neither where voxels are not judged.
    threshold
        Dose from which on resin cures, as judged best; None if not known.
    void_limit
        Dose that the method allows in the void; None if it knows no such limit.
    """

    dose: Float32Array
    part: BoolArray
    void: BoolArray
    threshold: float | None
    void_limit: float | None


class Cut(NamedTuple):
    """A plane through a volume, with x or y to the right and y or z up."""

    title: str
    axis: Literal[0, 1, 2]
    """Of the volume (z, y, x), across the plane."""
    place: int
    right: str
    up: str

    def of(self, volume: Any) -> Any:
        """Return the plane, first index up."""
        return volume.take(self.place, axis=self.axis)


def cuts_through(dosed: Dosed, plan: Plan) -> tuple[Cut, Cut, Cut]:
    """Choose XY where the part has most voxels, XZ and YZ through its middle, or as near to it as it has any.

    Of slices that are equally full, the one nearest to the middle stands for the rest better than an end would.
    """
    across = [dosed.part.sum(axis=tuple({0, 1, 2} - {axis})) for axis in range(3)]
    z = _nearest_to_middle(across[0], across[0] == across[0].max())
    y, x = (_nearest_to_middle(counts, counts > 0) for counts in across[1:])
    height, depth, side = (
        f"{name} = {float(axis[index]):+.2f} mm".replace("-", "\N{MINUS SIGN}")
        for name, axis, index in zip("zyx", (plan.grid.z_mm, plan.grid.y_mm, plan.grid.x_mm), (z, y, x), strict=True)
    )
    return (
        Cut(f"XY, {height}", 0, z, "x", "y"),
        Cut(f"XZ, {depth}", 1, y, "x", "z"),
        Cut(f"YZ, {side}", 2, x, "y", "z"),
    )


def dose_histogram_png(dosed: Dosed) -> bytes:
    """Draw how dose is spread inside and outside the part: the paper's Fig. S6, and once more with a log scale."""
    groups = [
        ("out of part", dosed.dose[dosed.void], IN_VOID),
        ("in part", dosed.dose[dosed.part], IN_PART),
    ]
    groups = [group for group in groups if group[1].size]
    largest = max([1.0, *(float(values.max()) for _, values, _ in groups)])
    edges = np.linspace(0, 1.02 * largest, _BINS + 1)
    shares = [100 * np.histogram(values, edges)[0] / values.size for _, values, _ in groups]
    fewest = 100 / max([1, *(values.size for _, values, _ in groups)])
    with style():
        figure = new_figure(_WIDTH, 5.4)
        plain, log = figure.subplots(2, 1, sharex=True)
        for axis, floor in ((plain, 0.0), (log, fewest / 2)):
            for (name, _, colour), heights in zip(groups, shares, strict=True):
                shown = np.maximum(heights, floor)
                axis.stairs(shown, edges, baseline=floor, fill=True, color=colour, alpha=0.45, label=name)
                axis.stairs(shown, edges, baseline=floor, color=colour, linewidth=1)
            _show_limits(axis, dosed)
            axis.spines[["top", "right"]].set_visible(False)
            axis.set_xlim(0, edges[-1])
        plain.set(ylabel="share of voxels, %", ylim=(0, None))
        log.set(ylabel="share of voxels, %, log", xlabel="dose in one turn, 1 = meant inside the part")
        log.set_yscale("log")
        log.set_ylim(fewest / 2, 100)
        handles, labels = plain.get_legend_handles_labels()
        figure.legend(handles, labels, frameon=False, loc="outside upper right", ncols=len(labels))
        return png(figure)


def slices_png(dosed: Dosed, plan: Plan) -> bytes:
    """Draw target, dose and what goes wrong at the best threshold, in three planes, all to one scale."""
    cuts = cuts_through(dosed, plan)
    centres = {"x": plan.grid.x_mm, "y": plan.grid.y_mm, "z": plan.grid.z_mm}
    brightest = max(1.0, float(dosed.dose.max()))
    bar_mm = round_up(float(np.ptp(centres["x"])) / 10)
    heights = [len(centres[cut.up]) for cut in cuts]
    widest = max(len(centres[cut.right]) for cut in cuts)
    with style():
        figure = new_figure(_WIDTH, min(_WIDTH * (sum(heights) / (3 * widest) + _STRIP) + 2.6, _TALLEST))
        panels = figure.subplots(3, 3, gridspec_kw={"height_ratios": heights})
        drawn: AxesImage | None = None
        for row, cut in enumerate(cuts):
            right, up = centres[cut.right], centres[cut.up]
            half = plan.grid.voxel_mm / 2
            extent = (right[0] - half, right[-1] + half, up[0] - half, up[-1] + half)
            dose_look: dict[str, Any] = {"cmap": "magma", "vmin": 0, "vmax": brightest}
            shown: list[tuple[str, Any, dict[str, Any], str]] = [
                ("target", cut.of(plan.target), dose_look, "white"),
                ("dose", cut.of(dosed.dose), dose_look, "white"),
                ("at the best threshold", _outcome(dosed, cut), {}, "0.2"),
            ]
            for column, (name, image, look, ink) in enumerate(shown):
                axis = panels[row, column]
                picture = axis.imshow(image, origin="lower", extent=extent, interpolation="nearest", **look)
                drawn = picture if column == 1 else drawn
                # A strip for the scale bar: a part's lowest slices must not hide behind it.
                axis.set_ylim(extent[2] - _STRIP * (extent[1] - extent[0]), extent[3])
                axis.set_facecolor("black" if look else _LIQUID)
                axis.set(title=f"{name}, {cut.title}" if column == 0 else name)
                axis.set(xlabel=f"{cut.right}, mm", ylabel=f"{cut.up}, mm")
                if column > 0:
                    _outline(axis, right, up, cut.of(plan.target), "#5ff0e0" if column == 1 else "0.3")
                scale_bar(axis, bar_mm, ink)
        if drawn is not None:
            figure.colorbar(
                drawn, ax=panels.ravel().tolist(), location="bottom", shrink=0.45, aspect=40,
                label="dose, 1 = meant inside the part",
            )  # fmt: skip
        figure.legend(handles=_outcome_patches(), loc="outside lower center", frameon=False, ncols=5)
        return png(figure)


def filmstrip_png(plan: Plan) -> bytes:
    """Draw patterns over the turn, as the projector shows them, cropped to what is ever lit."""
    patterns = plan.patterns
    indices = filmstrip_indices(len(patterns.levels))
    _, rows, columns = patterns.levels.shape
    across = 2 if columns > 1.8 * rows else 4
    down = -(-len(indices) // across)
    pixel_mm = plan.rig.need_projector().pixel_mm
    bottom, strip = patterns.first_row + rows - 0.5, _STRIP * columns
    each = _WIDTH / across
    with style():
        figure = new_figure(_WIDTH, min(down * (each * (rows / columns + _STRIP) + 0.35) + 0.9, _TALLEST))
        panels = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
        for axis in panels.flat[len(indices) :]:
            axis.set_visible(False)
        for axis, index in zip(panels.flat, indices, strict=False):
            drawn = _show_pattern(axis, patterns, index)
            axis.set(title=angle_words(patterns, index), xlabel="column", ylabel="row")
            axis.set(facecolor="black", ylim=(bottom + strip, bottom - rows))
            axis.label_outer()
            scale_bar(axis, round_up(columns * pixel_mm / 12), "white", mm=pixel_mm)
        figure.colorbar(
            drawn, ax=panels.ravel().tolist(), location="bottom", shrink=0.5, aspect=50,
            ticks=[0, 4, 16, 32, 64, 128, 192, 255], label="grey level of the projector",
        )  # fmt: skip
        return png(figure)


def frame_png(plan: Plan) -> bytes:
    """Draw one whole image of the projector, with the part's and the vial's places in it."""
    patterns, projector = plan.patterns, plan.rig.need_projector()
    camera, optics = projector.as_camera(), plan.rig.writing_optics()
    _, rows, columns = patterns.levels.shape
    whole = (-0.5, projector.columns - 0.5, projector.rows - 0.5, -0.5)
    with style():
        figure = new_figure(_WIDTH, 0.92 * _WIDTH * projector.rows / projector.columns + 0.95)
        axis = figure.add_subplot()
        axis.set_facecolor("black")
        _show_pattern(axis, patterns, 0)
        axis.set(xlim=whole[:2], ylim=whole[2:], xlabel="projector's column", ylabel="projector's row")
        left, top = patterns.first_column - 0.5, patterns.first_row - 0.5
        axis.plot(
            [left, left + columns, left + columns, left, left], [top, top, top + rows, top + rows, top],
            color="#ffd84d", linewidth=0.9, linestyle="--", label="cut shown in the filmstrip",
        )  # fmt: skip
        outline = swept_outline(plan)
        axis.plot(
            outline[:, 0], outline[:, 1], color="#5ff0e0", linewidth=0.9, label="body that the part sweeps as it turns"
        )
        axis.axvline(camera.axis_column, color="#ff7b7b", linewidth=0.9, linestyle=":", label="rotation axis")
        axis.axhline(
            camera.optical_row,
            color="#a9a9ff",
            linewidth=0.9,
            linestyle=(0, (6, 3)),
            label="height of the optical axis",
        )
        if optics is not None:
            for index, edge in enumerate(vial_edge_columns(camera, optics)):
                label = None if index else "outermost light to reach the resin"
                axis.axvline(edge, color="0.65", linewidth=0.9, linestyle="-.", label=label)
        scale_bar(axis, round_up(projector.columns * projector.pixel_mm / 15), "white", mm=projector.pixel_mm)
        figure.legend(loc="outside lower center", ncols=3, facecolor="0.1", labelcolor="white", framealpha=1)
        return png(figure)


def filmstrip_indices(count: int) -> list[int]:
    """Return up to eight patterns, evenly spread over the turn.

    Examples
    --------
    >>> filmstrip_indices(360), filmstrip_indices(4)
    ([0, 45, 90, 135, 180, 225, 270, 315], [0, 1, 2, 3])
    """
    shown = min(count, _FRAMES)
    return [index * count // shown for index in range(shown)]


def angle_words(patterns: Patterns, index: int) -> str:
    """Return the stage angle that a pattern is for, in words."""
    return f"{round(float(np.degrees(patterns.angles_rad[index])), 2):g}°"


def swept_outline(plan: Plan) -> FloatArray:
    """Return the (column, row) corners of what light for the part can cross: the part turned about the axis.

    Light for a voxel at distance r from the axis passes the axis at most r away, at every turn.
    """
    grid, camera, optics = plan.grid, plan.rig.need_projector().as_camera(), plan.rig.writing_optics()
    radius = np.hypot(grid.x_mm, grid.y_mm[:, None])
    reach = np.where(plan.target >= 0.5, radius, -np.inf).max(axis=(1, 2))
    filled = np.isfinite(reach)
    z_mm, s_mm = grid.z_mm[filled], reach[filled] + grid.voxel_mm / 2
    around = np.r_[s_mm, -s_mm[::-1], s_mm[:1]]
    heights = np.r_[z_mm, z_mm[::-1], z_mm[:1]]
    x_c, z_c = (around, heights) if optics is None else virtual_to_camera(around, heights, optics)
    return np.column_stack([x_c / camera.pixel_mm + camera.axis_column, camera.optical_row - z_c / camera.pixel_mm])


def _nearest_to_middle(counts: IntArray, allowed: BoolArray) -> int:
    """Return, of the allowed places, the one nearest to the middle of what is filled."""
    filled, places = np.flatnonzero(counts), np.flatnonzero(allowed)
    if not filled.size:
        return len(counts) // 2
    return int(places[np.abs(places - (filled[0] + filled[-1]) / 2).argmin()])


def _show_limits(axis: Axes, dosed: Dosed) -> None:
    if dosed.part.any() and dosed.void.any():
        least, most = float(dosed.dose[dosed.part].min()), float(dosed.dose[dosed.void].max())
        apart = least > most
        axis.axvspan(
            min(least, most), max(least, most), color="#0a7a3d" if apart else "#a01020", alpha=0.1, linewidth=0,
            label="no voxel gets this dose" if apart else "doses of part and void overlap",
        )  # fmt: skip
    if dosed.threshold is not None:
        axis.axvline(
            dosed.threshold, color=_INK, linewidth=1.2, label=f"best threshold {dosed.threshold:.3f}"
        )  # fmt: skip
    if dosed.void_limit is not None:
        axis.axvline(
            dosed.void_limit, color=IN_VOID, linewidth=1.2, linestyle="--", label=f"void limit {dosed.void_limit:g}"
        )  # fmt: skip


def _outcome(dosed: Dosed, cut: Cut) -> Float32Array:
    """Return (up, right, rgb): what happens to each voxel of a plane at the best threshold."""
    from matplotlib.colors import to_rgb

    dose, part, void = cut.of(dosed.dose), cut.of(dosed.part), cut.of(dosed.void)
    image = np.empty((*dose.shape, 3), np.float32)
    image[:] = to_rgb(_NOT_JUDGED)
    image[void] = to_rgb(_LIQUID)
    image[part] = to_rgb(_CURED)
    if dosed.threshold is not None:
        image[void & (dose >= dosed.threshold)] = to_rgb(OVER)
        image[part & (dose < dosed.threshold)] = to_rgb(UNDER)
    return image


def _outcome_patches() -> list[Patch]:
    from matplotlib.patches import Patch

    entries = (
        (_CURED, "cures, as meant"), (_LIQUID, "stays liquid, as meant"), (OVER, "cures, should not"),
        (UNDER, "should cure, does not"), (_NOT_JUDGED, "not judged"),
    )  # fmt: skip
    return [Patch(facecolor=colour, edgecolor="0.5", linewidth=0.5, label=label) for colour, label in entries]


def _outline(axis: Axes, right: FloatArray, up: FloatArray, target: Float32Array, colour: str) -> None:
    if target.min() < 0.5 <= target.max() and min(target.shape) > 1:
        axis.contour(right, up, target, levels=[0.5], colors=[colour], linewidths=0.7)


def _show_pattern(axis: Axes, patterns: Patterns, index: int) -> AxesImage:
    from matplotlib.colors import PowerNorm

    _, rows, columns = patterns.levels.shape
    left, top = patterns.first_column - 0.5, patterns.first_row - 0.5
    return axis.imshow(
        patterns.levels[index], cmap="gray", norm=PowerNorm(1 / _SCREEN_GAMMA, 0, 255),
        extent=(left, left + columns, top + rows, top), interpolation="antialiased",
    )  # fmt: skip
