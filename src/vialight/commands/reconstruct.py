"""Reconstruct a recording: volume, surface, and the pictures that show whether the optics are right."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vialight.core.config import Rig
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.metrology.surface import isosurface, pieces
from vialight.report.optics_pictures import optics_pictures
from vialight.store import FrameFile, open_frames, staged_folder, write_json, write_stl, write_volume
from vialight.store.provenance import inputs_json, versions
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Progress, Scan, Settings, open_scan, reconstruct

if TYPE_CHECKING:
    from vialight.core.arrays import Volume

RECONSTRUCTION = "reconstruction.json"
SURFACE = "surface.stl"
VOLUME = "volume.zarr"
PICTURES = "pictures"


def reconstruct_recording(
    frames_path: str | Path,
    rig_path: str | Path,
    out: str | Path,
    *,
    settings: Settings | None = None,
    threshold: float | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Reconstruct a recording and draw its surface.

    Parameters
    ----------
    frames_path
        Data Exchange HDF5.
    rig_path
        Rig, TOML.
    out
        Folder for ``volume.zarr``, ``surface.stl`` (where there is a threshold), ``pictures/`` and
        ``reconstruction.json``.
    settings
        How to reconstruct.
    threshold
        Gelation threshold I_p, counts per mm of (binned) pixels; by default the rig's.
    progress
        Called with slices done and to do.

    Returns
    -------
    dict
        What ``reconstruction.json`` holds.

    Raises
    ------
    InputError
        Frames or rig cannot be used, or `out` cannot be written.
    """
    started = time.monotonic()
    settings = settings or Settings()
    rig = load_rig(rig_path)
    with staged_folder(out) as folder, open_frames(frames_path) as frames:
        threshold = _threshold(rig, frames, settings.binning, threshold)
        scan = open_scan(frames, rig, settings)
        volume = reconstruct(scan, settings, progress=progress)
        surface = None if threshold is None else isosurface(volume, threshold)
        pictures = optics_pictures(scan, volume, threshold, surface)
        unit = "1/mm" if frames.is_transmission else "counts per mm"
        write_volume(folder / VOLUME, volume, {"threshold": threshold, "unit": unit})
        if surface is not None:
            write_stl(folder / SURFACE, surface)
        _write_pictures(folder / PICTURES, pictures)
        result = {
            "inputs": inputs_json(frames=frames_path, rig=rig_path),
            "rig": rig.model_dump(mode="json", by_alias=True, exclude_none=True),
            "settings": _settings_json(settings, scan, volume, threshold),
            "volume": _volume_json(volume, unit),
            "surface": None if surface is None else _surface_json(surface),
            "pictures": [
                {"file": f"{PICTURES}/{picture.name}.png", "title": picture.title, "caption": picture.caption}
                for picture in pictures
            ],
            "versions": versions(),
            "elapsed_s": round(time.monotonic() - started, 3),
        }
        write_json(folder / RECONSTRUCTION, result)
    return result


def _threshold(rig: Rig, frames: FrameFile, binning: int, given: float | None) -> float | None:
    """Return the threshold for a recording: as given, or the rig's under the recording's conditions."""
    if given is None:
        return rig.threshold_under(rig.imaged_under(frames.settings, binning))
    if not 0 < given < np.inf:
        raise InputError("--threshold", f"is {given}", accepted="a positive density, counts per mm")
    return given


def _settings_json(settings: Settings, scan: Scan, volume: Volume, threshold: float | None) -> dict[str, Any]:
    return {
        "threshold_counts_per_mm": threshold,
        "voxel_mm": volume.grid.voxel_mm,
        "binning": settings.binning,
        "turn": settings.turn,
        "frames_used": len(scan.chosen),
        "first_frame": int(scan.chosen[0]),
        "last_frame": int(scan.chosen[-1]),
        "filter": settings.filter_name,
        "accurate": settings.accurate,
        "background": "data_white and data_dark" if scan.frames.is_transmission
        else "data_dark" if scan.frames.dark(slice(0, 1)) is not None else "none recorded",
    }  # fmt: skip


def _volume_json(volume: Volume, unit: str) -> dict[str, Any]:
    low, high = float(volume.density.min()), float(volume.density.max())
    return {
        "file": VOLUME,
        "unit": unit,
        "shape_zyx": list(volume.grid.shape),
        "origin_zyx_mm": list(volume.grid.origin_mm),
        "density_min": low,
        "density_max": high,
    }


def _surface_json(surface: Mesh) -> dict[str, Any]:
    return {
        "file": SURFACE,
        "vertices": len(surface.vertices_mm),
        "faces": len(surface.faces),
        "volume_mm3": surface.volume_mm3,
        "area_mm2": surface.area_mm2,
        "bounds_mm": surface.bounds_mm.tolist(),
        "pieces_mm3": pieces(surface)[:20].tolist(),
    }


def _write_pictures(folder: Path, pictures: Sequence[Picture]) -> None:
    folder.mkdir()
    for picture in pictures:
        (folder / f"{picture.name}.png").write_bytes(picture.png)
