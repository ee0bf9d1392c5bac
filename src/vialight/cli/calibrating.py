"""`vialight calibrate ...`: parsing and wiring only."""

from __future__ import annotations

from pathlib import Path

import click

from vialight.cli.running import faults_told, show
from vialight.cli.tables import calibration_lines

_FILE = click.Path(path_type=Path)
_rig = click.option("--rig", required=True, type=_FILE, help="The rig to start from, TOML; it is left as it is.")
_out = click.option("--out", required=True, type=_FILE, help="The new rig, TOML; .html and .json come beside it.")
_as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")


@click.group()
def calibrate() -> None:
    r"""Find values of the rig from data: a new rig, with uncertainties, and a page that shows whether it is right.

    \b
    Example:
      vialight calibrate resin depths.csv --rig rig.toml --out calibrated.toml
    """


@calibrate.command()
@click.argument("table", type=_FILE)
@_rig
@_out
@_as_json
def resin(table: Path, rig: Path, out: Path, as_json: bool) -> None:
    r"""Find critical exposure and absorption from a TABLE (CSV) of exposures and cured depths.

    Its columns: exposure_mj_per_cm2, at the resin's surface, and depth_mm.

    \b
    Example:
      vialight calibrate resin depths.csv --rig rig.toml --out calibrated.toml
    """
    with faults_told():
        from vialight.commands.calibrating import calibrate_resin

        result = calibrate_resin(table, rig, out)
        show(result, as_json, lambda: calibration_lines(result, out))
