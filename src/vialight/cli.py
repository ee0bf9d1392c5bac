"""The command line: parsing and wiring only."""

from __future__ import annotations

import json
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from vialight.errors import InputError, VialightError, VialightWarning

if TYPE_CHECKING:
    from types import FrameType

BAD_INPUT = 2
FAILED = 1

# Heavy modules are imported inside the commands, so that --help answers at once.

_FOLDER = click.Path(file_okay=False, path_type=Path)
_FILE = click.Path(path_type=Path)
_as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")
_rig = click.option("--rig", required=True, type=_FILE, help="The rig, TOML.")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="vialight")
def main() -> None:
    """Measure tomographic volumetric prints while they are still in the vial."""


@main.command()
@click.argument("frames", type=_FILE)
@_rig
@click.option("--out", required=True, type=_FOLDER, help="Folder for volume.zarr, surface.stl, reconstruction.json.")
@click.option("--threshold", type=float, help="Gelation threshold I_p, counts per mm. [default: the rig's]")
@click.option("--voxel", type=float, help="Edge of a voxel, mm. [default: half a pixel]")
@click.option("--bin", "binning", type=int, default=1, show_default=True, help="Sum N x N pixels first.")
@click.option("--turn", type=int, help="Which turn of the recording, from 1. [default: the last full one]")
@click.option(
    "--filter", "filter_name", type=click.Choice(["ram-lak", "shepp-logan", "cosine", "hann"]), default="cosine",
    show_default=True, help="Ramp filter, from sharpest to smoothest.",
)  # fmt: skip
@click.option("--accurate", is_flag=True, help="Backproject along the rays' climb in z too: for tall parts.")
@_as_json
def reconstruct(
    frames: Path,
    rig: Path,
    out: Path,
    threshold: float | None,
    voxel: float | None,
    binning: int,
    turn: int | None,
    filter_name: Literal["ram-lak", "shepp-logan", "cosine", "hann"],
    accurate: bool,
    as_json: bool,
) -> None:
    """Reconstruct a print from camera FRAMES (HDF5, Data Exchange).

    \b
    Example:
      vialight reconstruct frames.h5 --rig rig.toml --threshold 100 --out print
    """
    with _faults_told():
        from vialight.commands import reconstruct_recording
        from vialight.pipeline import Settings

        settings = Settings(voxel, binning, turn, accurate, filter_name)
        with _progress("slices") as progress:
            result = reconstruct_recording(frames, rig, out, settings=settings, threshold=threshold, progress=progress)
        _show(result, as_json, lambda: _reconstruction_lines(result, out))


@main.command()
@click.argument("surface", type=_FILE)
@click.option("--reference", required=True, type=_FILE, help="The mesh that was meant (STL, PLY, OBJ, 3MF; mm).")
@click.option("--out", required=True, type=_FOLDER, help="Folder for metrics.json, deviation.ply, report.html.")
@click.option(
    "--align", type=click.Choice(["rigid", "none"]), default="rigid", show_default=True,
    help="Lay the print on its reference first, without scaling; both poses are reported.",
)  # fmt: skip
@click.option("--tolerance", type=float, help="Largest deviation allowed, mm: gives a verdict.")
@_as_json
def measure(
    surface: Path, reference: Path, out: Path, align: Literal["rigid", "none"], tolerance: float | None, as_json: bool
) -> None:
    """Measure a SURFACE (a mesh, or the folder of a reconstruction) against its reference.

    \b
    Example:
      vialight measure print --reference part.stl --tolerance 0.1 --out print
    """
    with _faults_told():
        from vialight.commands import measure_surface

        result = measure_surface(surface, reference, out, align=align, tolerance_mm=tolerance)
        _show(result, as_json, lambda: _measurement_lines(result, out))


