"""Whole prints on the simulated printer, and what becomes of them when something fails."""

from __future__ import annotations

import csv
import json
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from printing.prints import SPEED_DEG_S, TURN_S, Bystander, quick_print, quick_printer
from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError
from vialight.core.messages import PrintStatus, StopForecast
from vialight.devices import DeviceError
from vialight.devices.simulated import Mishaps
from vialight.devices.simulated.display import BLACK, Flip, read_flips
from vialight.devices.simulated.motion import Segments, angle_at
from vialight.printing.live_link import find_live_print
from vialight.printing.order_channel import send_order
from vialight.printing.settings import PrintSettings
from vialight.store import FrameWriter, open_frames

pytestmark = pytest.mark.alone


def events(run: Path, kind: str) -> list[dict[str, Any]]:
    lines = (run / "log.jsonl").read_text().splitlines()
    return [entry for entry in map(json.loads, lines) if entry["event"] == kind]


def dark_stretches(flips: list[Flip]) -> list[float]:
    """How long each stretch of black between light lasted, on the print's clock."""
    lit = [flip.pattern != BLACK for flip in flips]
    first = lit.index(True)
    starts = [flip.time_s for flip, is_lit in zip(flips[first:], lit[first:], strict=True) if not is_lit]
    ends = [b.time_s for a, b in zip(flips[first:], flips[first + 1 :], strict=False) if a.pattern == BLACK]
    return [end - start for start, end in zip(starts, ends, strict=False)]


def patterns_off(flips: list[Flip], segments: Segments) -> FloatArray:
    """By how many patterns each image was off where the stage truly was in the middle of a refresh."""
    due = np.array([np.rad2deg(angle_at(segments, flip.time_s + 0.5 / 32)) / 4 for flip in flips])
    off = np.array([flip.pattern for flip in flips]) - due
    return np.asarray(np.abs((off + 45) % 90 - 45), dtype=np.float64)


def test_print_of_two_turns_has_light_for_two_turns_and_images_for_three(tmp_path: Path) -> None:
    with quick_printer(tmp_path) as printer:
        told = quick_print(tmp_path, printer)
        flips = read_flips(printer.folder)
        time.sleep(1.5)  # frames come and nobody takes them
        truth = printer.write_truth(tmp_path / "truth.stl")
    assert told["ended_by"] == "turns"
    assert told["lit_turns"] == pytest.approx(2.0, abs=0.03)
    assert told["fault"] is None
    assert told["doubts"] == []  # the background is that of the rig's vial
    assert truth is not None
    with open_frames(tmp_path / "run" / "frames.h5") as frames:
        assert not frames.is_live
        turned = np.ptp(frames.angles_rad) / (2 * np.pi)
        assert 3.0 < turned < 4.5
        assert frames.shape[0] == told["frames"]
        assert told["frames_missed"] == 0
        assert np.diff(frames.angles_rad).min() > 0
        background = frames.dark()
        assert background is not None
        assert np.abs(background - frames.read(slice(0, 1))[0]).mean() < 40
    assert flips[-1].pattern == BLACK
    assert sum(dark_stretches(flips)) < 0.3  # on a busy machine a lease may lapse
    assert find_live_print(tmp_path / "run") is None


