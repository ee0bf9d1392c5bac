"""The command line: parsing and wiring only."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from vialight.cli.calibrating import calibrate
from vialight.cli.calibrating_geometry import COMMANDS
from vialight.cli.instruments import devices_command, doctor_command, record_command
from vialight.cli.prints import kinetics_command, print_command, say, status_line, watch_command
from vialight.cli.running import faults_told, progress, show, stopped_by_interrupt
from vialight.cli.tables import measurement_lines, plan_lines, print_lines, reconstruction_lines, simulation_lines

if TYPE_CHECKING:
    from vialight.commands import GivenProjections, PlanSettings

# Heavy modules are imported inside the commands, so that --help answers at once.

_FOLDER = click.Path(file_okay=False, path_type=Path)
_FILE = click.Path(path_type=Path)
_as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="vialight")
def main() -> None:
    """Measure tomographic volumetric prints while they are still in the vial."""
    os.environ["PYTHONSAFEPATH"] = "1"  # nothing that is started imports from the current folder: it may be given


@main.command()
@click.argument("frames", type=_FILE)
@click.option("--rig", type=_FILE, help="The rig, TOML. [default: that of the run, where FRAMES is a run's folder]")
@click.option("--out", type=_FOLDER, help="Folder for volume.zarr, surface.stl ... [default: the run]")
@click.option("--threshold", type=float, help="Gelation threshold I_p, counts per mm. [default: the rig's]")
@click.option("--voxel", type=float, help="Edge of a voxel, mm. [default: half a pixel]")
@click.option("--bin", "binning", type=int, default=1, show_default=True, help="Sum N x N pixels first.")
@click.option(
    "--turn", type=int, help="Which turn of the recording, from 1. [default: the one that ends with the last frame]"
)
@click.option(
    "--filter", "filter_name", type=click.Choice(["ram-lak", "shepp-logan", "cosine", "hann"]), default="cosine",
    show_default=True, help="Ramp filter, from sharpest to smoothest.",
)  # fmt: skip
@click.option("--accurate", is_flag=True, help="Backproject along the rays' climb in z too: for tall parts.")
@_as_json
def reconstruct(
    frames: Path,
    rig: Path | None,
    out: Path | None,
    threshold: float | None,
    voxel: float | None,
    binning: int,
    turn: int | None,
    filter_name: Literal["ram-lak", "shepp-logan", "cosine", "hann"],
    accurate: bool,
    as_json: bool,
) -> None:
    """Reconstruct a print from camera FRAMES (HDF5, Data Exchange), or from a run's folder, also of one that died.

    \b
    Example:
      vialight reconstruct frames.h5 --rig rig.toml --threshold 100 --out print
      vialight reconstruct run
    """
    with faults_told():
        from vialight.commands import reconstruct_recording
        from vialight.system import file_in
        from vialight.tomography.reconstruct import Settings

        if frames.is_dir():
            rig, out, frames = rig or file_in(frames, "rig.toml"), out or frames, file_in(frames, "frames.h5")
        if rig is None or out is None:
            raise click.UsageError("give --rig and --out, or a run's folder")
        settings = Settings(voxel, binning, turn, accurate, filter_name)
        with progress("slices") as advance:
            result = reconstruct_recording(frames, rig, out, settings=settings, threshold=threshold, progress=advance)
        show(result, as_json, lambda: reconstruction_lines(result, out))


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
    with faults_told():
        from vialight.commands import measure_surface

        result = measure_surface(surface, reference, out, align=align, tolerance_mm=tolerance)
        show(result, as_json, lambda: measurement_lines(result, out))


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
@click.option(
    "--held", type=int, default=2, show_default=True,
    help="Angles that a pattern counts at while the vial turns under it; 1 takes it for a flash.",
)  # fmt: skip
@click.option(
    "--ceiling",
    type=float,
    default=0.3,
    show_default=True,
    help="Of object-space: brightest light, in that of filtered backprojection; less prints faster, 1 is no ceiling.",
)
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
    with faults_told():
        from vialight.commands import plan_part, score_plan

        if score is not None:
            result = score_plan(score, rig)
            show(result, as_json, lambda: plan_lines(result, None))
            return
        if part is None or out is None:
            raise click.UsageError("give a PART and --out, or --score PLAN.h5")
        with progress("passes") as advance, stopped_by_interrupt() as keep_going:
            result = plan_part(
                part, rig, out, settings=_plan_settings(options), given=_given_projections(options),
                resume=options["resume"], save_state=options["save_state"], progress=advance, keep_going=keep_going,
            )  # fmt: skip
        show(result, as_json, lambda: plan_lines(result, out))


def _plan_settings(options: dict[str, Any]) -> PlanSettings:
    from vialight.commands import PlanSettings

    return PlanSettings(
        method=options["method"], passes=options["passes"], angles=options["angles"], voxel_mm=options["voxel"],
        coverage=options["coverage"], void_limit=options["void_limit"], climbing=not options["flat"],
        projector_blur_mm=options["projector_blur"], diffusion_mm=options["diffusion"], held=options["held"],
        ceiling=options["ceiling"], background=options["background"], clip_level=options["clip"],
        bound_void=options["bound_void"],
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


@main.command()
@click.argument("plan", type=_FILE)
@click.option("--rig", required=True, type=_FILE, help="The printer as it is: TOML, or orth2022-145, orth2022-190.")
@click.option("--resin", required=True, help="What is in its vial: DUDMA, BPAGDA, or TOML.")
@click.option(
    "--out", required=True, type=_FOLDER, help="Folder for frames.h5, truth.stl, heights.npy, rig.toml, run.json."
)
@click.option("--turns", type=float, help="Light off after so many. [default: when as much will gel as was meant]")
@click.option("--dose", type=float, help="Light off after this dose in the part, mJ/cm^2.")
@click.option("--voxel", type=float, default=0.1, show_default=True, help="Edge of a voxel of resin, mm.")
@click.option("--bin", "binning", type=int, default=1, show_default=True, help="Sum N x N of the camera's pixels.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the noise.")
@click.option("--faults", type=_FILE, help="What is wrong with the printer, and with the rig.toml written: TOML.")
@click.option("--twin", type=_FILE, help="How closely to look: aperture, exposure, shadows, noise ...: TOML.")
@_as_json
def simulate(
    plan: Path, rig: Path, resin: str, out: Path, turns: float | None, dose: float | None, voxel: float, binning: int,
    seed: int, faults: Path | None, twin: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Print a PLAN on the digital twin and record it.

    \b
    Example:
      vialight simulate plan.h5 --rig orth2022-190 --resin DUDMA --out run
    """
    with faults_told():
        from vialight.commands.simulate import simulate_print
        from vialight.twin import TwinSettings, load_settings

        settings = TwinSettings(binning=binning, seed=seed)
        settings = settings if twin is None else load_settings(twin, settings)
        with progress("s") as advance:
            result = simulate_print(
                plan, rig, resin, out, turns=turns, dose_mj_per_cm2=dose, voxel_mm=voxel, settings=settings,
                faults=faults, progress=advance,
            )  # fmt: skip
        show(result, as_json, lambda: simulation_lines(result, out))


