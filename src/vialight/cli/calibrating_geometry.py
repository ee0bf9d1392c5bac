"""`vialight calibrate axis|vial|scale|check`: parsing and wiring only."""

from __future__ import annotations

from pathlib import Path

import click

from vialight.cli.running import faults_told, rig_named, show
from vialight.cli.tables import calibration_lines, check_lines

_FILE = click.Path(path_type=Path)
_rig = click.option(
    "--rig", required=True, type=_FILE, callback=rig_named, help="To start from: TOML, or orth2022-145, orth2022-190."
)
_out = click.option("--out", required=True, type=_FILE, help="The new rig, TOML; .html and .json come beside it.")
_as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")
_turn = click.option("--turn", type=int, help="Which turn of the recording, from 1. [default: the last full one]")


@click.command()
@click.argument("frames", type=_FILE)
@_rig
@_out
@_turn
@_as_json
def axis(frames: Path, rig: Path, out: Path, turn: int | None, as_json: bool) -> None:
    """Find rotation axis, tilt, run-out and turning sense from the FRAMES (HDF5) of any print.

    \b
    Example:
      vialight calibrate axis run/frames.h5 --rig rig.toml --out calibrated.toml
    """
    with faults_told():
        from vialight.commands.calibrate import calibrate_axis

        result = calibrate_axis(frames, rig, out, turn=turn)
        show(result, as_json, lambda: calibration_lines(result, out))


@click.command()
@click.argument("frames", type=_FILE)
@_rig
@_out
@_turn
@_as_json
def vial(frames: Path, rig: Path, out: Path, turn: int | None, as_json: bool) -> None:
    """Refine outer radius, imaging index and camera distance from the FRAMES (HDF5) of any print.

    As far as they determine them: the page says what was left alone, and why.

    \b
    Example:
      vialight calibrate vial run/frames.h5 --rig rig.toml --out calibrated.toml
    """
    with faults_told():
        from vialight.commands.calibrate import calibrate_vial

        result = calibrate_vial(frames, rig, out, turn=turn)
        show(result, as_json, lambda: calibration_lines(result, out))


@click.command()
@click.argument("frames", type=_FILE)
@_rig
@_out
@click.option("--diameter-mm", type=float, help="Of the vial, by calliper. [default: the rig's]")
@click.option("--diameter-std-mm", type=float, default=0.02, show_default=True, help="Its standard uncertainty.")
@click.option("--dots", type=float, metavar="MM", help="A flat grid of dots so far apart, in the plane of the axis.")
@click.option("--chessboard", type=float, metavar="MM", help="A flat chessboard of fields so wide, in the same place.")
@click.option("--in-vial", is_flag=True, help="The target is in the resin in the vial. [default: plainly in air]")
@click.option("--pitch-std-mm", type=float, help="Standard uncertainty of the MM. [default: a thousandth]")
@click.option("--plane-std-mm", type=float, default=0.3, show_default=True, help="That the plane is that of the axis.")
@_as_json
def scale(
    frames: Path, rig: Path, out: Path, diameter_mm: float | None, diameter_std_mm: float, dots: float | None,
    chessboard: float | None, in_vial: bool, pitch_std_mm: float | None, plane_std_mm: float, as_json: bool,
) -> None:  # fmt: skip
    """Find the size of a pixel from FRAMES (HDF5): by the vial's edges and its diameter, or by a flat target.

    A target tells the lens's distortion too, and the optical row: in the vial, or in air where the stage was turned
    from one frame to the next.

    \b
    Example:
      vialight calibrate scale run/frames.h5 --diameter-mm 24.80 --rig rig.toml --out calibrated.toml
      vialight calibrate scale target.h5 --dots 1.5 --in-vial --rig rig.toml --out calibrated.toml
    """
    with faults_told():
        from vialight.calibration.scale.flat_target_command import FlatTarget
        from vialight.commands.calibrate import calibrate_scale, calibrate_scale_by_target

        if sum(given is not None for given in (diameter_mm, dots, chessboard)) > 1:
            raise click.UsageError("give one of --diameter-mm, --dots, --chessboard")
        if dots is None and chessboard is None:
            result = calibrate_scale(frames, rig, out, diameter_mm=diameter_mm, diameter_std_mm=diameter_std_mm)
        else:
            target = FlatTarget(
                "dots" if chessboard is None else "chessboard", dots or chessboard or 0.0,
                pitch_std_mm, in_vial, plane_std_mm,
            )  # fmt: skip
            result = calibrate_scale_by_target(frames, rig, out, target)
        show(result, as_json, lambda: calibration_lines(result, out))


@click.command()
@click.argument("run", type=_FILE)
@click.option("--rig", type=_FILE, callback=rig_named, help="To compare with. [default: that of the run]")
@_turn
@click.option("--out", type=_FILE, help="A new rig that keeps how sharp and bright this run is, for later ones.")
@_as_json
def check(run: Path, rig: Path | None, turn: int | None, out: Path | None, as_json: bool) -> None:
    """Say whether the calibration of a RUN (a folder, or frames with --rig) is still good; check.html shows it.

    \b
    Example:
      vialight calibrate check run
      vialight calibrate check good-run --out rig-with-reference.toml
    """
    with faults_told():
        from vialight.commands.calibrate import check_calibration

        result = check_calibration(run, rig, turn=turn, out=out)
        show(result, as_json, lambda: check_lines(result))


COMMANDS = (axis, vial, scale, check)
