"""`vialight print` as it is run: from the command line, in all its processes, some of which are killed."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from click.testing import CliRunner

from printing.prints import BINNING, write_quick_plan
from vialight.cli import main
from vialight.commands import print as printing
from vialight.control.stop_model import StopModel
from vialight.core.messages import CameraImage
from vialight.devices.simulated.display import BLACK, Flip, read_flips
from vialight.printing.live_link import LiveLink, find_live_print
from vialight.printing.order_channel import send_order
from vialight.store import list_history, open_frames, read_json, read_series
from vialight.store.foreign.meshes import load_mesh
from vialight.system.mailboxes import Mailbox

pytestmark = pytest.mark.alone

_PATIENCE_S = 400.0
"""Kernels are compiled first where nothing has run before."""
MORE_THAN_A_TURN = 50
"""Frames; at 10/s a turn of the quick printer has 30."""


def wait_for(what: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline:
        if found := what():
            return found
        time.sleep(0.01)
    raise AssertionError("it has not come to pass")


@contextmanager
def running_print(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], LiveLink, Path]]:
    """Print the quick plan in a process of its own; hand over when there has been light for a second."""
    plan, rig = write_quick_plan(folder)
    run = folder / "run"
    command = [
        str(Path(sys.executable).with_name("vialight")),
        "print",
        str(plan),
        "--rig",
        str(rig),
        "--out",
        str(run),
    ]
    command += ["--resin", "DUDMA", "--resin-voxel", "0.4", "--bin", str(BINNING), "--json", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        link = wait_for(lambda: find_live_print(run) or (process.poll() is not None and "ended"))
        assert isinstance(link, LiveLink), process.communicate()
        shared = Path(link.mailboxes)
        wait_for(lambda: any(flip.pattern != BLACK for flip in read_flips(shared)))
        time.sleep(1.0)
        yield process, link, run
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def frames_in(camera: Mailbox[CameraImage]) -> int:
    """How many frames are safely recorded."""
    newest = camera.newest()
    return 0 if newest is None else int(newest[1].frame) + 1


def child(process: subprocess.Popen[str], word: str) -> psutil.Process:
    """Return the child process that has a file of the shared folder open by a name."""
    for one in psutil.Process(process.pid).children(recursive=True):
        if any(word in mapped.path for mapped in one.memory_maps()):
            return one
    raise AssertionError(word)


def test_killed_print_is_dark_within_a_quarter_of_a_second_and_its_frames_can_be_used(tmp_path: Path) -> None:
    with running_print(tmp_path, "--stop", "turns=30") as (process, link, run):
        flips = Path(link.mailboxes) / "flips"
        camera = Mailbox(link.mailboxes / "camera", CameraImage)
        wait_for(lambda: frames_in(camera) > MORE_THAN_A_TURN)
        time.sleep(np.random.default_rng().uniform(0, 2))  # at a random moment; benchmarks/faults.py does it often
        recorded = frames_in(camera)
        killed = time.monotonic()
        os.kill(process.pid, signal.SIGKILL)
        time.sleep(0.6)
        kept = tmp_path / "kept"
        kept.mkdir()
        shutil.copyfile(flips, kept / "flips")
    last = read_flips(kept)[-1]
    assert last.pattern == BLACK
    assert last.monotonic_s - killed < 0.25
    with open_frames(run / "frames.h5") as frames:
        assert frames.is_live
        assert frames.shape[0] >= recorded > 1
    shown = CliRunner().invoke(main, ["reconstruct", str(run), "--threshold", "100000", "--json"])
    assert "no surface at 100000" in shown.output  # it reads the frames, of which none has so much density
    assert CliRunner().invoke(main, ["watch", str(run), "--rate", "20", "--json"]).exit_code == 0


@contextmanager
def begun_print(folder: Path, *options: str, **popen: Any) -> Iterator[tuple[subprocess.Popen[Any], LiveLink]]:
    """Print the quick plan in a process of its own; hand over when the print can be reached."""
    plan, rig = write_quick_plan(folder)
    command = [str(Path(sys.executable).with_name("vialight")), "print", str(plan), "--rig", str(rig)]
    command += ["--out", str(folder / "run"), "--resin-voxel", "0.4", "--bin", str(BINNING), "--rate", "4", *options]
    process: Any = subprocess.Popen(command, stdout=subprocess.DEVNULL, **({"stderr": subprocess.DEVNULL} | popen))
    try:
        link = wait_for(lambda: find_live_print(folder / "run") or (process.poll() is not None and "ended"))
        assert isinstance(link, LiveLink)
        yield process, link
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


@pytest.mark.parametrize(("by", "after_s"), [("Ctrl-C", 0.0), ("order", 0.5), ("Ctrl-C", 1.2)])
def test_print_that_is_stopped_before_the_first_light_is_never_lit(tmp_path: Path, by: str, after_s: float) -> None:
    with begun_print(tmp_path, "--stop", "turns=2") as (process, link):
        time.sleep(after_s)
        flips = link.mailboxes / "flips"
        if by == "order":
            answer = send_order(link, {"do": "stop", "by": "page"})
            assert answer["is_over"]
            assert answer["is_dark"]
        else:
            process.send_signal(signal.SIGINT)
        shown: list[Flip] = []
        while process.poll() is None:
            if flips.exists():
                with contextlib.suppress(OSError):
                    shown = read_flips(link.mailboxes)
            time.sleep(0.02)
        assert process.returncode == 0
    assert [flip for flip in shown if flip.pattern != BLACK] == []
    result = read_json(tmp_path / "run" / "run.json")
    assert result["state"] == "done"
    assert result["printed"]["lit_s"] == 0.0
    assert result["printed"]["ended_by"] == ("page" if by == "order" else "operator")


def test_ctrl_c_ends_the_light_at_once_while_nobody_reads_the_terminal(tmp_path: Path) -> None:
    """As over a connection that has stalled: what is written to it waits for ever."""
    ours, theirs = os.openpty()
    os.set_blocking(theirs, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(theirs, b"x" * 1000)
    os.set_blocking(theirs, True)
    with begun_print(tmp_path, "--stop", "turns=30", stderr=theirs) as (process, link):
        wait_for(lambda: any(flip.pattern != BLACK for flip in read_flips(link.mailboxes)))
        time.sleep(1.5)
        asked = time.monotonic()
        process.send_signal(signal.SIGINT)
        time.sleep(0.5)
        last = read_flips(link.mailboxes)[-1]
        assert last.pattern == BLACK
        assert last.monotonic_s - asked < 0.25
        assert process.wait(_PATIENCE_S) == 0
    os.close(ours)
    os.close(theirs)


def test_ctrl_z_ends_the_light_at_once_and_it_comes_back_with_the_print(tmp_path: Path) -> None:
    """A terminal sends it to every process of the print; one that stops all of them would leave the light on."""
    with begun_print(tmp_path, "--stop", "turns=30", process_group=0) as (process, link):
        wait_for(lambda: any(flip.pattern != BLACK for flip in read_flips(link.mailboxes)))
        time.sleep(1.0)
        asked = time.monotonic()
        os.killpg(process.pid, signal.SIGTSTP)
        time.sleep(1.0)
        last = read_flips(link.mailboxes)[-1]
        assert last.pattern == BLACK
        assert last.monotonic_s - asked < 0.25
        os.killpg(process.pid, signal.SIGCONT)
        wait_for(lambda: read_flips(link.mailboxes)[-1].pattern != BLACK)


def test_closed_terminal_does_not_keep_a_print_from_ending_well(tmp_path: Path) -> None:
    plan, rig = write_quick_plan(tmp_path)
    command = f"exec '{Path(sys.executable).with_name('vialight')}' print '{plan}' --rig '{rig}' --out '{tmp_path}/run'"
    command += f" --resin-voxel 0.4 --bin {BINNING} --rate 4 --stop turns=1 >/dev/null 2>&-"
    assert subprocess.run(["sh", "-c", command], timeout=_PATIENCE_S, check=False).returncode == 0
    assert read_json(tmp_path / "run" / "run.json")["state"] == "done"


def test_print_goes_on_after_its_live_measurement_was_killed(tmp_path: Path) -> None:
    with running_print(tmp_path, "--stop", "turns=4", "--rate", "2") as (process, link, run):
        child(process, "/snapshot").kill()
        out, told = process.communicate(timeout=_PATIENCE_S)
    assert process.returncode == 0, told
    result = json.loads(out)
    events = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert any("has ended" in entry.get("message", "") for entry in events if entry["event"] == "fault")
    assert any("again" in entry.get("message", "") for entry in events if entry["event"] == "live")
    assert result["printed"]["ended_by"] == "turns"
    assert result["printed"]["lit_turns"] == pytest.approx(4.0, abs=0.05)
    assert result["printed"]["refreshes"] > 0.9 * 32 * result["printed"]["lit_s"]
    assert result["printed"]["refreshes_not_due"] < 0.02 * result["printed"]["refreshes"]
    assert result["measured"] is not None
    printed, meant = load_mesh(run / "surface.stl"), load_mesh(run / "reference.stl")
    assert printed.volume_mm3 > 0.2 * meant.volume_mm3
    assert read_json(run / "run.json")["state"] == "done"
    assert list_history(run)
    volumes = read_series(run / "volumes.zarr")
    assert (np.diff(volumes.time_s) > 0).all()
    assert (volumes.volume(len(volumes) - 1).density > 55 * BINNING**2).sum() * volumes.grid.voxel_mm**3 == (
        pytest.approx(printed.volume_mm3, rel=0.1)
    )
    assert (run / "report.html").exists()
    assert not Path(link.mailboxes).exists()


def test_folder_that_holds_something_is_refused(tmp_path: Path) -> None:
    plan, rig = write_quick_plan(tmp_path)
    told = CliRunner().invoke(
        main, ["print", str(plan), "--rig", str(rig), "--out", str(tmp_path), "--stop", "turns=1"]
    )
    assert told.exit_code == 2
    assert "holds something already" in told.output


def test_stop_that_is_none_is_refused(tmp_path: Path) -> None:
    plan, rig = write_quick_plan(tmp_path)
    told = CliRunner().invoke(main, ["print", str(plan), "--rig", str(rig), "--out", "x", "--stop", "soon"])
    assert told.exit_code == 2
    assert "accepted: auto, manual, turns=N" in told.output


def print_on_instruments(folder: Path, *options: str) -> Any:
    """Try to print where the rig names real devices, none of which are there."""
    plan, rig = write_quick_plan(folder)
    text = rig.read_text()
    for table, driver in (("camera", "aravis"), ("stage", "pi"), ("projector", "window")):
        text = text.replace(f"[{table}]\n", f'[{table}]\ndriver = "{driver}"\n')
    rig.write_text(text + '[camera.settings]\ndevice = "there is none"\n')
    return CliRunner().invoke(main, ["print", str(plan), "--rig", str(rig), "--out", str(folder / "run"), *options])


@pytest.mark.parametrize("option", [("--rate", "4"), ("--bin", "2")])
def test_options_of_the_simulated_printer_are_refused_where_the_rig_names_real_devices(
    option: tuple[str, str], tmp_path: Path
) -> None:
    told = print_on_instruments(tmp_path, *option)
    assert told.exit_code == 2
    assert "the rig names real devices" in told.output
    assert not (tmp_path / "run").exists()


def test_print_of_few_turns_is_told_that_its_forecast_comes_late(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds = np.array([[60.0], [30.0]])
    model = StopModel(np.zeros((1, 3)), 0.2, np.array([0.7, 1.4]), seconds, 1.2 * seconds[:, 0], (), 18.0, np.zeros(12))
    monkeypatch.setattr(printing, "kept_stop_model", lambda *_, **__: model)
    told = print_on_instruments(tmp_path, "--stop", "auto").output
    assert "wants light for 2.8 turns, and a forecast comes too late below 5" in told


def test_print_whose_instruments_are_not_there_leaves_no_folder(tmp_path: Path) -> None:
    told = print_on_instruments(tmp_path, "--stop", "manual")
    assert told.exit_code == 1
    assert told.output.splitlines()[-1].startswith("vialight: camera")
    assert not (tmp_path / "run").exists()