@main.command()
@click.argument("run", type=_FOLDER)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", type=click.IntRange(0, 65535), help="0: any. [default: 8765, or any where that is taken]")
@click.option(
    "--name", "names", multiple=True, help="Another name by which people reach this machine; may be repeated."
)
def serve(run: Path, host: str, port: int | None, names: tuple[str, ...]) -> None:
    """Show a RUN, printing or finished, or a folder of runs, in a browser; ends with Ctrl-C.

    \b
    Example:
      vialight serve run
      vialight serve runs --port 9000
    """
    with faults_told():
        from vialight.commands import serve_runs

        serve_runs(
            run, host=host, port=port, names=names,
            announce=lambda link: click.echo(f"open {link}"),
            warn=lambda text: click.echo(f"vialight: warning: {text}", err=True),
        )  # fmt: skip


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
    with faults_told():
        from vialight.commands import export_plan

        result = export_plan(plan, out, turns=turns)
        show(result, as_json, lambda: [f"{result['images']} images: {out}"])


@main.command()
@click.option(
    "--out", type=_FOLDER, default=Path("vialight-demo"), show_default=True, help="Folder for everything it makes."
)
@click.option("--recording", is_flag=True, help="Print nothing: reconstruct and measure a recording that comes along.")
@click.option("--serve", is_flag=True, help="Show the print in a browser.")
@_as_json
def demo(out: Path, recording: bool, serve: bool, as_json: bool) -> None:
    """Plan a sample part, print it on the digital twin, measured while it forms, and report: about a minute or two.

    \b
    Example:
      vialight demo --out demo
      vialight demo --out demo --serve
    """
    with faults_told():
        from vialight.commands.demo import measure_demo, print_demo

        if recording:
            with progress("slices") as advance:
                first, second = measure_demo(out, progress=advance)
            lines = [*reconstruction_lines(first, out), "", *measurement_lines(second, out)]
            show({"reconstruction": first, "measurement": second}, as_json, lambda: lines)
            return
        with stopped_by_interrupt("light off; ending the print") as keep_going:
            result = print_demo(out, serve=serve, keep_going=keep_going, on_status=status_line(), on_step=say)
        show(result, as_json, lambda: print_lines(result, out / "run"))


for command in COMMANDS:
    calibrate.add_command(command)
main.add_command(calibrate)
main.add_command(print_command)
main.add_command(watch_command)
main.add_command(devices_command)
main.add_command(doctor_command)
main.add_command(record_command)
main.add_command(kinetics_command)
