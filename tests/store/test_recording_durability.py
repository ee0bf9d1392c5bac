"""What of a recording a power cut leaves, and a disk that refuses or takes nothing."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vialight.core.errors import InputError
from vialight.store import FrameTail, FrameWriter, durable, open_frames, recording
from vialight.system import wait_for

PAGE = 4096
SHAPE = (24, 30)


def frame_of(number: int) -> np.ndarray:
    return np.random.default_rng(number).integers(0, 65536, SHAPE, dtype=np.uint16)


def append(writer: FrameWriter, count: int) -> None:
    for _ in range(count):
        writer.append(frame_of(writer.count), 0.01 * writer.count, 0.1 * writer.count)


def after_a_power_cut(synced: bytes, now: bytes, random: np.random.Generator) -> bytes:
    """Mix pages of a file as it was at its last sync with pages of now; its length is either's."""
    length = len(synced) if random.random() < 0.5 else len(now)
    pages = []
    share = random.choice([0.0, 0.1, 0.5, 0.9, 1.0])
    for begin in range(0, length, PAGE):
        source = now if random.random() < share or begin >= len(synced) else synced
        # A page of the longer file that the shorter one does not have reads as zeros.
        pages.append(source[begin : begin + PAGE].ljust(PAGE, b"\0"))
    return b"".join(pages)[:length]


def opens_with(image: bytes, tables: bytes, count: int, folder: Path) -> None:
    path = folder / "torn.h5"
    path.write_bytes(image)
    durable.tables_beside(path).write_bytes(tables)
    with open_frames(path) as frames:
        assert frames.shape == (count, *SHAPE)
        np.testing.assert_allclose(frames.angles_rad, 0.01 * np.arange(count), atol=1e-12)
        assert frames.time_s is not None
        np.testing.assert_allclose(frames.time_s, 0.1 * np.arange(count), atol=1e-12)
        for number in np.unique(np.linspace(0, count - 1, 12).astype(int)):
            np.testing.assert_array_equal(frames.read(slice(number, number + 1))[0], frame_of(number))
        dark = frames.dark()
        assert dark is not None
        np.testing.assert_array_equal(dark, 7.0)
    path.unlink()


@pytest.mark.parametrize("first", [1, 3, 250, 1020, 2300])
def test_whatever_pages_a_power_cut_leaves_all_frames_of_the_last_sync_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
    path = tmp_path / "frames.h5"
    random = np.random.default_rng(first)
    torn = 0
    with FrameWriter(path, SHAPE, dark=np.full((5, *SHAPE), 7, np.uint16), sync_every_s=None) as writer:
        append(writer, first)
        for _ in range(4):
            append(writer, int(random.integers(0, 40)))
            assert writer.sync() is None
            synced, tables = path.read_bytes(), durable.tables_beside(path).read_bytes()
            stated = writer.durable_frames
            assert stated == writer.count
            append(writer, int(random.integers(1, 400)))
            now = path.read_bytes()
            with monkeypatch.context() as later:
                later.setattr(durable, "_this_boot", lambda: "a later start of the machine")
                for _ in range(5):
                    image = after_a_power_cut(synced, now, random)
                    opens_with(image, tables, stated, tmp_path)
                    torn += has_torn_tables(image, synced, tables)
    assert torn > 5  # or else this test would not try what it is for


def has_torn_tables(image: bytes, synced: bytes, tables: bytes) -> bool:
    """Tell whether what HDF5 itself would read is neither that of the sync nor anything that it wrote at once."""
    places = json.loads(tables.partition(b"\n")[0])["places"]
    return any(image[at : at + length] != synced[at : at + length] for at, length in places)


def test_a_power_cut_while_a_recording_is_closed_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "frames.h5"
    kept: list[bytes] = []
    writer = FrameWriter(path, SHAPE, dark=np.full(SHAPE, 7, np.uint16), sync_every_s=None)
    append(writer, 300)
    assert writer.sync() is None
    synced, tables = path.read_bytes(), durable.tables_beside(path).read_bytes()
    monkeypatch.setattr(recording, "forget_tables", lambda path: kept.append(path.read_bytes()))
    writer.close()
    monkeypatch.setattr(durable, "_this_boot", lambda: "a later start of the machine")
    random = np.random.default_rng(0)
    for _ in range(10):
        opens_with(after_a_power_cut(synced, kept[0], random), tables, 300, tmp_path)


