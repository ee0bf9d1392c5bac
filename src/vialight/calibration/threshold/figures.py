"""Figures by which a person sees that I_p is right, as PNG; after Figs. S2 and S3 of Orth et al. 2022."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import map_coordinates

from vialight.calibration.threshold.by_rim import RimThreshold
from vialight.calibration.threshold.by_surface import SurfaceThreshold
from vialight.calibration.threshold.circles import Circle
from vialight.core.arrays import FloatArray, Grid, Volume
from vialight.core.drawing import new_figure, png, round_up, scale_bar, style
from vialight.core.mesh import Mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FITTED, _OLD, _KNOWN = "#18348f", "#d98a3d", "#c0201a"
_MISSING = "#b8b8b8"


def heights_png(heights_mm: FloatArray, pixel_mm: float, circle: Circle | None = None) -> bytes:
    """Draw a profilometer's height map, and the circle that was found in it."""
    rows, columns = heights_mm.shape
    extent = (-pixel_mm / 2, (columns - 0.5) * pixel_mm, (rows - 0.5) * pixel_mm, -pixel_mm / 2)
    with style():
        figure = new_figure(6.4, 5.4)
        axis = figure.add_subplot()
        axis.set_facecolor(_MISSING)
        shown = axis.imshow(heights_mm, cmap="viridis", extent=extent, interpolation="nearest")
        figure.colorbar(shown, ax=axis, label="height, mm", shrink=0.85)
        if circle is not None:
            _draw_circle(axis, circle.x_mm, circle.y_mm, circle.radius_mm)
            axis.set_title(f"diameter {circle.diameter_mm:.3f} ± {2 * circle.radius_std_mm:.3f} mm")
        _without_ticks(axis)
        scale_bar(axis, round_up(columns * pixel_mm / 6), "white")
        return png(figure)