@main.command()
@click.option(
    "--out", type=_FOLDER, default=Path("vialight-demo"), show_default=True, help="Folder for everything it makes."
)
@_as_json
def demo(out: Path, as_json: bool) -> None:
    """Reconstruct and measure a sample print that comes with vialight.

    \b
    Example:
      vialight demo --out demo
    """
    with _faults_told():
        from importlib.resources import as_file, files

        from vialight.commands import measure_surface, reconstruct_recording

        with as_file(files("vialight") / "sample") as sample, _progress("slices") as progress:
            first = reconstruct_recording(sample / "frames.h5", sample / "rig.toml", out, progress=progress)
            second = measure_surface(out, sample / "part.stl", out, tolerance_mm=0.1)
        lines = [*_reconstruction_lines(first, out), "", *_measurement_lines(second, out)]
        _show({"reconstruction": first, "measurement": second}, as_json, lambda: lines)


@contextmanager
def _faults_told() -> Iterator[None]:
    """Tell errors and warnings in a line each, and end with the exit code that belongs to them."""

    def stop(number: int, frame: FrameType | None) -> None:
        sys.exit(128 + number)

    # An exception, so that what is half-written is cleared away.
    signal.signal(signal.SIGTERM, stop)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", VialightWarning)
            yield
    except VialightError as error:
        click.echo(f"vialight: {error}", err=True)
        sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)
    except MemoryError:
        click.echo("vialight: not enough memory; choose a larger --voxel or --bin", err=True)
        sys.exit(FAILED)
    finally:
        for warning in caught:
            if issubclass(warning.category, VialightWarning):
                click.echo(f"vialight: warning: {warning.message}", err=True)


@contextmanager
def _progress(unit: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a progress callback that draws a bar where stderr is a terminal."""
    from tqdm import tqdm

    with tqdm(unit=unit, disable=None, leave=False) as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield advance


def _show(result: dict[str, Any], as_json: bool, lines: Callable[[], list[str]]) -> None:
    click.echo(json.dumps(result, indent=2) if as_json else "\n".join(lines()))


def _reconstruction_lines(result: dict[str, Any], out: Path) -> list[str]:
    settings, volume, surface = result["settings"], result["volume"], result["surface"]
    shape = " x ".join(str(count) for count in volume["shape_zyx"])
    lines = [
        f"frames used     {settings['frames_used']}, binning {settings['binning']}",
        f"volume          {shape} voxels of {settings['voxel_mm']:g} mm, "
        f"{volume['density_min']:.4g} to {volume['density_max']:.4g} {volume['unit']}",
    ]
    if surface is None:
        lines.append("surface         not drawn: no threshold; give --threshold or [resin] threshold in the rig")
    else:
        low, high = surface["bounds_mm"]
        size = " x ".join(f"{end - start:.3f}" for start, end in zip(low, high, strict=True))
        lines.append(f"surface         {size} mm, {surface['volume_mm3']:.2f} mm^3, {surface['faces']} faces")
    return [*lines, f"written to      {out} in {result['elapsed_s']:.1f} s"]


def _measurement_lines(result: dict[str, Any], out: Path) -> list[str]:
    poses = [(name, result[key]) for name, key in (("as placed", "as_placed"), ("aligned", "aligned")) if result[key]]
    rows = [
        ("RMSE", "rmse_mm", "mm"), ("RMSE, of the largest dimension", "rmse_percent", "%"),
        ("standard deviation", "std_mm", "mm"), ("mean", "mean_mm", "mm"), ("95 % within", "p95_mm", "mm"),
        ("RMSE, reference to print", "reverse_rmse_mm", "mm"), ("largest deviation", "hausdorff_mm", "mm"),
        ("intersection over union", "iou", ""), ("volume error", "volume_error_percent", "%"),
    ]  # fmt: skip
    lines = [" " * 34 + "".join(f"{name:>12}" for name, _ in poses)]
    for title, key, unit in rows:
        values = "".join(f"{pose[key]:12.4f}" if pose[key] is not None else f"{'-':>12}" for _, pose in poses)
        lines.append(f"{title:<34}{values} {unit}".rstrip())
    if result["tolerance"]:
        verdict = "passed" if result["tolerance"]["passed"] else "FAILED"
        lines.append(f"tolerance {result['tolerance']['tolerance_mm']:g} mm: {verdict}")
    return [*lines, f"report: {out / 'report.html'}"]