def test_pattern_shown_is_the_one_due_to_within_a_refresh(tmp_path: Path) -> None:
    with quick_printer(tmp_path, rate=1.0) as printer:
        quick_print(tmp_path, printer)
        flips = read_flips(printer.folder)
        segments = printer.devices.stage._segments  # type: ignore[attr-defined]
    with (tmp_path / "run" / "projector.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["shown"] != "-1"]
    late = sum(row["due"] != row["shown"] for row in rows)
    assert len(rows) > 2 * TURN_S * 32 * 0.9
    assert late <= 0.02 * len(rows)
    # What was on the screen, against where the stage truly was: a refresh either way, and half a pattern.
    lit = [flip for flip in flips if flip.pattern != BLACK]
    assert np.percentile(patterns_off(lit, segments), 99) <= 0.5 + SPEED_DEG_S / 32 / 4


def test_stop_order_turns_the_light_off_at_once_and_the_print_ends_well(tmp_path: Path) -> None:
    ordered: dict[str, float] = {}

    def stop_soon() -> None:
        while not ordered:
            link = find_live_print(tmp_path / "run")
            if link is not None and any(flip.pattern != BLACK for flip in read_flips(printer.folder)):
                time.sleep(0.2)
                ordered["at"] = time.monotonic()
                send_order(link, {"do": "stop", "by": "page"})
            time.sleep(0.01)

    with quick_printer(tmp_path) as printer:
        thread = threading.Thread(target=stop_soon)
        thread.start()
        told = quick_print(tmp_path, printer, settings=PrintSettings("manual", longest_turns=8.0))
        thread.join()
        black = next(flip for flip in read_flips(printer.folder) if flip.pattern == BLACK)
    assert told["ended_by"] == "page"
    assert 0 < black.monotonic_s - ordered["at"] < 0.25
    assert events(tmp_path / "run", "order")[0]["order"] == {"do": "stop", "by": "page"}


def test_extension_and_mode_are_obeyed_and_nonsense_is_refused(tmp_path: Path) -> None:
    answers: list[Any] = []

    def order() -> None:
        while (link := find_live_print(tmp_path / "run")) is None:
            time.sleep(0.01)
        for wanted in ({"do": "extend", "turns": 0.5}, {"do": "mode", "mode": "never"}, {"do": "extend", "turns": "x"}):
            try:
                answers.append(send_order(link, wanted))
            except InputError as error:
                answers.append(str(error))

    with quick_printer(tmp_path) as printer:
        thread = threading.Thread(target=order)
        thread.start()
        told = quick_print(tmp_path, printer, turns=1.0)
        thread.join()
    assert told["lit_turns"] == pytest.approx(1.5, abs=0.03)
    assert answers[0]["extra_turns"] == 0.5
    assert "accepted: stop, extend, mode" in answers[1]
    assert "accepted: a number of turns" in answers[2]


def test_forecast_ends_the_print_within_a_turn(tmp_path: Path) -> None:
    watcher = Bystander([StopForecast(1.4 * TURN_S, 0.1, "seen to cure")])
    with quick_printer(tmp_path) as printer:
        told = quick_print(tmp_path, printer, watcher=watcher, settings=PrintSettings("auto", longest_turns=4.0))
    assert told["ended_by"] == "auto"
    assert told["lit_s"] == pytest.approx(1.4 * TURN_S, abs=0.1)
    assert events(tmp_path / "run", "stop")[0]["forecast"]["why"] == "seen to cure"


def test_interrupt_turns_the_light_off_first_and_ends_the_print_well(tmp_path: Path) -> None:
    asked = {"stop": False}

    def status(now: PrintStatus) -> None:
        asked["stop"] = asked["stop"] or now.lit_s > 0.5

    with quick_printer(tmp_path) as printer:
        told = quick_print(tmp_path, printer, turns=6.0, keep_going=lambda: not asked["stop"], on_status=status)
    assert told["ended_by"] == "operator"
    assert told["lit_turns"] < 3.0
    with open_frames(tmp_path / "run" / "frames.h5") as frames:
        assert np.ptp(frames.angles_rad) > told["lit_turns"] * 2 * np.pi + 2 * np.pi * 0.95


def test_second_interrupt_gives_up_the_rest_but_not_the_frames(tmp_path: Path) -> None:
    def status(now: PrintStatus) -> None:
        if now.lit_s > 0.5:
            raise KeyboardInterrupt

    with quick_printer(tmp_path) as printer:
        with pytest.raises(KeyboardInterrupt):
            quick_print(tmp_path, printer, turns=6.0, on_status=status)
        time.sleep(0.2)
        assert read_flips(printer.folder)[-1].pattern == BLACK
    with open_frames(tmp_path / "run" / "frames.h5") as frames:
        assert frames.shape[0] > 5


def test_camera_that_is_silent_for_two_seconds_holds_the_light_and_then_the_print_goes_on(tmp_path: Path) -> None:
    """Dark within 0.25 s of the frame that did not come."""
    silent = (6.05, 8.0)  # the frame due at 6.1 does not come
    with quick_printer(tmp_path, rate=1.0, mishaps=Mishaps(camera_silent_s=silent)) as printer:
        told = quick_print(tmp_path, printer, turns=2.0)
        flips = read_flips(printer.folder)
    assert told["ended_by"] == "turns"
    assert told["lit_turns"] == pytest.approx(2.0, abs=0.05)
    went_dark = [flip.time_s for flip in flips if flip.pattern == BLACK and flip.time_s > silent[0]]
    assert went_dark[0] - 6.1 < 0.25
    assert any(1.5 < stretch < 2.5 for stretch in dark_stretches(flips))


def test_stage_that_stops_gets_no_light_and_ends_the_print(tmp_path: Path) -> None:
    stopped = 6.0
    with quick_printer(tmp_path, rate=1.0, mishaps=Mishaps(stage_stops_at_s=stopped)) as printer:
        told = quick_print(tmp_path, printer, turns=9.0, give_up_s=1.5)
        flips = read_flips(printer.folder)
    assert told["ended_by"] == "fault"
    assert "stage: turns at" in told["fault"]
    black = [flip.time_s for flip in flips if flip.pattern == BLACK and flip.time_s > stopped]
    assert black[0] - stopped < 0.25
    with open_frames(tmp_path / "run" / "frames.h5") as frames:
        assert frames.shape[0] > 10


def test_stage_that_no_longer_answers_gets_no_light(tmp_path: Path) -> None:
    silent = 6.0
    with quick_printer(tmp_path, rate=1.0, mishaps=Mishaps(stage_silent_at_s=silent)) as printer:
        told = quick_print(tmp_path, printer, turns=9.0, give_up_s=1.0)
        flips = read_flips(printer.folder)
    assert told["ended_by"] == "fault"
    black = [flip.time_s for flip in flips if flip.pattern == BLACK and flip.time_s > silent]
    assert black[0] - silent < 0.25


def test_stage_that_slows_by_a_fifth_still_gets_every_pattern_at_its_angle(tmp_path: Path) -> None:
    with quick_printer(tmp_path, rate=1.0, mishaps=Mishaps(stage_slow_at_s=5.0)) as printer:
        told = quick_print(tmp_path, printer, turns=2.0, doubts=["[calibration.axis] is 120 days old"])
        flips = read_flips(printer.folder)
        segments = printer.devices.stage._segments  # type: ignore[attr-defined]
    assert told["lit_turns"] == pytest.approx(2.0, abs=0.03)
    assert told["doubts"] == [entry["message"] for entry in events(tmp_path / "run", "doubt")]
    assert "[calibration.axis] is 120 days old" in told["doubts"]
    slow = [flip for flip in flips if flip.pattern != BLACK and flip.time_s > 5.2]
    assert len(slow) > 50
    assert np.percentile(patterns_off(slow, segments), 99) <= 0.5 + SPEED_DEG_S / 32 / 4


def test_lost_doubled_and_swapped_frames_and_a_jump_of_time_leave_angles_right(tmp_path: Path) -> None:
    mishaps = Mishaps(lost_share=0.05, doubled_share=0.05, swapped_share=0.2, time_jump_at_s=9.0, time_jump_s=100.0)
    with quick_printer(tmp_path, mishaps=mishaps) as printer:
        told = quick_print(tmp_path, printer, turns=3.0)
        segments = printer.devices.stage._segments  # type: ignore[attr-defined]
    assert told["ended_by"] == "turns"
    assert told["frames_missed"] > 0
    odd = [entry["odd"] for entry in events(tmp_path / "run", "frame")]
    assert "came twice" in odd
    assert any("its time is off by" in text for text in odd)
    with open_frames(tmp_path / "run" / "frames.h5") as frames:
        assert frames.time_s is not None
        assert (np.diff(frames.time_s) < 0).any()  # swapped ones are kept as they came
        truth = np.array([angle_at(segments, time) for time in frames.time_s])
        assert np.abs(np.rad2deg(frames.angles_rad - truth)).max() < 0.5
        assert np.ptp(frames.time_s) < 60


def test_full_disk_turns_the_light_off_and_keeps_what_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    append = FrameWriter.append

    def fill_up(self: FrameWriter, *given: Any) -> None:
        if self.path.name == "frames.h5" and self.count >= 20:
            raise InputError(self.path, "the disk is full (0.0 MB free); 20 frames are safe")
        append(self, *given)

    monkeypatch.setattr(FrameWriter, "append", fill_up)
    with quick_printer(tmp_path) as printer:
        told = quick_print(tmp_path, printer, turns=9.0, give_up_s=1.0)
    assert told["ended_by"] == "fault"
    assert "the disk is full" in (told["fault"] or "")
    assert told["lit_turns"] < 2.0
    with open_frames(tmp_path / "run" / "frames.h5") as frames:
        assert frames.shape[0] == 20


def test_projector_that_is_killed_leaves_black_and_ends_the_print(tmp_path: Path) -> None:
    killed: dict[str, float] = {}

    def status(now: PrintStatus) -> None:
        if now.lit_s > 0.5 and not killed:
            killed["at"] = time.monotonic()
            os.kill(printer.projector.pid, signal.SIGKILL)

    with quick_printer(tmp_path) as printer:
        told = quick_print(tmp_path, printer, turns=9.0, give_up_s=1.0, on_status=status)
        last = read_flips(printer.folder)[-1]
    assert told["ended_by"] == "fault"
    assert "projector" in told["fault"]
    assert last.pattern == BLACK
    assert last.monotonic_s - killed["at"] < 0.25


def test_watcher_with_a_fault_holds_the_light(tmp_path: Path) -> None:
    watcher, seen = Bystander(), []

    def status(now: PrintStatus) -> None:
        seen.append(now.state)
        watcher.told = "the follower has ended" if now.lit_s > 0.5 and "dark" not in seen else None

    with quick_printer(tmp_path) as printer:
        told = quick_print(tmp_path, printer, watcher=watcher, on_status=status)
        stretches = dark_stretches(read_flips(printer.folder))
    assert told["ended_by"] == "turns"
    assert stretches


def test_live_measurement_that_cannot_begin_ends_the_print_before_any_light(tmp_path: Path) -> None:
    class NeverBegins(Bystander):
        def is_ready(self) -> bool:
            return False

        def has_ended(self) -> bool:
            return True

    with quick_printer(tmp_path) as printer:
        with pytest.raises(DeviceError, match="live measurement: /dev/shm has no room"):
            quick_print(tmp_path, printer, watcher=NeverBegins(told="/dev/shm has no room"))
        assert read_flips(printer.folder) == []


def test_saturated_camera_is_refused_before_any_light(tmp_path: Path) -> None:
    with quick_printer(tmp_path) as printer:
        printer.devices.camera.full_level = 700  # type: ignore[misc]
        with pytest.raises(InputError, match="saturated"):
            quick_print(tmp_path, printer)
        assert read_flips(printer.folder) == []
    assert not (tmp_path / "run" / "frames.h5").exists()


def test_small_disk_is_refused_before_any_light(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vialight.printing.preflight.room_for", lambda *_: (10**12, 10**9))
    with quick_printer(tmp_path) as printer:
        with pytest.raises(InputError, match=r"may take 1000\.00 GB"):
            quick_print(tmp_path, printer)
        assert read_flips(printer.folder) == []


def test_ctrl_c_at_a_terminal_leaves_the_processes_of_a_print_to_it(tmp_path: Path) -> None:
    with quick_printer(tmp_path) as printer:
        for pid in (printer.projector.pid, *(process.pid for process in printer.processes.values())):
            status = (Path("/proc") / str(pid) / "status").read_text(encoding="utf-8")
            ignored = int(status.split("SigIgn:")[1].split()[0], 16)
            assert ignored & 1 << (signal.SIGINT - 1)


def test_simulated_printer_that_was_stopped_is_ended_all_the_same(tmp_path: Path) -> None:
    with quick_printer(tmp_path) as printer:
        os.kill(printer.processes["world"].pid, signal.SIGSTOP)
    assert not any(process.is_alive() for process in printer.processes.values())
    assert not printer.folder.exists()
