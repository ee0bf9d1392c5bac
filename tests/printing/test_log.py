"""The log of a print: whoever notes something neither waits nor fails, whatever the disk does."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from vialight.devices import MonotonicClock
from vialight.printing import log as log_module
from vialight.printing.log import EventLog


def lines_of(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_what_is_noted_is_in_the_file_in_its_order_once_it_is_closed(tmp_path: Path) -> None:
    log = EventLog(tmp_path / "log.jsonl", MonotonicClock())
    for number in range(500):
        log.note("frame", number=number)
    log.note("state", "light on")
    assert log.last == "light on"
    log.close(10.0)
    entries = lines_of(tmp_path / "log.jsonl")
    assert [entry.get("number") for entry in entries[:-1]] == list(range(500))
    assert entries[-1]["message"] == "light on"


def test_a_disk_that_takes_nothing_holds_up_nobody_and_what_is_dropped_is_told_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_module, "_WAITING", 50)
    path = tmp_path / "log.jsonl"
    os.mkfifo(path)  # nobody reads it: to open it waits without end
    log = EventLog(path, MonotonicClock())
    begun = time.monotonic()
    for number in range(1000):
        log.note("frame", f"the {number}th", number=number)
    assert time.monotonic() - begun < 1.0
    assert log.last == "the 999th"
    assert log.dropped >= 949
    begun = time.monotonic()
    log.close(0.2)
    assert time.monotonic() - begun < 1.0
    with path.open("rb") as reader:
        told = [json.loads(line) for line in reader.read().splitlines()]
    assert any("events could not be written here" in str(entry.get("message")) for entry in told)


class Awkward:
    def __str__(self) -> str:
        raise RuntimeError("no name")


def test_a_detail_that_cannot_be_written_costs_only_itself(tmp_path: Path) -> None:
    log = EventLog(tmp_path / "log.jsonl", MonotonicClock())
    circle: list[object] = []
    circle.append(circle)
    log.note("order", "odd", detail=Awkward())
    log.note("order", "round", detail=circle)
    log.note("order", "keys", detail={(1, 2): 3})
    log.close(5.0)
    assert [entry["message"] for entry in lines_of(tmp_path / "log.jsonl")] == ["odd", "round", "keys"]


def test_a_full_disk_leaves_whole_lines_and_their_loss_is_told_when_there_is_room_again(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    log = EventLog(path, MonotonicClock())
    kept = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, kept[1]))
    try:
        for number in range(100):
            log.note("frame", number=number)
        deadline = time.monotonic() + 5.0
        while log.dropped < 80 and time.monotonic() < deadline:
            time.sleep(0.01)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, kept)
    log.note("frame", number=100)
    log.close(5.0)
    entries = lines_of(path)
    dropped = 100 - (len(entries) - 2)
    assert entries[-2]["message"] == f"{dropped} events could not be written here"
    assert entries[-1]["number"] == 100


def test_a_log_that_nobody_closed_is_whole_when_the_process_ends(tmp_path: Path) -> None:
    code = """
        import sys
        from pathlib import Path
        from vialight.devices import MonotonicClock
        from vialight.printing.log import EventLog
        log = EventLog(Path(sys.argv[1]), MonotonicClock())
        for number in range(300):
            log.note("frame", number=number)
    """
    path = tmp_path / "log.jsonl"
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code), str(path)], timeout=60, check=True)
    assert done.returncode == 0
    assert len(lines_of(path)) == 300