def view_from_above_png(density: FloatArray, grid: Grid, circle: tuple[float, float, float] | None = None) -> bytes:
    """Draw a mean along z, (y, x), and a circle (x, y, radius) over it, mm."""
    x, y, half = grid.x_mm, grid.y_mm, grid.voxel_mm / 2
    with style():
        figure = new_figure(6.4, 5.4)
        axis = figure.add_subplot()
        shown = axis.imshow(
            density, cmap="gray", origin="lower", extent=(x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
        )
        figure.colorbar(shown, ax=axis, label="mean density along z, counts per mm", shrink=0.85)
        if circle is not None:
            _draw_circle(axis, *circle)
            axis.set_title(f"centre at x = {circle[0]:.3f}, y = {circle[1]:.3f} mm")
        _without_ticks(axis)
        scale_bar(axis, round_up(float(np.ptp(x)) / 6), "white")
        return png(figure)


def rim_png(found: RimThreshold) -> bytes:
    """Draw the density around the circle and its histogram, with and without the centre fitted, and across the rim."""
    with style():
        figure = new_figure(9.6, 3.3)
        around, histogram, across = figure.subplots(1, 3)
        angles = np.linspace(0, 360, len(found.around), endpoint=False)
        series = (("centre to whole voxels", found.decentred, _OLD), ("centre fitted", found.around, _FITTED))
        for name, values, colour in series:
            around.plot(angles, values, color=colour, linewidth=0.9, label=name)
        around.set_xlabel("angle, deg")
        around.set_ylabel("density, counts per mm")
        around.set_xticks([0, 90, 180, 270, 360])
        bins = np.histogram_bin_edges(np.concatenate([found.around, found.decentred]), bins=60)
        for name, values, colour in series:
            histogram.hist(values, bins=list(bins), color=colour, alpha=0.8, label=f"{name}: ± {values.std():.2f}")
        histogram.axvline(
            found.threshold, color=_KNOWN, linewidth=1, label=f"I_p = {found.threshold:.2f} ± {found.std:.2f}"
        )
        histogram.set_xlabel("density, counts per mm")
        histogram.set_ylabel("points on the circle")
        histogram.set_ylim(top=1.55 * histogram.get_ylim()[1])
        histogram.legend(frameon=False, fontsize=7.5, loc="upper left")
        _draw_rim(across, found)
        return png(figure)


def surface_threshold_png(found: SurfaceThreshold, volume: Volume, surface: Mesh) -> bytes:
    """Draw slices of a density (level and upright) with the surface that was laid on it, and the density on that."""
    grid, half = volume.grid, volume.grid.voxel_mm / 2
    centre = surface.vertices_mm.mean(axis=0)
    with style():
        figure = new_figure(9.6, 3.5)
        level, upright, histogram = figure.subplots(1, 3)
        z, y = (int(np.abs(values - centre[k]).argmin()) for k, values in ((2, grid.z_mm), (1, grid.y_mm)))
        cuts = ((level, volume.density[z], grid.y_mm, "y"), (upright, volume.density[:, y], grid.z_mm, "z"))
        for axis, image, up_mm, name in cuts:
            extent = (grid.x_mm[0] - half, grid.x_mm[-1] + half, up_mm[0] - half, up_mm[-1] + half)
            axis.imshow(image, cmap="gray", origin="lower", extent=extent)
            across, up = ((2, 1), (1, 2))[name == "z"]
            for line in _cut(surface, centre, across):
                axis.plot(line[:, 0], line[:, up], color=_KNOWN, linewidth=0.9)
            axis.set(xlabel="x, mm", ylabel=f"{name}, mm")
        histogram.hist(found.densities, bins=80, color=_FITTED, alpha=0.8)
        histogram.axvline(found.threshold, color=_KNOWN, linewidth=1,
                          label=f"I_p = {found.threshold:.2f} ± {found.std:.2f}")  # fmt: skip
        histogram.set(xlabel="density on the surface, counts per mm", ylabel="points, of equal area")
        histogram.legend(frameon=False, fontsize=7.5)
        return png(figure)


def _cut(surface: Mesh, middle: FloatArray, across: int) -> FloatArray:
    """Return (line, 2, xyz) where the triangles of a surface cross the plane through `middle` across an axis."""
    corners = surface.corners_mm
    above = corners[..., across] > middle[across]
    crossed = above.any(axis=1) & ~above.all(axis=1)
    corners, above = corners[crossed], above[crossed]
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    tip, *base = (corners[np.arange(len(corners)), (alone + k) % 3] for k in range(3))
    height = tip[:, across] - middle[across]
    ends = [tip + (other - tip) * (height / (tip - other)[:, across])[:, None] for other in base]
    return np.stack(ends, axis=1)


def _draw_rim(axis: Axes, found: RimThreshold) -> None:
    seen = found.overhead
    off = np.linspace(-6, 6, 97) * max(found.blur_std_mm, seen.grid.voxel_mm) * 0.75
    phi = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    radius = found.radius_mm + off[:, None]
    at = [
        (seen.circle.y_mm + radius * np.sin(phi) - seen.grid.y_mm[0]) / seen.grid.voxel_mm,
        (seen.circle.x_mm + radius * np.cos(phi) - seen.grid.x_mm[0]) / seen.grid.voxel_mm,
    ]
    axis.plot(found.radius_mm + off, map_coordinates(seen.density, at, order=3).mean(axis=1), color=_FITTED)
    axis.axvline(found.radius_mm, color=_KNOWN, linewidth=1, label="radius of the profile")
    axis.axhline(found.threshold, color=_KNOWN, linewidth=1, linestyle=":", label="I_p")
    axis.set_xlabel("distance from the centre, mm")
    axis.set_ylabel("mean density, counts per mm")
    axis.legend(frameon=False, fontsize=7.5)


def _draw_circle(axis: Axes, x_mm: float, y_mm: float, radius_mm: float) -> None:
    from matplotlib.patches import Circle as Patch

    axis.add_patch(Patch((x_mm, y_mm), radius_mm, fill=False, color=_KNOWN, linewidth=1.2))
    axis.plot([x_mm], [y_mm], "+", color=_KNOWN, markersize=8)


def _without_ticks(axis: Axes) -> None:
    settings: dict[str, Any] = {"xticks": [], "yticks": []}
    axis.set(**settings)
