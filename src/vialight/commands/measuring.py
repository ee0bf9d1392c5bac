"""Reconstruct a recording; measure a surface."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from vialight.commands.provenance import inputs_json, versions
from vialight.config import Rig, load_rig
from vialight.diagnostics import Picture, optics_pictures
from vialight.errors import InputError
from vialight.mesh import Mesh, load_mesh
from vialight.pipeline import Progress, Scan, Settings, open_scan, reconstruct
from vialight.store import (
    FrameFile,
    open_frames,
    read_json,
    staged_folder,
    write_json,
    write_ply,
    write_stl,
    write_volume,
)
from vialight.surface import isosurface, pieces
from vialight.system import file_in, read_plain

if TYPE_CHECKING:
    from vialight.arrays import Volume
    from vialight.metrology import Comparison
    from vialight.report import Figure

RECONSTRUCTION = "reconstruction.json"
SURFACE = "surface.stl"
VOLUME = "volume.zarr"
PICTURES = "pictures"
METRICS = "metrics.json"
REPORT = "report.html"
_MOST_PICTURES, _MOST_PICTURE_BYTES = 50, 20_000_000
_PNG = b"\x89PNG\r\n"


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


def measure_surface(
    measured_path: str | Path,
    reference_path: str | Path,
    out: str | Path,
    *,
    align: Literal["rigid", "none"] = "rigid",
    tolerance_mm: float | None = None,
    figures: Sequence[Figure] = (),
) -> dict[str, Any]:
    """Measure a surface against its reference and write the report.

    Parameters
    ----------
    measured_path
        A mesh, or the folder of a reconstruction, whose pictures then go into the report.
    reference_path
        The mesh that was meant.
    out
        Folder for ``metrics.json``, ``deviation.ply`` and ``report.html``.
    align, tolerance_mm
        See `vialight.metrology.compare`.
    figures
        Further pictures for the report, before those of the reconstruction.

    Returns
    -------
    dict
        What ``metrics.json`` holds.

    Raises
    ------
    InputError
        A mesh cannot be used, or `out` cannot be written.
    """
    from vialight.metrology import compare

    measured_path, reference_path = Path(measured_path), Path(reference_path)
    surface_path = _surface_of(measured_path)
    measured, reference = load_mesh(surface_path), load_mesh(reference_path)
    comparison = compare(measured, reference, align=align, tolerance_mm=tolerance_mm)
    result = {
        "inputs": inputs_json(print=surface_path, reference=reference_path),
        "settings": {"align": align, "tolerance_mm": tolerance_mm},
        **comparison.to_json(),
        "versions": versions(),
    }
    with staged_folder(out) as folder:
        write_json(folder / METRICS, result)
        _write_deviation(folder / "deviation.ply", comparison)
        _write_report(folder / REPORT, comparison, result, [*figures, *_read_pictures(measured_path)])
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


def _surface_of(path: Path) -> Path:
    if not path.is_dir():
        return path
    surface = file_in(path, SURFACE)
    if not surface.is_file():
        raise InputError(
            path, f"has no {SURFACE}", accepted="a mesh, or the folder of a reconstruction with a threshold",
            remedy="reconstruct with --threshold",
        )  # fmt: skip
    return surface


def _write_deviation(path: Path, comparison: Comparison) -> None:
    from vialight.report import colour_limit_mm, deviation_colours

    limit_mm = colour_limit_mm(comparison)
    colours = deviation_colours(comparison.deviation_mm, limit_mm)
    write_ply(path, comparison.measured, {"deviation_mm": comparison.deviation_mm}, colours)


def _write_report(path: Path, comparison: Comparison, result: dict[str, Any], pictures: Sequence[Figure]) -> None:
    from vialight.report import Provenance, write_report

    provenance = Provenance(inputs=result["inputs"], settings=result["settings"], versions=result["versions"])
    write_report(path, comparison, provenance=provenance, figures=pictures)


def _read_pictures(folder: Path) -> list[Picture]:
    """Return the pictures of a reconstruction, each a PNG in its folder."""
    if not folder.is_dir() or not (path := file_in(folder, RECONSTRUCTION)).is_file():
        return []
    pictures = read_json(path).get("pictures", [])
    if not isinstance(pictures, list) or len(pictures) > _MOST_PICTURES:
        raise InputError(path, "its pictures are no list of a few", remedy="reconstruct again")
    try:
        return [_picture(folder, str(one["file"]), str(one["title"]), str(one["caption"])) for one in pictures]
    except (KeyError, TypeError, ValueError, OSError) as error:
        raise InputError(
            path, f"its pictures cannot be used ({type(error).__name__}: {error})", remedy="reconstruct again"
        ) from error


def _picture(folder: Path, name: str, title: str, caption: str) -> Picture:
    png = read_plain(file_in(folder, name), _MOST_PICTURE_BYTES)
    if not png.startswith(_PNG):
        raise ValueError(f"{name} is no PNG")
    return Picture(Path(name).stem, title, caption, png)
