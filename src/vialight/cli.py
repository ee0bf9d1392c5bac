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

    from vialight.commands import GivenProjections, PlanSettings

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
@click.argument("part", type=_FILE, required=False)
@click.option("--rig", required=True, type=_FILE, help="The rig, TOML, with a projector and the resin's writing index.")
@click.option("--out", type=_FILE, help="The plan, HDF5; .json and .html of the same name come beside it.")
@click.option("--score", type=_FILE, help="Judge this plan's patterns under --rig instead of computing new ones.")
@click.option(
    "--method", type=click.Choice(["object-space", "osmo", "gradient", "normalised"]), default="object-space",
    show_default=True, help="normalised is the paper's.",
)  # fmt: skip
@click.option("--passes", type=int, help="Of the method. [default: its own number]")
@click.option("--angles", type=int, default=360, show_default=True, help="Patterns in a turn.")
@click.option("--voxel", type=float, help="Edge of a voxel, mm. [default: the projector's pixel]")
@click.option("--coverage", is_flag=True, help="Count voxels at the surface by the share of them that is inside.")
@click.option("--flat", is_flag=True, help="Let light stay in its slice: quicker, wrong at the flat ends of a part.")
@click.option(
    "--void-limit", type=float, default=0.85, show_default=True, help="Dose that a void may get; the part: 1."
)
@click.option("--projector-blur", type=float, default=0.0, help="Standard deviation in the resin, mm, to be undone.")
@click.option("--diffusion", type=float, default=0.0, help="Standard deviation of what diffuses, mm, to be undone.")
@click.option("--background", type=float, default=0.5, show_default=True, help="Of normalised: level B of the void.")
@click.option("--clip", type=float, help="Of normalised: level that projections are raised to. [default: B]")
@click.option("--bound-void", is_flag=True, help="Of normalised: take the void's target as an upper bound.")
@click.option("--rotate", type=(float, float, float), default=(0, 0, 0), help="About x, then y, then z, degrees.")
@click.option("--scale", type=float, help="Scale the part; 1 says that its size is meant.")
@click.option("--fit", is_flag=True, help="Scale the part to the largest that fits.")
@click.option("--no-centre", is_flag=True, help="Leave the part where its file has it.")
@click.option("--projections", type=_FILE, help="Take these instead of computing any: .npy, .npz, TIFF, folder of PNG.")
@click.option("--axes", help="Of --projections: angle, row, column in the array's order, such as column,angle,-row.")
@click.option("--span", type=float, help="Of --projections: degrees over which they are even, 180 or 360.")
@click.option("--projection-angles", type=_FILE, help="Of --projections, in place of --span: a file of degrees.")
@click.option("--projection-pixel", type=float, help="Of --projections: mm in the part. [default: the voxel]")
@click.option("--save-state", type=_FILE, help="Save where the method stands at the end, to --resume from.")
@click.option("--resume", type=_FILE, help="Go on from a saved state.")
@_as_json
def plan(part: Path | None, rig: Path, out: Path | None, score: Path | None, as_json: bool, **options: Any) -> None:
    """Compute the light patterns that print a PART (STL, PLY, OBJ, 3MF; mm).

    Ctrl-C ends the computation with the best patterns so far; a second one gives up.

    \b
    Example:
      vialight plan part.stl --rig printer.toml --out plan.h5
      vialight plan --score plan.h5 --rig other.toml
    """
    with _faults_told():
        from vialight.commands import plan_part, score_plan

        if score is not None:
            result = score_plan(score, rig)
            _show(result, as_json, lambda: _plan_lines(result, None))
            return
        if part is None or out is None:
            raise click.UsageError("give a PART and --out, or --score PLAN.h5")
        with _progress("passes") as progress, _stopped_by_interrupt() as keep_going:
            result = plan_part(
                part, rig, out, settings=_plan_settings(options), given=_given_projections(options),
                resume=options["resume"], save_state=options["save_state"], progress=progress, keep_going=keep_going,
            )  # fmt: skip
        _show(result, as_json, lambda: _plan_lines(result, out))


def _plan_settings(options: dict[str, Any]) -> PlanSettings:
    from vialight.commands import PlanSettings

    return PlanSettings(
        method=options["method"], passes=options["passes"], angles=options["angles"], voxel_mm=options["voxel"],
        coverage=options["coverage"], void_limit=options["void_limit"], climbing=not options["flat"],
        projector_blur_mm=options["projector_blur"], diffusion_mm=options["diffusion"],
        background=options["background"], clip_level=options["clip"], bound_void=options["bound_void"],
        rotate_deg=options["rotate"], scale=options["scale"], fit=options["fit"], centre=not options["no_centre"],
    )  # fmt: skip


def _given_projections(options: dict[str, Any]) -> GivenProjections | None:
    from vialight.commands import GivenProjections

    if options["projections"] is None:
        return None
    if options["axes"] is None:
        raise click.UsageError("--projections needs --axes, such as --axes angle,row,column")
    return GivenProjections(
        options["projections"], options["axes"], options["projection_angles"], options["span"],
        options["projection_pixel"],
    )  # fmt: skip


