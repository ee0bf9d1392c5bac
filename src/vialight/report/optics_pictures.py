"""Pictures by which a person sees that the optics are right, as in Figs. 3 and 4 of Orth et al. 2022."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from vialight.core.arrays import FloatArray, Volume
from vialight.core.drawing import Picture
from vialight.core.mesh import Mesh
from vialight.optics.viewing import vial_edge_columns
from vialight.tomography.reconstruct import Scan
from vialight.tomography.sinogram import bin_frames, resample, rows_seen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOTS_PER_INCH = 110
SCALE_BAR_MM = 5.0


def optics_pictures(scan: Scan, volume: Volume, threshold: float | None, surface: Mesh | None) -> list[Picture]:
    """Draw a frame, one slice on its way through the reconstruction, and the volume.

    Parameters
    ----------
    scan
        What was reconstructed.
    volume
        Its density.
    threshold, surface
        I_p and the isosurface, where there is one.
    """
    z_mm = _busiest_height(volume)
    pictures = [_frame_picture(scan, z_mm), _slice_picture(scan, volume, z_mm)]
    if threshold is not None and surface is not None:
        pictures.append(_volume_picture(volume, threshold, surface))
    return pictures


def _busiest_height(volume: Volume) -> float:
    """Return the height whose slice has most edges: it shows most of what can go wrong."""
    depth, rows, columns = (size // 4 for size in volume.density.shape)
    if not depth:
        return float(volume.grid.z_mm[0])
    # Means of 4 x 4 x 4 voxels, so that edges count and noise does not.
    blocks = volume.density[: 4 * depth, : 4 * rows, : 4 * columns].reshape(depth, 4, rows, 4, columns, 4)
    coarse = blocks.mean(axis=(1, 3, 5))
    edges = np.abs(np.diff(coarse, axis=1)).sum(axis=(1, 2)) + np.abs(np.diff(coarse, axis=2)).sum(axis=(1, 2))
    return float(volume.grid.z_mm[4 * int(edges.argmax()) + 2])


def _frame_picture(scan: Scan, z_mm: float) -> Picture:
    camera, (rows, columns) = scan.camera, scan.shape
    frame = bin_frames(scan.frames.read(scan.chosen[:1]), scan.binning)[0]
    figure, (axis,) = _figure(1, (8.0, 6.8 * rows / columns + 0.8))
    image = axis.imshow(frame, cmap="gray", vmin=0, vmax=np.percentile(frame, 99.8), interpolation="nearest")
    figure.colorbar(image, ax=axis, label="counts", fraction=0.03, pad=0.02)
    if scan.optics is not None:
        left, right = vial_edge_columns(camera, scan.optics)
        axis.axvline(left, color="tab:cyan", label="edges of the vial")
        axis.axvline(right, color="tab:cyan")
    axis.axvline(camera.axis_column, color="tab:orange", linestyle="--", label="rotation axis")
    axis.axhline(camera.optical_row, color="tab:green", linestyle=":", label="optical axis")
    axis.axhline(camera.optical_row - z_mm / camera.pixel_mm, color="white", linewidth=0.8, label="slice shown below")
    axis.set(xlabel="column", ylabel="row", xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    _scale_bar(axis, 1 / camera.pixel_mm)
    figure.legend(loc="outside lower center", ncols=4, facecolor="gray", fontsize="small")
    angle = np.degrees(scan.angles_rad[0]) % 360
    caption = f"Stage angle {angle:.1f} deg, counts as recorded. " + (
        "The cyan lines must lie on the vial's own edges and the orange one midway between: where they do not, the rig "
        "is wrong."
        if scan.optics is not None
        else "The orange line is the rotation axis as the rig has it."
    )
    return Picture("frame", "A frame, with the vial as the rig has it", caption, _png(figure))


def _slice_picture(scan: Scan, volume: Volume, z_mm: float) -> Picture:
    """Fig. 3 of the paper: raw sinogram, corrected sinogram, slice."""
    beam, grid = scan.beam, volume.grid
    height = np.array([z_mm])
    rows = rows_seen(height, scan.shape[0], scan.camera, scan.optics)
    frames = scan.line_integrals(rows)
    row = min(max(round(scan.camera.optical_row - z_mm / scan.camera.pixel_mm) - rows.start, 0), frames.shape[1] - 1)
    corrected = resample(frames, rows.start, scan.angles_rad, scan.camera, scan.optics, beam, height)[:, :, 0]
    order = np.argsort(scan.angles_rad)
    figure, (raw_axis, axis, slice_axis) = _figure(3, (12.0, 4.2))
    last = scan.shape[1] - 1
    degrees = np.degrees(scan.angles_rad[order])
    raw_axis.imshow(
        frames[order, row], cmap="gray", aspect="auto", extent=(-0.5, last + 0.5, degrees[-1], degrees[0]), vmin=0
    )
    raw_axis.set(xlabel="column", ylabel="stage angle, deg", title="as recorded")
    psi, x_v = np.degrees(beam.psi_rad), beam.virtual_x_mm
    axis.imshow(corrected, cmap="gray", aspect="auto", extent=(x_v[0], x_v[-1], psi[-1], psi[0]), vmin=0)
    axis.set(xlabel="distance from the axis in the resin, mm", ylabel="virtual angle, deg", title="parallel rays")
    density = volume.density[int(np.abs(grid.z_mm - z_mm).argmin())]
    unit = "1/mm" if scan.frames.is_transmission else "counts per mm"
    _show_plan(figure, slice_axis, density, grid.x_mm, grid.y_mm, unit)
    slice_axis.set_title("slice")
    return Picture(
        "slice", f"One slice on its way, z = {z_mm:.2f} mm",
        "Left: one row of all frames. Middle: the same as parallel rays in the resin, where every point of the object "
        "must follow a sine. Right: the slice; doubled or horseshoe-shaped edges mean a wrong axis, blurred outer "
        "edges a wrong radius or index.", _png(figure),
    )  # fmt: skip


def _volume_picture(volume: Volume, threshold: float, surface: Mesh) -> Picture:
    """Fig. 4 of the paper: the volume and its overhead sum beside those of what lies above the threshold."""
    grid = volume.grid
    figure, axes = _figure(4, (14.0, 4.0))
    brightest = volume.density.max(axis=1)
    extent = (grid.x_mm[0], grid.x_mm[-1], grid.z_mm[0], grid.z_mm[-1])
    axes[0].imshow(brightest, cmap="inferno", origin="lower", extent=extent, vmin=0)
    axes[0].set(xlabel="x, mm", ylabel="z, mm", title="density, brightest along y")
    total = volume.density.sum(axis=0) * grid.voxel_mm
    _show_plan(figure, axes[1], total, grid.x_mm, grid.y_mm, "counts")
    axes[1].set_title("density, overhead sum")
    cured, cut = volume.density >= threshold, f"above I_p = {float(f'{threshold:.3g}'):g}"
    axes[2].imshow(cured.sum(axis=1) * grid.voxel_mm, cmap="viridis", origin="lower", extent=extent)
    axes[2].set(xlabel="x, mm", ylabel="z, mm", title=f"{cut}, sum along y")
    _show_plan(figure, axes[3], cured.sum(axis=0) * grid.voxel_mm, grid.x_mm, grid.y_mm, "mm", cmap="viridis")
    axes[3].set_title(f"{cut}, overhead sum")
    size = " x ".join(f"{length:.2f}" for length in surface.extents_mm)
    return Picture(
        "volume", "The volume, and what lies above the threshold",
        f"What lies above the threshold measures {size} mm along x, y, z. Halos or streaks that reach the threshold "
        "would be drawn as surface.", _png(figure),
    )  # fmt: skip


def _figure(count: int, size_inch: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    # A figure of its own, without pyplot: nothing global, and no display asked for.
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inch, layout="constrained")
    return figure, [figure.add_subplot(1, count, index + 1) for index in range(count)]


def _show_plan(
    figure: Figure, axis: Axes, values: FloatArray, x_mm: FloatArray, y_mm: FloatArray, unit: str, cmap: str = "inferno"
) -> None:
    """Show something seen from above: x to the right, y up."""
    extent = (x_mm[0], x_mm[-1], y_mm[0], y_mm[-1])
    image = axis.imshow(values, cmap=cmap, origin="lower", extent=extent, vmin=0, interpolation="nearest")
    figure.colorbar(image, ax=axis, label=unit, fraction=0.045, pad=0.02)
    axis.set(xlabel="x, mm", ylabel="y, mm")
    _scale_bar(axis, 1.0)


def _scale_bar(axis: Axes, units_per_mm: float) -> None:
    """Draw a bar of `SCALE_BAR_MM` in the lower left corner."""
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    x, y = left + 0.05 * (right - left), bottom + 0.06 * (top - bottom)
    axis.plot([x, x + SCALE_BAR_MM * units_per_mm], [y, y], color="white", linewidth=3, solid_capstyle="butt")
    axis.text(
        x + SCALE_BAR_MM * units_per_mm / 2, y + 0.02 * (top - bottom), f"{SCALE_BAR_MM:g} mm",
        color="white", ha="center", va="bottom", fontsize="small",
    )  # fmt: skip


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()
