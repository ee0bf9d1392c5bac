from __future__ import annotations

import os
import shutil
import signal
import stat
import subprocess
import sys
import textwrap
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from vialight.core.errors import InputError
from vialight.store import staged_file, staged_folder

Stage = Callable[[Path], AbstractContextManager[Path]]


def contents(folder: Path) -> dict[str, str]:
    return {item.relative_to(folder).as_posix(): item.read_text() for item in folder.rglob("*") if item.is_file()}


def start_python(code: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    """A folder with results of a former run and a note of the user."""
    out = tmp_path / "out"
    (out / "volume.zarr").mkdir(parents=True)
    (out / "volume.zarr" / "old").write_text("old")
    (out / "surface.stl").write_text("old")
    (out / "notes.txt").write_text("mine")
    return out


FILLED = {"volume.zarr/old": "old", "surface.stl": "old", "notes.txt": "mine"}


def fill(folder: Path) -> None:
    (folder / "volume.zarr").mkdir()
    (folder / "volume.zarr" / "new").write_text("new")
    (folder / "surface.stl").write_text("new")
    (folder / "result.json").write_text("new")


PRODUCED = {"volume.zarr/new": "new", "surface.stl": "new", "result.json": "new"}


def test_a_new_folder_appears_when_it_is_complete(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with staged_folder(out) as folder:
        fill(folder)
        assert not out.exists()
    assert contents(out) == PRODUCED
    assert list(tmp_path.iterdir()) == [out]


def test_products_replace_their_namesakes_and_leave_the_rest(filled: Path) -> None:
    with staged_folder(filled) as folder:
        fill(folder)
        assert {name: text for name, text in contents(filled).items() if not name.startswith(".")} == FILLED
    assert contents(filled) == PRODUCED | {"notes.txt": "mine"}
    assert sorted(item.name for item in filled.iterdir()) == ["notes.txt", "result.json", "surface.stl", "volume.zarr"]


def test_a_file_may_replace_a_folder_and_a_folder_a_file(filled: Path) -> None:
    with staged_folder(filled) as folder:
        (folder / "volume.zarr").write_text("a file now")
        (folder / "surface.stl").mkdir()
    assert (filled / "volume.zarr").read_text() == "a file now"
    assert list((filled / "surface.stl").iterdir()) == []


@pytest.mark.parametrize("failure", [ValueError("no"), KeyboardInterrupt(), SystemExit(1), InputError("a", "b")])
def test_a_failure_leaves_everything_as_it_was(tmp_path: Path, filled: Path, failure: BaseException) -> None:
    def fill_and_fail(out: Path) -> None:
        with staged_folder(out) as folder:
            fill(folder)
            raise failure

    for out in (filled, tmp_path / "new"):
        with pytest.raises(type(failure)):
            fill_and_fail(out)
    assert contents(filled) == FILLED
    assert list(tmp_path.iterdir()) == [filled]


def test_the_interrupt_of_a_real_process_leaves_everything_as_it_was(tmp_path: Path) -> None:
    code = """
        import signal, sys, time
        from vialight.store import staged_folder
        # What is started in the background inherits that interrupts are ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with staged_folder(sys.argv[1]) as folder:
            (folder / "surface.stl").write_text("half")
            print("ready", flush=True)
            time.sleep(60)
    """
    with start_python(code, tmp_path / "out") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        assert list(tmp_path.iterdir())
        process.send_signal(signal.SIGINT)
        assert process.wait(30) != 0
    assert not list(tmp_path.iterdir())


def test_a_failure_while_moving_puts_back_what_was(filled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace = Path.replace

    def refuse_volume(source: Path, target: Path) -> Path:
        if source.parent.name.startswith(".") and target.name == "volume.zarr":
            raise PermissionError(1, "Operation not permitted")
        return replace(source, target)

    monkeypatch.setattr(Path, "replace", refuse_volume)  # the last of the three in the order of names
    with pytest.raises(InputError, match="out: cannot be written"), staged_folder(filled) as folder:
        fill(folder)
    assert contents(filled) == FILLED
    assert sorted(item.name for item in filled.iterdir()) == ["notes.txt", "surface.stl", "volume.zarr"]


def test_without_hard_links_products_are_replaced_all_the_same(filled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_links(*_: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    with staged_folder(filled) as folder:
        fill(folder)
    assert contents(filled) == PRODUCED | {"notes.txt": "mine"}


def test_a_file_in_place_of_the_folder_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError, match="out: is a file"), staged_folder(tmp_path / "out"):
        pytest.fail("the work must not start")
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize("stage", [staged_folder, staged_file])
def test_a_missing_parent_is_refused_at_once(tmp_path: Path, stage: Stage) -> None:
    with pytest.raises(InputError, match=r"there is no folder .*/nowhere"), stage(tmp_path / "nowhere" / "out"):
        pytest.fail("the work must not start")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="no /proc, in which not even root can write, on this system"
)
@pytest.mark.parametrize("out", [Path("/proc/out"), Path("/proc")])
@pytest.mark.parametrize("stage", [staged_folder, staged_file])
def test_a_place_that_nobody_may_write_is_refused_at_once(out: Path, stage: Stage) -> None:
    with pytest.raises(InputError, match=r"^/proc.*: (cannot be written|is a folder)") as caught, stage(out):
        pytest.fail("the work must not start")
    assert "\n" not in str(caught.value)


def test_a_read_only_file_system_is_refused_at_once(small_disk: Path) -> None:
    (small_disk / "out").mkdir()
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    for out in (small_disk / "out", small_disk / "new"):
        with pytest.raises(InputError, match="Read-only file system"), staged_folder(out):
            pytest.fail("the work must not start")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere; a read-only file system is tried above")
def test_a_read_only_folder_is_refused_at_once(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="Permission denied"), staged_folder(tmp_path / "out"):
            pytest.fail("the work must not start")
    finally:
        tmp_path.chmod(0o700)


def test_a_writable_folder_in_a_parent_that_is_not_can_be_filled(small_disk: Path) -> None:
    # A mount of its own: beside it is another file system, where nothing could be renamed from.
    with staged_folder(small_disk) as folder:
        assert folder.stat().st_dev == small_disk.stat().st_dev
        fill(folder)
    assert contents(small_disk) == PRODUCED


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path, filled: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(filled)
    with staged_folder(link) as folder:
        fill(folder)
    assert link.is_symlink()
    assert contents(filled) == PRODUCED | {"notes.txt": "mine"}


def test_a_link_in_place_of_a_product_is_replaced_and_what_it_names_stays(tmp_path: Path, filled: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "precious").write_text("precious")
    shutil.rmtree(filled / "volume.zarr")
    (filled / "volume.zarr").symlink_to(tmp_path / "elsewhere")
    with staged_folder(filled) as folder:
        fill(folder)
    assert not (filled / "volume.zarr").is_symlink()
    assert contents(tmp_path / "elsewhere") == {"precious": "precious"}


def test_new_folders_and_files_have_the_modes_that_the_user_asked_for(tmp_path: Path) -> None:
    former = os.umask(0o027)
    try:
        with staged_folder(tmp_path / "out") as folder:
            (folder / "f").touch()
    finally:
        os.umask(former)
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o750
    assert stat.S_IMODE((tmp_path / "out" / "f").stat().st_mode) == 0o640


def test_a_full_disk_leaves_nothing_and_says_what_is_free(small_disk: Path) -> None:
    out = small_disk / "out"
    with pytest.raises(
        InputError, match=r"out: the disk is full \(4\.2 MB free\); nothing was left half-written"
    ), staged_folder(out) as folder:  # fmt: skip
        (folder / "big").write_bytes(bytes(5_000_000))
    assert not list(small_disk.iterdir())


def test_a_limit_on_file_sizes_is_told_like_a_full_disk(tmp_path: Path) -> None:
    code = """
        import resource, signal, sys
        from vialight.core.errors import InputError
        from vialight.store import staged_file, staged_folder
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        for stage in (staged_folder, staged_file):
            try:
                with stage(sys.argv[1]) as unfinished:
                    (unfinished / "big" if stage is staged_folder else unfinished).write_bytes(bytes(200_000))
            except InputError as error:
                print(error)
    """
    with start_python(code, tmp_path / "out") as process:
        stdout, stderr = process.communicate(timeout=30)
    assert len(stdout.splitlines()) == 2, stderr
    for line in stdout.splitlines():
        assert "MB free); nothing was left half-written" in line
    assert not list(tmp_path.iterdir())


def test_two_processes_at_once_leave_the_whole_result_of_one(tmp_path: Path) -> None:
    code = """
        import sys
        from vialight.store import staged_folder
        out, name = sys.argv[1:]
        print("ready", flush=True)
        sys.stdin.readline()
        for _ in range(40):
            with staged_folder(out) as folder:
                (folder / "volume.zarr").mkdir()
                (folder / "volume.zarr" / name).write_text(name)
                for item in ("a.stl", "b.json", "c.html", "x.json"):
                    (folder / item).write_text(name)
    """
    out = tmp_path / "out"
    processes = [start_python(code, out, name) for name in ("one", "two")]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    for process in processes:
        _, stderr = process.communicate(timeout=60)
        assert process.returncode == 0, stderr
    (winner,) = {item.read_text() for item in out.rglob("*") if item.is_file()}
    assert [item.name for item in (out / "volume.zarr").iterdir()] == [winner]
    assert sorted(item.name for item in out.iterdir()) == ["a.stl", "b.json", "c.html", "volume.zarr", "x.json"]
    assert list(tmp_path.iterdir()) == [out]


def test_a_staged_file_replaces_the_former_one_when_complete(tmp_path: Path) -> None:
    path = tmp_path / "surface.stl"
    path.write_text("old")
    with staged_file(path) as unfinished:
        assert unfinished.suffix == ".stl"
        unfinished.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("failure", [ValueError("no"), KeyboardInterrupt()])
def test_a_failed_staged_file_leaves_the_former_one(tmp_path: Path, failure: BaseException) -> None:
    path = tmp_path / "surface.stl"
    path.write_text("old")

    def write_and_fail() -> None:
        with staged_file(path) as unfinished:
            unfinished.write_text("half")
            raise failure

    with pytest.raises(type(failure)):
        write_and_fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_is_not_replaced_by_a_file(filled: Path) -> None:
    with pytest.raises(InputError, match="out: is a folder"), staged_file(filled):
        pytest.fail("the work must not start")
    assert contents(filled) == FILLED