@contextmanager
def _stopped_by_interrupt() -> Iterator[Callable[[], bool]]:
    """Yield a question that the first Ctrl-C answers with no; the second one interrupts as ever."""
    asked_to_stop = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal asked_to_stop
        asked_to_stop = True
        click.echo("stopping after this pass with the best so far", err=True)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: not asked_to_stop
    finally:
        signal.signal(signal.SIGINT, before)


@main.command()
@click.argument("plan", type=_FILE)
@click.option("--rig", required=True, type=_FILE, help="The printer as it is: TOML, or orth2022-145, orth2022-190.")
@click.option("--resin", required=True, help="What is in its vial: DUDMA, BPAGDA, or TOML.")
@click.option("--out", required=True, type=_FOLDER, help="Folder for frames.h5, truth.stl, rig.toml, run.json.")
@click.option("--turns", type=float, help="Light off after so many. [default: when as much will gel as was meant]")
@click.option("--dose", type=float, help="Light off after this dose in the part, mJ/cm^2.")
@click.option("--voxel", type=float, default=0.1, show_default=True, help="Edge of a voxel of resin, mm.")
@click.option("--bin", "binning", type=int, default=1, show_default=True, help="Sum N x N of the camera's pixels.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the noise.")
@_as_json
def simulate(
    plan: Path, rig: Path, resin: str, out: Path, turns: float | None, dose: float | None, voxel: float, binning: int,
    seed: int, as_json: bool,
) -> None:  # fmt: skip
    """Print a PLAN on the digital twin and record it.

    \b
    Example:
      vialight simulate plan.h5 --rig orth2022-190 --resin DUDMA --out run
    """
    with _faults_told():
        from vialight.commands.simulating import simulate_print
        from vialight.twin import TwinSettings

        settings = TwinSettings(binning=binning, seed=seed)
        with _progress("s") as progress:
            result = simulate_print(
                plan, rig, resin, out, turns=turns, dose_mj_per_cm2=dose, voxel_mm=voxel, settings=settings,
                progress=progress,
            )  # fmt: skip
        _show(result, as_json, lambda: _simulation_lines(result, out))


@main.command()
@click.argument("plan", type=_FILE)
@click.option(
    "--out", required=True, type=_FILE, help="Ending in .mp4: a video, lossless; else a folder of PNG images."
)
@click.option("--turns", type=float, default=1.0, show_default=True, help="Of the video.")
@_as_json
def export(plan: Path, out: Path, turns: float, as_json: bool) -> None:
    """Write a PLAN's patterns for printers that show images or play video.

    \b
    Example:
      vialight export plan.h5 --out patterns
      vialight export plan.h5 --out patterns.mp4 --turns 20
    """
    with _faults_told():
        from vialight.commands import export_plan

        result = export_plan(plan, out, turns=turns)
        _show(result, as_json, lambda: [f"{result['images']} images: {out}"])


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


def _simulation_lines(result: dict[str, Any], out: Path) -> list[str]:
    printed, truth = result["printed"], result["truth"]
    return [
        f"light on        {printed['lit_s']:.0f} s, {printed['turns_lit']:.2f} turns",
        f"dose            {truth['largest_dose_mj_per_cm2']:.0f} mJ/cm^2 at most; "
        f"critical: {truth['critical_dose_mj_per_cm2']:.0f}",
        f"gelled          {truth['first_gelled_s']:.0f} to {truth['last_gelled_s']:.0f} s, "
        f"{truth['volume_mm3']:.2f} mm^3 ({truth['reference_volume_mm3']:.2f} meant)",
        f"frames          {printed['frames']}, {printed['frames_dropped']} dropped",
        f"written to      {out} in {result['elapsed_s']:.1f} s",
    ]


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


def _plan_lines(result: dict[str, Any], out: Path | None) -> list[str]:
    metrics = result["metrics"]
    rows = [
        ("Jaccard index, best threshold", "jaccard", ""), ("best threshold, of the dose meant", "best_threshold", ""),
        ("process window", "process_window", ""), ("in-part dose range", "in_part_dose_range", ""),
        ("voxel error rate", "voxel_error_rate", ""), ("light efficiency", "light_efficiency", ""),
        ("exposure a turn", "exposure_per_turn_mj_per_cm2", "mJ/cm^2"),
        ("turns to the critical exposure", "turns_to_critical_exposure", ""),
    ]  # fmt: skip
    lines = [
        f"{title:<34}{metrics[key]:12.4f} {unit}".rstrip() for title, key, unit in rows if metrics.get(key) is not None
    ]
    if out is None:
        return lines
    count, height, width = result["patterns"]["shape"]
    lines.append(f"{count} patterns of {height} x {width} pixels after {metrics['passes']} passes: {out}")
    return [*lines, f"report: {out.with_suffix('.html')}"]
