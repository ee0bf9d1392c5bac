"""`vialight devices`, `doctor` and `record`: parsing and wiring only."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from vialight.cli.running import FAILED, faults_told, progress, show, stopped_by_interrupt
from vialight.cli.tables import device_lines, doctor_lines, record_lines

_FILE = click.Path(path_type=Path)
_as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")


@click.command("devices")
@_as_json
def devices_command(as_json: bool) -> None:
    """List the cameras, serial ports and monitors that are found, with the lines of a rig that name them.

    \b
    Example:
      vialight devices
    """
    with faults_told():
        from vialight.commands.devices import find_instruments

        result = find_instruments()
        show(result, as_json, lambda: device_lines(result))


@click.command("doctor")
@click.argument("rig", type=_FILE)
@click.option("--rate", type=float, default=10.0, show_default=True, help="Frames a second that are wanted.")
@click.option("--move", is_flag=True, help="Turn the stage for some seconds; it may go to its reference first.")
@_as_json
def doctor_command(rig: Path, rate: float, move: bool, as_json: bool) -> None:
    """Check each device that a RIG names, and say what is wrong and what to do.

    No light is shown, and nothing moves unless --move is given.

    Exit code 0: all is well; 1: something is not.

    \b
    Example:
      vialight doctor rig.toml
      vialight doctor rig.toml --move
    """
    with faults_told():
        from vialight.commands.doctor import check_instruments

        result = check_instruments(rig, frame_rate_hz=rate, move=move, on_step=_say)
        show(result, as_json, lambda: doctor_lines(result))
        if not result["is_well"]:
            sys.exit(FAILED)


@click.command("record")
@click.option("--rig", required=True, type=_FILE, help="The rig, TOML, or orth2022-145, orth2022-190.")
@click.option("--out", required=True, type=_FILE, help="The recording to make, HDF5.")
@click.option("--turns", type=float, default=1.0, show_default=True, help="Of the stage.")
@click.option("--dark", type=int, default=0, show_default=True, help="Frames without the object to take first.")
@click.option("--rate", type=float, default=10.0, show_default=True, help="Frames a second.")
@click.option("--part", type=_FILE, help="Mesh that stands in the twin's vial. [default: the sample's]")
@_as_json
def record_command(
    rig: Path, out: Path, turns: float, dark: int, rate: float, part: Path | None, as_json: bool
) -> None:
    """Record a thing that turns, without printing, with the devices that the rig names or else on its twin.

    Ctrl-C ends the recording and keeps what there is.

    \b
    Example:
      vialight record --rig rig.toml --out frames.h5 --dark 8
      vialight reconstruct frames.h5 --rig rig.toml --out print
    """
    with faults_told():
        from vialight.commands.record import RecordSettings, record_turns

        settings = RecordSettings(turns, dark, rate, part)
        with progress("frames") as advance, stopped_by_interrupt("ending the recording") as keep_going:
            result = record_turns(
                rig, out, settings=settings, keep_going=keep_going, put_in=_wait_for_the_object, progress=advance,
                on_step=_say,
            )  # fmt: skip
        show(result, as_json, lambda: record_lines(result))


def _wait_for_the_object() -> None:
    """Let a person put the object in, where there is one."""
    if sys.stdin.isatty():
        click.pause("put the object in, and press a key", err=True)


def _say(message: str) -> None:
    click.echo(message, err=True)
