"""`vialight calibrate axis|vial|scale|check`: parsing and wiring only."""

from __future__ import annotations

from pathlib import Path

import click

from vialight.cli.running import faults_told, show
from vialight.cli.tables import calibration_lines

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
    r"""Find rotation axis, tilt, run-out and turning sense from the FRAMES (HDF5) of any print.

    \b
    Example:
      vialight calibrate axis run/frames.h5 --rig rig.toml --out calibrated.toml
    """
    with faults_told():
        from vialight.commands.calibrating import calibrate_axis

        result = calibrate_axis(frames, rig, out, turn=turn)
        show(result, as_json, lambda: calibration_lines(result, out))


COMMANDS = (axis,)
