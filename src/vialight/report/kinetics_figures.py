"""Pictures of a print over time: density and dose at a place, and when matter gelled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.drawing import new_figure, png, style
from vialight.core.mesh import Mesh
from vialight.metrology import signed_distance

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FAILURE, _THRESHOLD, _DENSITY, _DOSE = "#b3261e", "0.35", "#1f5fa8", "#b06a00"
_MARGIN_MM = 0.6
_PLANES = (("z", "x", "y"), ("y", "x", "z"), ("x", "y", "z"))
"""The axis that is cut across, and those to the right and up."""


class GelPlanes(NamedTuple):
    """When matter gelled, cut through a place."""

    gel_turns: Float32Array
    """(z, y, x) turns since the light went on; NaN where nothing has."""
    grid: Grid
    at_mm: tuple[float, float, float]
    part: Mesh | None
    """Whose outline is drawn."""
    marks_mm: Sequence[tuple[float, float, float]]
    """Where something failed: drawn in the planes that are near."""


def kinetics_png(
    turn: FloatArray, density: FloatArray, threshold: float, dose: FloatArray | None, dose_unit: str | None,
    failures: Sequence[tuple[str, float]], off_at: float | None,
) -> bytes:  # fmt: skip
    """Draw density and dose against turns.

    Parameters
    ----------
    turn
        (look,) turns since the light went on.
    density
        (look,) counts per mm.
    threshold
        I_p.
    dose, dose_unit
        (look,); None where it is not known.
    failures
        What failed, and at which turn.
    off_at
        Turn at which the light went off for good.
    """
    with style():
        figure = new_figure(8.2, 5.4 if dose is not None else 3.4)
        panels: Any = figure.subplots(2 if dose is not None else 1, 1, sharex=True, squeeze=False)[:, 0]
        panels[0].plot(turn, density, color=_DENSITY, linewidth=1.4)
        panels[0].axhline(threshold, color=_THRESHOLD, linewidth=0.9, linestyle="--")
        panels[0].annotate("I_p, gelled", (0, threshold), xycoords=("axes fraction", "data"), xytext=(4, 3),
                           textcoords="offset points", color=_THRESHOLD)  # fmt: skip
        panels[0].set_ylabel("scattering density, counts per mm\n(mean of the turn before)")
        if dose is not None:
            panels[1].plot(turn, dose, color=_DOSE, linewidth=1.4)
            panels[1].set_ylabel(f"dose, {dose_unit}" if dose_unit and len(dose_unit) < 12 else f"dose\n({dose_unit})")
        for panel in panels:
            panel.spines[["top", "right"]].set_visible(False)
            panel.margins(x=0.02)
            if off_at is not None:
                panel.axvline(off_at, color="0.2", linewidth=0.9)
            for _, at in failures:
                panel.axvline(at, color=_FAILURE, linewidth=0.9, linestyle=":")
        if off_at is not None:
            _say_at(panels[0], off_at, "light off", "0.2", 0.02)
        for number, (what, at) in enumerate(failures[:4]):
            _say_at(panels[0], at, what, _FAILURE, 0.93 - 0.09 * number)
        panels[-1].set_xlabel("turns since the light went on")
        return png(figure)


def _say_at(panel: Axes, at: float, words: str, colour: str, height: float) -> None:
    left, right = panel.get_xlim()
    is_right = at > (left + right) / 2
    panel.annotate(
        words, (at, height), xycoords=("data", "axes fraction"), xytext=(-4 if is_right else 4, 0),
        textcoords="offset points", ha="right" if is_right else "left", color=colour, fontsize=8,
    )  # fmt: skip


def gel_times_png(planes: GelPlanes) -> bytes:
    """Draw, in three planes through a place, after how many turns matter gelled."""
    turns = planes.gel_turns
    gelled = turns[np.isfinite(turns)]
    low, high = (float(np.quantile(gelled, share)) for share in (0.01, 0.99)) if len(gelled) else (0.0, 1.0)
    box = _box(planes)
    spans = [(box[1]["xyz".index(right)] - box[0]["xyz".index(right)]) for _, right, _ in _PLANES]
    tallest = max(box[1]["xyz".index(up)] - box[0]["xyz".index(up)] for _, _, up in _PLANES)
    with style():
        figure = new_figure(9.6, 9.6 * tallest / sum(spans) + 1.3)
        panels = figure.subplots(1, 3, gridspec_kw={"width_ratios": spans})
        drawn = None
        for panel, (across, right, up) in zip(panels, _PLANES, strict=True):
            image, extent = _cut(planes, turns, across)
            drawn = panel.imshow(
                image, origin="lower", extent=extent, cmap="viridis", vmin=low, vmax=max(high, low + 1e-3),
                interpolation="nearest",
            )  # fmt: skip
            panel.set_facecolor("0.94")
            _outline(panel, planes, across)
            _marks(panel, planes, across, right, up)
            ends = [("xyz".index(right), "set_xlim"), ("xyz".index(up), "set_ylim")]
            for axis, setter in ends:
                getattr(panel, setter)(box[0][axis], box[1][axis])
            panel.set(title=f"{across} = {planes.at_mm['xyz'.index(across)]:.2f} mm", xlabel=f"{right}, mm",
                      ylabel=f"{up}, mm", aspect="equal")  # fmt: skip
        assert drawn is not None
        figure.colorbar(drawn, ax=panels.ravel().tolist(), location="bottom", shrink=0.6, aspect=40,
                        label="turns after which it was seen to gel; grey: never")  # fmt: skip
        return png(figure)


def _box(planes: GelPlanes) -> FloatArray:
    """Return the corners of what is worth showing: the part, what has gelled, and the place."""
    z, y, x = np.nonzero(np.isfinite(planes.gel_turns))
    grid = planes.grid
    corners = [np.array(planes.at_mm)]
    if len(x):
        points = np.stack([grid.x_mm[x], grid.y_mm[y], grid.z_mm[z]], axis=1)
        corners += [points.min(axis=0), points.max(axis=0)]
    if planes.part is not None:
        corners += list(planes.part.bounds_mm)
    return np.array([np.min(corners, axis=0) - _MARGIN_MM, np.max(corners, axis=0) + _MARGIN_MM])


def _cut(planes: GelPlanes, turns: Float32Array, across: str) -> tuple[Float32Array, tuple[float, ...]]:
    grid, half = planes.grid, planes.grid.voxel_mm / 2
    axes = {"x": grid.x_mm, "y": grid.y_mm, "z": grid.z_mm}
    index = int(np.abs(axes[across] - planes.at_mm["xyz".index(across)]).argmin())
    image = np.take(turns, index, axis="zyx".index(across))
    right, up = next((right, up) for name, right, up in _PLANES if name == across)
    return image, (axes[right][0] - half, axes[right][-1] + half, axes[up][0] - half, axes[up][-1] + half)


def _outline(panel: Axes, planes: GelPlanes, across: str) -> None:
    """Draw the outline of the part in a plane."""
    if planes.part is None:
        return
    grid = planes.grid
    axes = {"x": grid.x_mm, "y": grid.y_mm, "z": grid.z_mm}
    right, up = next((right, up) for name, right, up in _PLANES if name == across)
    across_mm = planes.at_mm["xyz".index(across)]
    low, high = planes.part.bounds_mm[:, "xyz".index(across)]
    if not low <= across_mm <= high:
        return
    one, other = np.meshgrid(axes[right], axes[up])
    points = np.full((one.size, 3), across_mm)
    points[:, "xyz".index(right)], points[:, "xyz".index(up)] = one.ravel(), other.ravel()
    depth = signed_distance(points, planes.part).reshape(one.shape)
    panel.contour(axes[right], axes[up], depth, levels=[0.0], colors="0.15", linewidths=0.8)


def _marks(panel: Axes, planes: GelPlanes, across: str, right: str, up: str) -> None:
    number, horizontal, vertical = ("xyz".index(name) for name in (across, right, up))
    panel.plot(planes.at_mm[horizontal], planes.at_mm[vertical], marker="+", color="white", markersize=11,
               markeredgewidth=3.2)  # fmt: skip
    panel.plot(planes.at_mm[horizontal], planes.at_mm[vertical], marker="+", color="black", markersize=10,
               markeredgewidth=1.2)  # fmt: skip
    for mark in planes.marks_mm:
        is_near = abs(mark[number] - planes.at_mm[number]) < 2 * _MARGIN_MM
        panel.plot(mark[horizontal], mark[vertical], marker="o", markersize=9, markerfacecolor="none",
                   markeredgecolor=_FAILURE, markeredgewidth=1.6, alpha=1.0 if is_near else 0.35)  # fmt: skip
