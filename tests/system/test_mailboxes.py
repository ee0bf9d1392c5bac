"""Mailboxes: the newest message, whole, and only what it is meant to be."""

from __future__ import annotations

import errno
import json
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from vialight.core.codec import decoder_of, encode
from vialight.core.errors import InputError
from vialight.system import make_shared_file, scratch_folder, shared_folder
from vialight.system.mailboxes import Mailbox

PATIENCE_S = 30.0


@dataclass(frozen=True)
class Values:
    """A message with an array."""

    numbers: NDArray[np.int64]
    number: int = 0


@pytest.fixture
def folder() -> Iterator[Path]:
    made = shared_folder()
    yield made
    shutil.rmtree(made)


def test_slow_reader_skips_to_the_newest(folder: Path) -> None:
    with Mailbox(folder / "box", int, 10_000) as writer, Mailbox(folder / "box", int) as reader:
        for turn in range(10):
            writer.put(turn)
        assert reader.newest() == (10, 9)
        assert reader.newest(after=10) is None


WRITER = """
import sys
import numpy as np
from vialight.system.mailboxes import Mailbox
from system.test_mailboxes import Values
with Mailbox(sys.argv[1], Values, 1_100_000) as writer:
    print("ready", flush=True)
    for value in range(2000):
        writer.put(Values(np.full(130_000, value, np.int64), value))
"""


def test_message_is_never_read_torn_while_another_process_replaces_it(folder: Path) -> None:
    paths = [str(Path(__file__).parents[1]), *sys.path]
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder / "box")], stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    seen = taken = 0
    with Mailbox(folder / "box", Values) as reader:
        while process.poll() is None:
            found = reader.newest(after=seen)
            if found is not None:
                seen, taken = found[0], taken + 1
                assert (found[1].numbers == seen - 1).all()
                assert found[1].number == seen - 1
        assert reader.newest() is not None
    process.stdout.close()
    assert process.wait() == 0
    assert taken > 20


def test_another_process_reads_it(folder: Path) -> None:
    with Mailbox(folder / "box", str, 1000) as writer:
        writer.put("hello")
        code = f"from vialight.system.mailboxes import Mailbox; print(Mailbox({str(folder / 'box')!r}, str).newest())"
        told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told == "(1, 'hello')\n"


def test_message_larger_than_the_mailbox_is_refused(folder: Path) -> None:
    with Mailbox(folder / "box", bytes, 100) as writer, pytest.raises(ValueError, match="mailbox of 104"):
        writer.put(bytes(200))


def test_mailbox_of_a_print_that_is_gone_is_told(folder: Path) -> None:
    with pytest.raises(InputError, match="running print"):
        Mailbox(folder / "none", int)


def test_volume_larger_than_the_memory_that_is_free_is_refused_before_anything_is_written(folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    with pytest.raises(InputError, match=r"has no room for .* MB of shared memory .*docker run --shm-size"):
        make_shared_file(folder / "volume", 10 * free)
    assert not list(folder.glob("volume*"))


def test_message_for_which_no_memory_is_left_is_refused_and_the_one_before_stays(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int, start: int, size: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Mailbox(folder / "box", bytes, 10_000) as writer, Mailbox(folder / "box", bytes) as reader:
        writer.put(b"one")
        monkeypatch.setattr(os, "posix_fallocate", full)
        with pytest.raises(InputError, match="has no room"):
            writer.put(bytes(9000))
        assert reader.newest() == (1, b"one")


@pytest.mark.parametrize("head", [(2**63, 2**63), (1, 0), (2**64 - 1, 2**64 - 1), (7, 100)])
def test_numbers_of_nonsense_in_a_mailbox_are_no_message(folder: Path, head: tuple[int, int]) -> None:
    with Mailbox(folder / "box", int, 100):
        with (folder / "box").open("r+b") as file:
            file.write(struct.pack("<QQ", *head))
        with Mailbox(folder / "box", int) as reader:
            assert reader.newest() is None


@pytest.mark.parametrize(
    "message",
    [
        {"numbers": ("<i8", (3,), bytes(16))},
        {"numbers": ("<i8", (-1, -2), bytes(16))},
        {"numbers": ("<i8", (2**40, 2**40), bytes(16))},
        {"numbers": ("<f8", (2,), bytes(16))},
        {"numbers": ("|O", (2,), bytes(16))},
        {"numbers": "text"},
        {"number": 3},
        [1, 2],
    ],
)
def test_message_that_does_not_fit_its_schema_is_refused(message: object) -> None:
    with pytest.raises(ValueError, match="is no Values"):
        decoder_of(Values)(encode(message))


def test_arrays_come_back_as_they_were() -> None:
    values = np.arange(12, dtype=np.int64).reshape(3, 4)[:, ::2]
    found = decoder_of(Values)(encode(Values(values)))
    assert found.numbers.dtype == values.dtype
    assert (found.numbers == values).all()


def test_folders_of_dead_processes_are_cleared_and_nothing_else(folder: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    left = folder.parent / f"vialight-{ended.pid}-00000000"
    left.mkdir(mode=0o700)
    not_ours = folder.parent / f"vialight-{ended.pid}-notours"
    not_ours.mkdir(mode=0o700)
    reused = folder.parent / f"vialight-{os.getpid()}-11111111"
    reused.mkdir(mode=0o700)
    owner = json.loads((folder / "owner.json").read_text())
    owner["process"][1] = "another time"
    (reused / "owner.json").write_text(json.dumps(owner))
    elsewhere = folder.parent / f"vialight-{ended.pid}-33333333"
    elsewhere.mkdir(mode=0o700)
    (elsewhere / "owner.json").write_text(json.dumps(owner | {"numbers": "pid:[another container]"}))
    open_to_all = folder.parent / f"vialight-{ended.pid}-22222222"
    open_to_all.mkdir(mode=0o700)
    open_to_all.chmod(0o777)
    try:
        shutil.rmtree(shared_folder())
        assert not left.exists()
        assert not reused.exists()  # its process number is in use again, by another process
        assert not_ours.exists()
        assert elsewhere.exists()
        assert open_to_all.exists()
        assert folder.exists()
        assert folder.stat().st_mode & 0o077 == 0
        on_disk = scratch_folder()
        assert not on_disk.is_relative_to(folder.parent)
        assert on_disk.stat().st_mode & 0o077 == 0
        shutil.rmtree(on_disk)
    finally:
        for made in (left, not_ours, reused, open_to_all, elsewhere):
            shutil.rmtree(made, ignore_errors=True)


def test_mailbox_that_another_writer_has_made_anew_is_told_from_one_in_which_nothing_comes(folder: Path) -> None:
    with Mailbox(folder / "box", int, 100) as first, Mailbox(folder / "box", int) as reader:
        first.put(1)
        assert not reader.is_replaced
        with Mailbox(folder / "box", int, 100):
            assert reader.is_replaced
