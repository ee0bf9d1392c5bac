"""Calibrate the scale: how large a pixel is in the plane of the axis, to which every dimension is proportional."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vialight.calibration.edges import track_edges
from vialight.calibration.findings import Finding, Findings
from vialight.calibration.scale.edge_scale import EdgeScale, scale_from_edges
from vialight.calibration.usable_frames import check_unsaturated
from vialight.calibration.writing import Calibrated, check_out, shown_where_refused
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.store import open_frames
from vialight.store.rig_files import load_rig

_SEARCH_COLUMNS = 12.0
_FRAMES = 200


def calibrate_scale(
    frames_path: str | Path,
    rig_path: str | Path,
    out: str | Path,
    *,
    diameter_mm: float | None = None,
    diameter_std_mm: float = 0.02,
) -> Calibrated:
    """Find a pixel's size from the vial's edges and its callipered diameter.

    Parameters
    ----------
    frames_path
        Data Exchange HDF5; nothing need have cured.
    rig_path, out
        The rig to change, and the new one.
    diameter_mm, diameter_std_mm
        Of the vial, by calliper, and its standard uncertainty; by default the rig's.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        The edges do not show, or `out` cannot be written.
    """
    from vialight.calibration.figures import frame_png

    check_out(rig_path, out)
    rig = load_rig(rig_path)
    camera, optics = rig.need_camera(), rig.imaging_optics()
    if optics is None:
        raise InputError(rig_path, 'geometry is "parallel"', accepted="a rig with a vial")
    diameter = 2 * optics.outer_radius_mm if diameter_mm is None else diameter_mm
    if not (np.isfinite(diameter) and 0 < diameter < 2 * optics.distance_mm and 0 <= diameter_std_mm < diameter):
        raise InputError("--diameter-mm", f"is {diameter:g} +- {diameter_std_mm:g}", accepted="a vial's diameter")
    with open_frames(frames_path) as frames:
        chosen = np.arange(0, frames.shape[0], max(1, frames.shape[0] // _FRAMES))
        counts = frames.read(chosen)
    with shown_where_refused(out, lambda: frame_png(counts[0], camera, optics)):
        check_unsaturated(counts[:: max(1, len(counts) // 20)], frames_path)
        edges = track_edges(counts.mean(axis=1, dtype=np.float64), camera, optics, search=_SEARCH_COLUMNS)
        found = scale_from_edges(edges, diameter, diameter_std_mm, camera, optics, frames_path)
    seen = camera.model_copy(update={"pixel_mm": found.pixel_mm, "axis_column": (found.left + found.right) / 2})
    figure = Picture(
        "frame", "A frame, with the edges found", "The outer lines must lie on the vial's own edges, all the way up.",
        frame_png(counts[0], seen, optics),
    )  # fmt: skip
    return Calibrated(
        _findings(found, diameter, diameter_std_mm, diameter_mm is not None), rig_path, frames_path, out,
        figures=[figure],
    )  # fmt: skip


def _findings(found: EdgeScale, diameter_mm: float, std_mm: float, is_given: bool) -> Findings:
    how = f"edges {found.right - found.left:.2f} columns apart, diameter {diameter_mm:g} mm"
    values = [Finding("camera", "pixel_mm", found.pixel_mm, found.std_mm, how)]
    if is_given:
        values.append(Finding("vial", "outer_radius_mm", diameter_mm / 2, std_mm / 2, "by calliper, as given"))
    return Findings(
        "scale", "the vial's edges and its diameter", values,
        ["optical_row is left alone: edges that run along the axis do not tell it."],
        {"edge_columns": [found.left, found.right], "diameter_mm": diameter_mm},
    )  # fmt: skip
