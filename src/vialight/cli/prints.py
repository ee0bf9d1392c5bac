"""`vialight print` and `vialight watch`: parsing and wiring only."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vialight.cli.running import faults_told, is_terminal, progress, show, stopped_by_interrupt, tell
from vialight.cli.tables import kinetics_lines, print_lines, watch_lines

if TYPE_CHECKING:
    from vialight.core.messages import PrintStatus

_FOLDER = click.Path(file_okay=False, path_type=Path)
_FILE = click.Path(path_type=Path)
_SHOW_EVERY_S = 0.5
_LINE_EVERY_S = 30.0


@click.command("print")
@click.argument("plan", type=_FILE)
@click.option("--rig", required=True, type=_FILE, help="The printer: TOML, or orth2022-145, orth2022-190.")
@click.option("--out", required=True, type=_FOLDER, help="Folder for the run; it must not hold anything yet.")
@click.option("--reference", type=_FILE, help="Mesh to compare with. [default: the part as planned]")
@click.option(
    "--stop", default="auto", show_default=True, metavar="auto|manual|turns=N",
    help="Who ends it: the forecast from what is seen, you (Ctrl-C, or the page), or a number of turns.",
)  # fmt: skip
@click.option("--threshold", type=float, help="Gelation threshold I_p, counts per mm. [default: the rig's]")
@click.option("--voxel", type=float, help="Edge of a live voxel, mm. [default: half a pixel]")
@click.option("--every-deg", type=float, default=360.0, show_default=True, help="Keep a volume so often.")
@click.option("--longest", type=float, default=40.0, show_default=True, help="Turns after which it ends in any case.")
@click.option("--tolerance", type=float, help="Largest deviation allowed, mm: gives a verdict.")
@click.option("--resin", help="Of the simulated printer: DUDMA, BPAGDA, or TOML. [default: the rig's]")
@click.option("--rate", type=float, default=1.0, show_default=True, help="Of the simulated printer: times real time.")
@click.option("--resin-voxel", type=float, default=0.15, show_default=True, help="Of the simulated resin, mm.")
@click.option("--bin", "binning", type=int, default=1, show_default=True, help="Of the simulated camera: sum N x N.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the simulated noise.")
@click.option("--serve", is_flag=True, help="Show it in a browser while it prints.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")
def print_command(
    plan: Path, rig: Path, out: Path, reference: Path | None, stop: str, threshold: float | None,
    voxel: float | None, every_deg: float, longest: float, tolerance: float | None, resin: str | None, rate: float,
    resin_voxel: float, binning: int, seed: int, serve: bool, as_json: bool,
) -> None:  # fmt: skip
    """Print a PLAN, measured while it forms, on the devices that the rig names or else on the digital twin.

    Ctrl-C turns the light off at once and then ends the print in its usual way; a second one gives up the rest.

    \b
    Example:
      vialight print plan.h5 --rig orth2022-190 --out run
      vialight print plan.h5 --rig orth2022-190 --out run --stop turns=17 --rate 4 --serve
    """
    with faults_told():
        from vialight.commands.print import print_part
        from vialight.commands.print_job import LiveOptions, Simulation
        from vialight.printing.settings import stop_settings
        from vialight.twin import TwinSettings

        settings = stop_settings(stop, longest_turns=longest)
        live = LiveOptions(reference, threshold, voxel, every_deg, tolerance)
        simulation = Simulation(resin, rate, resin_voxel, binning, TwinSettings(seed=seed))
        with stopped_by_interrupt("light off; ending the print") as keep_going:
            result = print_part(
                plan, rig, out, settings=settings, live=live, simulation=simulation, keep_going=keep_going,
                on_status=status_line(), on_step=say, on_rehearsal=_rehearsed, serve=serve,
            )  # fmt: skip
        show(result, as_json, lambda: print_lines(result, out))


@click.command("watch")
@click.argument("run", type=_FOLDER)
@click.option("--rate", type=float, default=1.0, show_default=True, help="Times real time.")
@click.option("--out", type=_FOLDER, help="Folder for what is measured on the way. [default: none is kept]")
@click.option("--threshold", type=float, help="Gelation threshold I_p, counts per mm. [default: the rig's]")
@click.option("--voxel", type=float, help="Edge of a live voxel, mm. [default: half a pixel]")
@click.option("--every-deg", type=float, default=360.0, show_default=True, help="With --out: keep a volume so often.")
@click.option("--serve", is_flag=True, help="Show it in a browser.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")
def watch_command(
    run: Path, rate: float, out: Path | None, threshold: float | None, voxel: float | None, every_deg: float,
    serve: bool, as_json: bool,
) -> None:  # fmt: skip
    """Replay a RUN's recording as if it were live.

    \b
    Example:
      vialight watch run --rate 4
      vialight watch run --rate 10 --out watched --every-deg 90
    """
    with faults_told():
        from vialight.commands.watch import watch_run

        with stopped_by_interrupt("ending the replay") as keep_going:
            result = watch_run(
                run, rate=rate, out=out, threshold=threshold, voxel_mm=voxel, every_deg=every_deg,
                keep_going=keep_going, on_status=status_line(), serve=serve, on_step=say,
            )  # fmt: skip
        show(result, as_json, lambda: watch_lines(result))


def _point(ctx: click.Context, param: click.Parameter, value: str) -> tuple[float, float, float]:
    """Return the three numbers of X,Y,Z."""
    try:
        x, y, z = (float(part) for part in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r} is not three numbers with commas between", ctx, param) from None
    return x, y, z


@click.command("kinetics")
@click.argument("run", type=_FOLDER)
@click.option(
    "--at",
    required=True,
    callback=_point,
    metavar="X,Y,Z",
    help="Where to look, object frame, mm: z up, x right at angle 0.",
)
@click.option("--radius", type=float, default=0.0, help="Of the ball that is averaged, mm. [default: the point]")
@click.option("--out", type=_FOLDER, help="Folder for tables and pictures. [default: kinetics in the run]")
@click.option("--plan", type=_FILE, help="Plan whose patterns were shown: for the dose. [default: the run's]")
@click.option("--reference", type=_FILE, help="Mesh that was meant: for failures. [default: the run's]")
@click.option("--tolerance", type=float, help="How far outside it matter may gel, mm. [default: two voxels]")
@click.option("--threshold", type=float, help="Gelation threshold I_p, counts per mm. [default: the rig's]")
@click.option("--voxel", type=float, help="Edge of a voxel, mm. [default: a pixel]")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, alone on stdout.")
def kinetics_command(
    run: Path, at: tuple[float, float, float], radius: float, out: Path | None, plan: Path | None,
    reference: Path | None, tolerance: float | None, threshold: float | None, voxel: float | None, as_json: bool,
) -> None:  # fmt: skip
    """Tell density and dose over time at a place of a RUN, when matter gelled, and where and when it began to fail.

    \b
    Example:
      vialight kinetics run --at 0,0,1.5
      vialight kinetics run --at=-2.5,0,0 --radius 0.5 --out why
    """
    with faults_told():
        from vialight.commands.kinetics import kinetics_of
        from vialight.control.looking_back import Place

        with progress("frames") as advance:
            result = kinetics_of(
                run, Place(at, radius), out=out, plan=plan, reference=reference, tolerance_mm=tolerance,
                threshold=threshold, voxel_mm=voxel, progress=advance,
            )  # fmt: skip
        show(result, as_json, lambda: kinetics_lines(result, out or run / "kinetics"))


def say(message: str) -> None:
    """Tell a person what is done now."""
    tell(message)


def _rehearsed(done: int, total: int) -> None:
    if is_terminal():
        tell(f"\rrehearsed in {done} of {total} resins", is_line=done == total)


def status_line() -> Callable[[PrintStatus], None]:
    """Return what shows how a print is doing: one line that changes on a terminal, else a line now and then."""
    has_terminal = is_terminal()
    shown: dict[str, Any] = {"at": 0.0, "state": ""}

    def tell_status(status: PrintStatus) -> None:
        now = time.monotonic()
        wait_s = _SHOW_EVERY_S if has_terminal else _LINE_EVERY_S
        if now - shown["at"] < wait_s and status.state == shown["state"]:
            return
        shown["at"], shown["state"] = now, status.state
        left = (
            ""
            if status.remaining_s is None or status.mode == "manual"
            else f", at most {status.remaining_s:.0f} s left"
        )
        wrong = "; ".join(f"{name}: {told}" for name, told in status.devices.items() if told != "ok")
        line = (
            f"{status.state:<11}turn {status.turn:5.2f}, light {status.lit_s:5.1f} s{left}; {status.frames} frames, "
            f"{status.missed} missed" + (f"; {wrong}" if wrong else "")
        )
        tell(f"\r{line[:118]:<118}" if has_terminal else line, is_line=not has_terminal)

    return tell_status
