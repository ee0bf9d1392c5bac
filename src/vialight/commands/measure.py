"""Measure a surface against its reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vialight.commands.reconstruct import RECONSTRUCTION, SURFACE
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.store import (
    read_json,
    staged_folder,
    write_json,
    write_ply,
)
from vialight.store.foreign.meshes import load_mesh
from vialight.store.provenance import inputs_json, versions
from vialight.system import file_in, read_plain

if TYPE_CHECKING:
    from vialight.metrology import Comparison
    from vialight.report import Figure

METRICS = "metrics.json"
REPORT = "report.html"
_MOST_PICTURES, _MOST_PICTURE_BYTES = 50, 20_000_000
_PNG = b"\x89PNG\r\n"


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
