"""`vialight calibrate ...`: parsing and wiring only."""

from __future__ import annotations

from pathlib import Path

import click

from vialight.cli.running import faults_told, progress, rig_named, show, stopped_by_interrupt
from vialight.cli.tables import calibration_lines

_FILE = click.Path(path_type=Path)
_rig = click.option(
    "--rig", required=True, type=_FILE, callback=rig_named, help="To start from: TOML, or orth2022-145, orth2022-190."
)
_out = click.option("--out", required=True, type=_FILE, help="The new rig, TOML; .html and .json come beside it.")
_as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")


@click.group()
def calibrate() -> None:
    """Find values of the rig from data: a new rig, with uncertainties, and a page that shows whether it is right.

    \b
    Example:
      vialight calibrate resin depths.csv --rig rig.toml --out calibrated.toml
    """


@calibrate.command()
@click.argument("table", required=False, type=_FILE)
@click.option(
    "--run", "runs", multiple=True, type=_FILE,
    help="Find the critical exposure from when a run's print gelled; may be repeated, at other irradiances.",
)  # fmt: skip
@click.option("--plan", type=_FILE, help="That was printed. [default: the run's]")
@click.option(
    "--cylinder", "cylinders", multiple=True, nargs=2, type=_FILE, metavar="FRAMES PROFILE",
    help="Find the index from how large a known cylinder appears; may be repeated.",
)  # fmt: skip
@click.option("--profile-pixel-mm", type=float, help="Pitch of the height maps' pixels.")
@click.option("--voxel", type=float, help="Edge of a voxel, mm. [default: half a pixel]")
@_rig
@_out
@_as_json
def resin(
    table: Path | None, runs: tuple[Path, ...], plan: Path | None, cylinders: tuple[tuple[Path, Path], ...],
    profile_pixel_mm: float | None, voxel: float | None, rig: Path, out: Path, as_json: bool,
) -> None:  # fmt: skip
    """Find critical exposure and absorption from a TABLE (CSV) of exposures and cured depths, or the imaging index.

    The critical exposure is told by a run too: by how much light each place had got when it gelled.

    The table's columns: exposure_mj_per_cm2, at the resin's surface, and depth_mm.

    \b
    Example:
      vialight calibrate resin depths.csv --rig rig.toml --out calibrated.toml
      vialight calibrate resin --run run --rig rig.toml --out calibrated.toml
      vialight calibrate resin --cylinder frames.h5 heights.npy --profile-pixel-mm 0.05 --rig rig.toml --out new.toml
    """
    with faults_told():
        from vialight.calibration.threshold.standards import Standard, StandardOptions
        from vialight.commands.calibrate import calibrate_resin
        from vialight.tomography.reconstruct import Settings

        if table is None and not runs and not cylinders:
            raise click.UsageError("give a TABLE, a --run or a --cylinder")
        with progress("slices") as advance:
            result = calibrate_resin(
                table, rig, out, runs=runs, plan_path=plan, cylinders=[Standard(*pair) for pair in cylinders],
                options=StandardOptions(profile_pixel_mm, Settings(voxel)), progress=advance,
            )  # fmt: skip
        show(result, as_json, lambda: calibration_lines(result, out))