def test_a_recording_that_was_closed_has_nothing_beside_it_and_is_whole_without(tmp_path: Path) -> None:
    path = tmp_path / "frames.h5"
    with FrameWriter(path, SHAPE, sync_every_s=0.01) as writer:
        append(writer, 50)
        assert wait_for(durable.tables_beside(path).exists, timeout_s=10) is None
    assert writer.durable_frames == 50
    assert [item.name for item in tmp_path.iterdir()] == ["frames.h5"]
    with open_frames(path) as frames:
        assert frames.shape[0] == 50
        assert not frames.is_live


def test_a_writer_that_was_merely_killed_loses_no_frame_to_its_last_sync(tmp_path: Path) -> None:
    path = tmp_path / "frames.h5"
    code = """
        import os, sys
        import numpy as np
        from vialight.store import FrameWriter
        writer = FrameWriter(sys.argv[1], (4, 5), sync_every_s=None)
        for index in range(30):
            writer.append(np.full((4, 5), index, np.uint16), index / 10, float(index))
            if index == 9:
                assert writer.sync() is None
        os.abort()
    """
    run_python(code, path)
    assert durable.tables_beside(path).exists()
    with open_frames(path) as frames:
        assert frames.shape[0] == 30


def test_a_torn_recording_is_followed_to_its_last_sync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "frames.h5"
    with FrameWriter(path, SHAPE, sync_every_s=None) as writer:
        append(writer, 20)
        assert writer.sync() is None
        append(writer, 5)
        monkeypatch.setattr(durable, "_this_boot", lambda: "a later start of the machine")
        tail = FrameTail(path)
        found = tail.new()
        assert found is not None
        assert len(found.counts) == 20
        assert tail.new() is None
        tail.close()


@pytest.mark.parametrize(
    "beside",
    [
        b"", b"\n", b"[]\n", b'{"boot": "x"}\n', b'{"boot": "x", "size": 1e400, "places": []}\n',
        b'{"boot": "x", "frames": 1, "size": 99999999999, "places": [[0, 5]]}\n12345',
        b'{"boot": "x", "frames": 1, "size": 100, "places": [[0, 4], [-3, 1]]}\n12345', b"[" * 100_000,
    ],
)  # fmt: skip
def test_what_does_not_fit_beside_a_recording_is_left_aside_or_refused_in_one_line(
    tmp_path: Path, beside: bytes
) -> None:
    path = tmp_path / "frames.h5"
    with FrameWriter(path, SHAPE) as writer:
        append(writer, 3)
    durable.tables_beside(path).write_bytes(beside)
    told = ""
    try:
        with open_frames(path) as frames:
            assert frames.shape[0] == 3
    except InputError as error:
        told = str(error)
    assert not told or "does not fit its recording" in told


def test_places_without_bytes_or_without_end_do_not_hold_up_a_reader(tmp_path: Path) -> None:
    path = tmp_path / "frames.h5"
    with FrameWriter(path, SHAPE) as writer:
        append(writer, 3)
    content = path.read_bytes()
    for places in ([[0, 48], *[[48, 0]] * 1_000_000], [[0, 48], *[[48 + k, 1] for k in range(1_000_000)]]):
        length = sum(length for _, length in places)
        header = {"boot": "x", "frames": 3, "size": len(content), "places": places}
        pieces = content[:48].ljust(length, b"\0")
        durable.tables_beside(path).write_bytes(json.dumps(header).encode() + b"\n" + pieces)
        with pytest.raises(InputError, match="does not fit its recording"):
            durable.open_torn(path)


def test_a_recording_of_many_places_is_read_as_quickly_as_one_of_few(tmp_path: Path) -> None:
    path, size, count = tmp_path / "frames.h5", 1_000_000, 60_000
    path.write_bytes(bytes(size))
    places = [(0, 48), *[(100 + 4 * k, 2) for k in range(count)]]
    patched = durable._Patched(path, size, places, b"\1" * (48 + 2 * count))
    began = time.monotonic()
    for k in range(0, count, 50):
        patched.seek(99 + 4 * k)
        assert patched.read(6) == b"\0\1\1\0\0\1"
    assert time.monotonic() - began < 2.0
    patched.seek(0)
    assert patched.read(150)[48:106] == bytes(52) + b"\1\1\0\0\1\1"
    patched.close()


