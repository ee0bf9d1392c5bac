import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vialight.errors import InputError
from vialight.links import Mailbox, shared_folder


@pytest.fixture
def folder() -> Iterator[Path]:
    made = shared_folder()
    yield made
    shutil.rmtree(made)


def test_slow_reader_skips_to_the_newest(folder: Path) -> None:
    with Mailbox(folder / "box", 10_000) as writer, Mailbox(folder / "box") as reader:
        for turn in range(10):
            writer.put(turn)
        assert reader.newest() == (10, 9)
        assert reader.newest(after=10) is None


def test_message_is_never_read_torn_while_it_is_replaced(folder: Path) -> None:
    with Mailbox(folder / "box", 1_100_000) as writer, Mailbox(folder / "box") as reader:
        done = threading.Event()

        def write() -> None:
            for value in range(400):
                writer.put(np.full(130_000, value, np.int64))
            done.set()

        thread = threading.Thread(target=write)
        thread.start()
        seen = 0
        while not done.is_set():
            found = reader.newest(after=seen)
            if found is not None:
                seen, values = found
                assert (values == seen - 1).all()
        thread.join()
        assert seen > 0


def test_another_process_reads_it(folder: Path) -> None:
    with Mailbox(folder / "box", 1000) as writer:
        writer.put("hello")
        code = f"from vialight.links import Mailbox; print(Mailbox({str(folder / 'box')!r}).newest())"
        told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told == "(1, 'hello')\n"


def test_message_larger_than_the_mailbox_is_refused(folder: Path) -> None:
    with Mailbox(folder / "box", 100) as writer, pytest.raises(ValueError, match="mailbox of 100"):
        writer.put(bytes(200))


def test_mailbox_of_a_print_that_is_gone_is_told(folder: Path) -> None:
    with pytest.raises(InputError, match="running print"):
        Mailbox(folder / "none")


def test_folders_of_dead_processes_are_cleared(folder: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    left = folder.parent / f"vialight-{ended.pid}-0"
    left.mkdir()
    shutil.rmtree(shared_folder())
    assert not left.exists()
    assert folder.exists()
    assert folder.stat().st_mode & 0o077 == 0
