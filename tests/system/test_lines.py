"""Who has something to say never waits for the place it goes to."""

from __future__ import annotations

import threading
import time

from vialight.system import LineWriter


def test_lines_come_in_their_order_and_are_written_when_flushed() -> None:
    written: list[str] = []
    writer = LineWriter(written.append)
    for number in range(100):
        writer.put(f"{number}\n")
    assert writer.flush()
    assert "".join(written) == "".join(f"{number}\n" for number in range(100))
    assert writer.close()


def test_place_that_is_stalled_holds_nobody_up_and_loses_only_what_finds_no_room() -> None:
    goes_on = threading.Event()
    written: list[str] = []

    def write(text: str) -> None:
        goes_on.wait(10)
        written.append(text)

    writer = LineWriter(write, most=10)
    begin = time.monotonic()
    for number in range(50):
        writer.put(f"{number};")
    assert not writer.flush(0.05)
    assert time.monotonic() - begin < 0.5
    assert writer.dropped >= 35
    goes_on.set()
    assert writer.close()
    kept = "".join(written).rstrip(";").split(";")
    assert len(kept) + writer.dropped == 50


def test_place_that_is_full_or_closed_ends_nothing() -> None:
    def write(text: str) -> None:
        raise OSError("no space left on device")

    writer = LineWriter(write)
    writer.put("lost")
    assert writer.flush()
    assert writer.dropped == 1
    assert writer.close()