def test_a_disk_that_does_not_sync_holds_up_no_frame_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stalled, at_once = threading.Event(), []

    def stall(descriptor: int) -> None:
        at_once.append(threading.current_thread())
        assert stalled.wait(30)

    monkeypatch.setattr(recording, "sync_descriptor", stall)
    path = tmp_path / "frames.h5"
    writer = FrameWriter(path, SHAPE, sync_every_s=0.01)
    try:
        append(writer, 1)
        assert wait_for(lambda: bool(at_once), timeout_s=5) is None
        begun = time.monotonic()
        append(writer, 100)
        assert time.monotonic() - begun < 5
        assert writer.sync(0.05) == "not within 0.05 s"
        assert (writer.durable_frames, writer.count, len(at_once)) == (0, 101, 1)
        assert writer.unsynced_s > 0
    finally:
        stalled.set()
    assert writer.sync() is None
    assert (writer.durable_frames, writer.unsynced_s) == (101, 0.0)
    assert len(set(at_once)) == 1
    writer.close()


def run_python(code: str, *arguments: Path | str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


RECORD_UNTIL_REFUSED = """
    import os, resource, sys
    import numpy as np
    from vialight.core.errors import InputError
    from vialight.store import FrameWriter
    {before}
    writer = None
    noise = np.random.default_rng(0).integers(0, 65536, (200, 300), dtype=np.uint16)
    try:
        with FrameWriter(sys.argv[1], (200, 300)) as writer:
            for index in range(200):
                if index == 20:
                    {then}
                writer.append(noise, index / 10, index / 10)
    except InputError as error:
        print(error)
    print(0 if writer is None else writer.count)
"""


@pytest.mark.parametrize("limit", [1_000, 100_000, 3_000_000, 6_000_001])
def test_a_limit_on_the_size_of_files_ends_a_recording_in_order(tmp_path: Path, limit: int) -> None:
    before = f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))"
    done = run_python(RECORD_UNTIL_REFUSED.format(before=before, then="pass"), tmp_path / "f.h5")
    assert done.returncode == 0, done.stderr
    message, count = done.stdout.splitlines()
    assert "f.h5: the disk is full" in message
    expect_frames(tmp_path / "f.h5", int(count))
    assert (int(count) > 5) == (limit > 1_000_000)


@pytest.mark.parametrize("also", ["", "; writer.sync(0.1)"])
def test_a_file_that_refuses_writes_while_it_is_recorded_does_not_bring_the_process_down(
    tmp_path: Path, also: str
) -> None:
    # As a disk that fails, or is made read-only under a running recording.
    then = "os.dup2(os.open(sys.argv[1], os.O_RDONLY), writer._file.id.get_vfd_handle())" + also
    done = run_python(RECORD_UNTIL_REFUSED.format(before="", then=then), tmp_path / "f.h5")
    assert done.returncode == 0, done.stderr
    message, count = done.stdout.splitlines()
    assert "f.h5: cannot be written" in message
    assert count == "20"
    expect_frames(tmp_path / "f.h5", 20)


def test_a_disk_that_is_full_from_the_start_leaves_no_file(small_disk: Path) -> None:
    with (small_disk / "other").open("wb") as file:
        file.write(bytes((4 << 20) - 2 * PAGE))
    done = run_python(RECORD_UNTIL_REFUSED.format(before="", then="pass"), small_disk / "f.h5")
    assert done.returncode == 0, done.stderr
    assert "the disk is full" in done.stdout
    assert [item.name for item in small_disk.iterdir()] == ["other"]


def expect_frames(path: Path, count: int) -> None:
    if count == 0:
        assert not path.exists()
        return
    with open_frames(path) as frames:
        assert frames.shape[0] == len(frames.read(slice(None))) == count


def test_a_json_that_shall_be_durable_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vialight.store import results

    done: list[str] = []

    def note(name: str) -> Callable[..., None]:
        return lambda *given: done.append(name)

    monkeypatch.setattr(results, "sync_descriptor", note("file"))
    monkeypatch.setattr(results, "sync_folder", lambda folder: done.append(f"folder {(folder / 'r.json').exists()}"))
    results.write_json(tmp_path / "r.json", {"a": 1})
    assert done == []
    results.write_json(tmp_path / "r.json", {"a": 2}, durable=True)
    assert done == ["file", "folder True"]
    assert json.loads((tmp_path / "r.json").read_text()) == {"a": 2}