@calibrate.command()
@click.argument("frames", nargs=-1, required=True, type=_FILE)
@click.option(
    "--profile", "profiles", multiple=True, type=_FILE, help="Height map of the cylinder, for each FRAMES or several."
)
@click.option("--profile-pixel-mm", type=float, help="Pitch of the height maps' pixels.")
@click.option("--reference", "references", multiple=True, type=_FILE, help="The print's true surface, in place of it.")
@click.option(
    "--validate", multiple=True, nargs=2, type=_FILE, metavar="FRAMES PROFILE",
    help="Compare another cylinder's diameters; may be repeated.",
)  # fmt: skip
@click.option("--voxel", type=float, help="Edge of a voxel, mm. [default: half a pixel]")
@click.option("--bin", "binning", type=int, default=1, show_default=True, help="Sum N x N pixels first.")
@click.option("--turn", type=int, help="Which turn of the recordings, from 1. [default: the last full one]")
@click.option("--exposure-s", type=float, help="Of the camera, where neither recording nor rig says it.")
@click.option("--gain-db", type=float, help="Likewise.")
@click.option("--led-level", type=float, help="Of the light, in any unit that is proportional to it. Likewise.")
@_rig
@_out
@_as_json
def threshold(
    frames: tuple[Path, ...], profiles: tuple[Path, ...], profile_pixel_mm: float | None, references: tuple[Path, ...],
    validate: tuple[tuple[Path, Path], ...], voxel: float | None, binning: int, turn: int | None,
    exposure_s: float | None, gain_db: float | None, led_level: float | None, rig: Path, out: Path, as_json: bool,
) -> None:  # fmt: skip
    """Find the gelation threshold I_p from FRAMES of a standard cylinder and its profile, or of several.

    Several cylinders of different size may stand in one vial: one FRAMES, a --profile each.

    \b
    Example:
      vialight calibrate threshold frames.h5 --profile heights.npy --profile-pixel-mm 0.05 --rig rig.toml --out new.toml
      vialight calibrate threshold frames.h5 --reference scan.stl --rig rig.toml --out new.toml
    """
    with faults_told():
        from vialight.calibration.threshold.standards import Standard, StandardOptions
        from vialight.commands.calibrate import calibrate_threshold
        from vialight.core.config import ThresholdConditions
        from vialight.tomography.reconstruct import Settings

        known = profiles or references
        if len(frames) == 1:
            frames *= len(profiles) or 1  # several cylinders at once, of different size
        if (profiles and references) or len(known) != len(frames):
            raise click.UsageError("give a --profile, or else a --reference, for each FRAMES")
        stated = ThresholdConditions(exposure_s=exposure_s, gain_db=gain_db, led_level=led_level)
        with progress("slices") as advance:
            result = calibrate_threshold(
                [Standard(*pair) for pair in zip(frames, known, strict=True)], rig, out,
                options=StandardOptions(profile_pixel_mm, Settings(voxel, binning, turn), stated),
                validate=[Standard(*pair) for pair in validate], progress=advance,
            )  # fmt: skip
        show(result, as_json, lambda: calibration_lines(result, out))


@calibrate.command()
@click.argument("frames", required=False, type=_FILE)
@click.option("--resin", default="DUDMA", show_default=True, help="Of the twin: DUDMA, BPAGDA, or TOML.")
@click.option("--faults", type=_FILE, help="Of the twin: what is wrong with the printer, TOML.")
@_rig
@_out
@_as_json
def projector(frames: Path | None, resin: str, faults: Path | None, rig: Path, out: Path, as_json: bool) -> None:
    """Find where the projector stands by sweeping a line through the resin and watching it glow.

    On the devices that the rig names, the camera's filter taken off, or else on the digital twin; or from FRAMES, a
    sweep that was recorded before (NEW.sweep.h5).

    \b
    Example:
      vialight calibrate projector --rig rig.toml --out new.toml
      vialight calibrate projector new.sweep.h5 --rig rig.toml --out newer.toml
    """
    with faults_told():
        from vialight.calibration.projector.command import SweepOptions
        from vialight.commands.calibrate import calibrate_projector

        with progress("lines") as advance, stopped_by_interrupt("light off; ending the sweep") as keep_going:
            result = calibrate_projector(
                rig, out, options=SweepOptions(frames, resin, faults), progress=advance, keep_going=keep_going
            )
        show(result, as_json, lambda: calibration_lines(result, out))


@calibrate.command()
@click.argument("first", type=_FILE)
@click.argument("second", type=_FILE)
@click.option("--flash", is_flag=True, help="Flash the rig's projector, and see it with its camera.")
@_rig
@_out
@_as_json
def latency(first: Path, second: Path, flash: bool, rig: Path, out: Path, as_json: bool) -> None:
    """Find the delays of camera and projector from two recordings of one thing, FIRST and SECOND.

    They are taken with `vialight record`, at two speeds.

    \b
    Example:
      vialight calibrate latency fast.h5 slow.h5 --flash --rig rig.toml --out new.toml
    """
    with faults_told():
        from vialight.commands.calibrate import calibrate_latency

        result = calibrate_latency(
            first, second, rig, out, flash=flash, on_step=lambda message: click.echo(message, err=True)
        )
        show(result, as_json, lambda: calibration_lines(result, out))
