"""`vialight calibrate axis|scale|check`: parsing and wiring only."""

from __future__ import annotations

from pathlib import Path

import click

from vialight.cli.running import faults_told, show
from vialight.cli.tables import calibration_lines, check_lines

_FILE = click.Path(path_type=Path)
_rig = click.option("--rig", required=True, type=_FILE, help="The rig to start from, TOML; it is left as it is.")
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
        from vialight.commands.calibrating import calibrate_axis

        result = calibrate_axis(frames, rig, out, turn=turn)
        show(result, as_json, lambda: calibration_lines(result, out))


@click.command()
@click.argument("frames", type=_FILE)
@_rig
@_out
@click.option("--diameter-mm", type=float, help="Of the vial, by calliper. [default: the rig's]")
@click.option("--diameter-std-mm", type=float, default=0.02, show_default=True, help="Its standard uncertainty.")
@_as_json
def scale(frames: Path, rig: Path, out: Path, diameter_mm: float | None, diameter_std_mm: float, as_json: bool) -> None:
    """Find the size of a pixel from the vial's edges in FRAMES (HDF5) and its diameter.

    \b
    Example:
      vialight calibrate scale run/frames.h5 --diameter-mm 24.80 --rig rig.toml --out calibrated.toml
    """
    with faults_told():
        from vialight.commands.calibrating import calibrate_scale

        result = calibrate_scale(frames, rig, out, diameter_mm=diameter_mm, diameter_std_mm=diameter_std_mm)
        show(result, as_json, lambda: calibration_lines(result, out))


@click.command()
@click.argument("run", type=_FILE)
@click.option("--rig", type=_FILE, help="To compare with. [default: that of the run]")
@_turn
@_as_json
def check(run: Path, rig: Path | None, turn: int | None, as_json: bool) -> None:
    """Say whether the calibration of a RUN (a folder, or frames with --rig) is still good.

    \b
    Example:
      vialight calibrate check run
    """
    with faults_told():
        from vialight.commands.calibrating import check_calibration

        result = check_calibration(run, rig, turn=turn)
        show(result, as_json, lambda: check_lines(result))


COMMANDS = (axis, scale, check)
