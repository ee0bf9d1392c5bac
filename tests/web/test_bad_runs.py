"""Runs that come from anywhere: what is wrong with one is told of that one, and nothing outside it is read."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from gifts import trapped
from vialight.store import list_history, read_plan, write_plan
from vialight.web import PageProcess, PageSettings
from vialight.web.data import RunData
from vialight.web.run_log import LogTail
from vialight.web.runs import Run, own_file, own_folder
from vialight.web.thumbnails import thumbnail
from web.clients import Answer, Client
from web.pretend_print import PretendPrint
from web.test_server import take, wait_for

pytestmark = pytest.mark.alone

QUICK_S = 2.0
PROGRAM = str(Path(sys.executable).parent / "vialight")
SECRET = "the secret of another file"


class Shelf:
    """A folder of one good run and others, and its server."""

    def __init__(self, root: Path, page: PageProcess) -> None:
        self.root, self.page, self.client = root, page, Client(page.link)
        self.ask("good")  # the readers have started

    def listed(self) -> dict[str, dict[str, Any]]:
        return {run["name"]: run for run in self.client.ask("/api/runs").json}

    def ask(self, name: str, what: str = "") -> Answer:
        return self.client.ask(f"/api/runs/{self.listed()[name]['key']}{what}")

    def bad(self) -> Path:
        folder = self.root / "bad"
        folder.mkdir(exist_ok=True)
        (folder / "run.json").write_text('{"state": "done"}')
        return folder

    def readers(self) -> list[psutil.Process]:
        children = psutil.Process(self.page._process.pid).children()
        return [child for child in children if "vialight.web.reading" in child.cmdline()]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a good run, finished."""
    root = tmp_path_factory.mktemp("shelf")
    with PretendPrint(root / "good") as made:
        wait_for(lambda: len(list_history(made.run)) >= 2)
        made._obey({"do": "stop"})
        assert made.over.wait(15)
    return root


@pytest.fixture(scope="module")
def shared_page(root: Path) -> Iterator[PageProcess]:
    with PageProcess(root, PageSettings(port=0)) as page:
        shelf = Shelf(root, page)
        for _ in range(3):  # readers import what they need when they are first asked
            shelf.ask("good", "/curves/0")
            shelf.ask("good", "/thumbnail")
        yield page


@pytest.fixture
def shelf(root: Path, shared_page: PageProcess) -> Iterator[Shelf]:
    """The good run and a bad one of a test's own, with a name that was never used before."""
    given = Shelf(root, shared_page)
    yield given
    for item in root.iterdir():
        if item.name != "good":
            item.unlink() if item.is_symlink() or item.is_file() else shutil.rmtree(item)


@pytest.fixture
def own_shelf(root: Path) -> Iterator[Shelf]:
    """With a server of its own, for tests that leave it in disorder."""
    with PageProcess(root, PageSettings(port=0)) as page:
        yield Shelf(root, page)


def good_is_well(shelf: Shelf, within_s: float = QUICK_S) -> None:
    began = time.monotonic()
    run = shelf.listed()["good"]
    assert (run["state"], run["iou"], run["fault"]) == ("done", 0.97, None)
    path = f"/api/runs/{run['key']}"
    assert shelf.client.ask(path).status == 200
    assert shelf.client.ask(f"{path}/curves/0").json["rows"]
    assert time.monotonic() - began < within_s


@pytest.mark.parametrize("name", ["run.json", "metrics.json"])
@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 50_000, "[]", '"text"', "", "{", "NaN", "\xff", "9" * 4000],
    ids=["deep list", "deep table", "list", "text", "nothing", "half", "NaN", "no UTF-8", "long number"],
)
def test_a_file_that_is_no_table_is_told_of_its_run_alone(shelf: Shelf, name: str, text: str) -> None:
    (shelf.bad() / name).write_bytes(text.encode("latin-1"))
    good_is_well(shelf)
    fault = shelf.listed()["bad"]["fault"]
    assert name in fault
    assert str(shelf.root) not in fault
    assert shelf.ask("bad").status == 200


@pytest.mark.parametrize(
    "placed",
    ['{"rmse_mm": "wide"}', '{"rmse_mm": [1]}', '{"rmse_mm": NaN}', '{"iou": Infinity}', "[1, 2]", '"x"', "3", "true",
     '{"rmse_mm": 1e999}', '{"iou": ' + "9" * 400 + "}", '{"rmse_mm": {"a": 1}}'],
)  # fmt: skip
def test_a_number_that_is_none_is_told_of_its_run_alone(shelf: Shelf, placed: str) -> None:
    (shelf.bad() / "metrics.json").write_text(f'{{"as_placed": {placed}, "tolerance": [1]}}')
    good_is_well(shelf)
    run = shelf.listed()["bad"]
    assert (run["rmse_mm"], run["iou"], run["passed"], run["state"]) == (None, None, None, "done")
    assert "metrics.json: " in run["fault"]
    assert shelf.ask("bad").status == 200


def test_facts_of_every_wrong_kind_are_left_out_and_told(shelf: Shelf) -> None:
    facts = {"state": [1], "started": "x" * 100_000, "inputs": 3, "printed": ["a"], "name": {"a": 1}}
    (shelf.bad() / "run.json").write_text(json.dumps(facts))
    good_is_well(shelf)
    run = shelf.listed()["bad"]
    assert run["part"] is None
    assert len(json.dumps(run)) < 2000
    assert shelf.ask("bad").json["printed"] == {}


@pytest.mark.parametrize("name", ["run.json", "metrics.json", "log.jsonl", "rig.toml", "reference.stl", "live.json"])
def test_a_pipe_by_the_name_of_a_file_holds_up_nobody(shelf: Shelf, name: str) -> None:
    path = shelf.bad() / name
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    good_is_well(shelf)
    began = time.monotonic()
    for what in ("", "/log/0", "/reference", "/curves/0", "/slices/0/0/0"):
        assert shelf.ask("bad", what).status in (200, 404)
    assert shelf.client.post(f"/api/runs/{shelf.listed()['bad']['key']}/stop").status == 409
    assert time.monotonic() - began < 3


def bomb(path: Path, gigabytes: float) -> None:
    """Write a moment of a history whose image unpacks to so much."""
    path.parent.mkdir(exist_ok=True)
    part = bytes(1 << 20)
    count = int(gigabytes * 1024)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in ("frames", "time_s", "density_xy"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                shape = (count << 20,) if name == "density_xy" or name == "frames" else ()
                np.lib.format.write_array_header_1_0(
                    member, {"descr": "|u1" if shape else "<f8", "fortran_order": False, "shape": shape}
                )
                if name == "frames":
                    for _ in range(count):
                        member.write(part)
                else:
                    member.write(bytes(8))


def test_a_history_that_unpacks_to_gigabytes_takes_neither_memory_nor_time_from_others(shelf: Shelf) -> None:
    bad = shelf.bad()
    bomb(bad / "history" / "000001.npz", 7.8)
    most, over = [0], threading.Event()

    def watch() -> None:
        while not over.wait(0.02):
            most[0] = max(most[0], *(process.memory_info().rss for process in shelf.readers()), 0)

    watching = threading.Thread(target=watch)
    watching.start()
    try:
        key = shelf.listed()["bad"]["key"]
        asked = [
            threading.Thread(target=shelf.client.ask, args=(f"/api/runs/{key}/{what}",))
            for what in ("curves/0", "moments/1", "thumbnail", "moments/1/pattern")
        ]
        for one in asked:
            one.start()
        good_is_well(shelf)
        for one in asked:
            one.join(12)
            assert not one.is_alive()
    finally:
        over.set()
        watching.join()
    assert most[0] < 1.5e9
    good_is_well(shelf)


def test_a_reader_that_hangs_is_ended_told_of_its_run_and_not_tried_again_at_once(own_shelf: Shelf) -> None:
    shelf = own_shelf
    for process in shelf.readers():
        process.send_signal(signal.SIGSTOP)  # as by a disk that does not answer
    began = time.monotonic()
    shelf.listed()
    assert time.monotonic() - began < 5
    wait_for(lambda: "took more than" in str(shelf.listed()["good"]["fault"]), 30)
    began = time.monotonic()
    shelf.listed()
    assert time.monotonic() - began < QUICK_S


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("surface.stl", "files/surface.stl"), ("report.html", "report"), ("log.jsonl", "files/log.jsonl"),
        ("log.jsonl", "log/0"), ("reference.stl", "reference"), ("reference.stl", "files/reference.stl"),
        ("surfaces/000001.ply", "surfaces/1"), ("history/000001.npz", "moments/1"), ("frames.h5", "moments/1/camera"),
        ("projector.csv", "moments/1/pattern"), ("volume.zarr/zarr.json", "slices/0/0/0"),
        ("run.json", "files/run.json"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("is_folder", [False, True])
def test_a_link_out_of_a_run_is_not_followed(shelf: Shelf, name: str, what: str, is_folder: bool) -> None:
    good, bad = shelf.root / "good", shelf.bad()
    outside = good / name if (good / name).exists() else shelf.root / "outside"
    (shelf.root / "outside").write_text(SECRET)
    path = bad / name
    if is_folder and "/" in name:
        path.parent.symlink_to((good / name).parent)
    else:
        path.parent.mkdir(exist_ok=True)
        path.unlink(missing_ok=True)
        path.symlink_to(outside)
    answer = shelf.ask("bad", f"/{what}")
    assert answer.status == 404 or answer.json == []
    assert SECRET.encode() not in answer.body
    good_is_well(shelf)


def test_a_run_that_is_a_link_is_not_listed(shelf: Shelf, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "run.json").write_text("{}")
    (shelf.root / "linked").symlink_to(tmp_path / "elsewhere")
    assert set(shelf.listed()) == {"good"}


def test_own_files_are_regular_small_and_inside(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("12345")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "b").write_text("")
    (tmp_path / "away").symlink_to(tmp_path / "folder")
    assert own_file(tmp_path, "a", most_bytes=5) == tmp_path / "a"
    assert own_file(tmp_path, "a", most_bytes=4) is None
    assert own_file(tmp_path, "folder/b") == tmp_path / "folder" / "b"
    for name in ("away/b", "folder", "nothing", "../a", "folder/../a", "/etc/passwd", "a\0", "x" * 5000, "away"):
        assert own_file(tmp_path, name) is None, name
    assert own_folder(tmp_path, "folder") == tmp_path / "folder"
    assert own_folder(tmp_path, "away") is None
    (tmp_path / "folder" / "c").symlink_to("/etc/passwd")
    assert own_folder(tmp_path, "folder") is None


@pytest.mark.parametrize("digits", [10, 300, 4400, 9000])
@pytest.mark.parametrize(
    "what", ["curves/{}", "log/{}", "moments/{}", "moments/{}/camera", "surfaces/{}", "slices/{}/0/0"]
)
def test_numbers_of_hundreds_of_digits_are_at_no_place(shelf: Shelf, what: str, digits: int) -> None:
    key = shelf.listed()["good"]["key"]
    assert shelf.client.ask(f"/api/runs/{key}/{what.format('9' * digits)}").status in (400, 404)


def test_a_message_with_numbers_without_measure_ends_no_other_socket(shelf: Shelf) -> None:
    key = shelf.listed()["good"]["key"]
    with shelf.client.socket(f"/ws/{key}/state") as socket, shelf.client.socket(f"/ws/{key}/state") as other:
        socket.send(f'{{"order": {{"do": "extend", "turns": {"9" * 700}}}, "id": 1}}')
        assert "turns cannot be that many" in take(socket, "answer")[0]["answer"]["error"]
        socket.send(f'{{"order": {{"do": "stop"}}, "id": {"9" * 700}}}')
        assert take(other, "status")[0]["live"] is False
    order = f'{{"do": "extend", "turns": {"9" * 3000}}}'.encode()
    assert shelf.client.ask(f"/api/runs/{key}/orders", "POST", order).status == 409


def test_a_run_that_says_that_it_prints_and_does_not_is_interrupted(shelf: Shelf) -> None:
    bad = shelf.bad()
    (bad / "run.json").write_text('{"state": "printing"}')
    assert shelf.listed()["bad"]["state"] == "interrupted"
    for process in (2**22 + 7, -1, "1", None):
        link = {"pid": process, "mailboxes": str(bad), "control": "", "key": ""}
        for told in (link, [link], {"process": link}):
            (bad / "live.json").write_text(json.dumps(told))
            assert shelf.listed()["bad"]["state"] == "interrupted", told
    assert shelf.ask("bad").json["state"] == "interrupted"


def test_a_long_log_is_told_in_parts_and_only_what_is_new_is_read(shelf: Shelf) -> None:
    log = shelf.bad() / "log.jsonl"
    log.write_text("".join(f'{{"event": "e{number}"}}\n' for number in range(2500)) + "x" * 100_000 + "\n" + '{"ev')
    told: list[dict[str, Any]] = []
    while part := shelf.ask("bad", f"/log/{len(told)}").json:
        assert len(part) <= 1000
        told += part
    assert [event["event"] for event in told] == [
        *(f"e{number}" for number in range(2500)),
        "a line that cannot be read",
    ]
    with log.open("a") as file:
        file.write('ent": "last"}\n')
    assert shelf.ask("bad", "/log/2501").json == [{"event": "last"}]


@pytest.mark.parametrize("line", ['{"a":' * 800 + "1" + "}" * 800, '{"a": ' + "9" * 4000 + "}", '"NaN"', "[]"])
def test_a_line_of_a_log_that_cannot_be_told_hides_no_other(shelf: Shelf, line: str) -> None:
    (shelf.bad() / "log.jsonl").write_text(f'{{"event": "before"}}\n{line}\n{{"event": "after"}}\n')
    told = shelf.ask("bad", "/log/0").json
    assert [event["event"] for event in told] == ["before", "a line that cannot be read", "after"]


def test_a_line_of_a_log_with_a_number_that_is_none_is_told_without_it(shelf: Shelf) -> None:
    (shelf.bad() / "log.jsonl").write_text('{"event": "measured", "rmse_mm": NaN, "time_s": 1.5}\n')
    assert shelf.ask("bad", "/log/0").json == [{"event": "measured", "rmse_mm": None, "time_s": 1.5}]


def test_a_run_that_was_removed_and_printed_anew_is_shown_as_it_is_now(root: Path, tmp_path: Path) -> None:
    first, second = root / "good", tmp_path / "second"
    shutil.copytree(first, second)
    plan = read_plan(second / "plan.h5")
    write_plan(second / "plan.h5", replace(plan, patterns=replace(plan.patterns, levels=255 - plan.patterns.levels)))
    moments = sorted((second / "history").iterdir())
    shutil.copy(moments[0], moments[-1])
    run = Run.of(tmp_path / "ring")

    def tell(data: RunData) -> tuple[Any, ...]:
        return data.curves(0)["rows"][-1], data.pattern(0), thumbnail(data.run, True)

    data = RunData(run)
    for folder in (first, second):
        shutil.rmtree(run.folder, ignore_errors=True)
        shutil.copytree(folder, run.folder)
        told = zip(tell(data), tell(RunData(Run.of(folder))), strict=True)
        assert [ours == theirs for ours, theirs in told] == [True, True, True]


def test_a_log_that_was_begun_anew_is_told_from_its_begin(tmp_path: Path) -> None:
    log, tail = tmp_path / "log.jsonl", LogTail(tmp_path)
    log.write_text('{"event": "old"}\n{"event": "older"}\n')
    assert len(tail.lines(0)) == 2
    log.write_text('{"event": "a longer one"}\n{"event": "and another that is long"}\n')  # with the same inode
    assert [event["event"] for event in tail.lines(0)] == ["a longer one", "and another that is long"]


def test_a_run_whose_name_is_not_utf8_is_listed_shown_and_downloaded(shelf: Shelf) -> None:
    shelf.bad().rename(shelf.root / os.fsdecode(b"bad-\xff"))
    good_is_well(shelf)
    assert shelf.listed()["bad-?"]["state"] == "done"
    assert shelf.ask("bad-?").json["name"] == "bad-?"
    answer = shelf.ask("bad-?", "/files/run.json")
    assert answer.status == 200
    assert "bad-%3F-run.json" in answer.headers["content-disposition"]
    assert shelf.ask("bad-?", "/slices/0/0/0").status == 404
    answer = shelf.client.post(f"/api/runs/{shelf.listed()['bad-?']['key']}/stop")
    assert (answer.status, "error" in answer.json) == (409, True)


def test_a_folder_of_runs_whose_name_is_not_utf8_is_shown(tmp_path: Path) -> None:
    root = tmp_path / os.fsdecode(b"shelf-\xff")
    (root / "run").mkdir(parents=True)
    (root / "run" / "run.json").write_text("{}")
    with PageProcess(root, PageSettings(port=0)) as page:
        client = Client(page.link)
        assert client.ask("/api/session").json["name"] == "shelf-?"
        assert [run["name"] for run in client.ask("/api/runs").json] == ["run"]


def run_everything(link: str) -> None:
    """Have every process of a server started and asked, for the only run that it shows."""
    client = Client(link)
    wait_for(lambda: client.ask("/api/runs").json[0]["fault"] is None)  # the readers have started
    path = f"/api/runs/{client.ask('/api/runs').json[0]['key']}"
    stop = Client(link.replace(client.host, f"127.0.0.1:{client.ask('/api/session').json['stop_port']}"))
    assert stop.post(f"{path}/stop").status == 409  # it is not printing
    client.post(f"{path}/timelapse")
    wait_for(lambda: client.ask(f"{path}/timelapse").json["state"] == "failed")  # there are no surfaces


@pytest.fixture
def gift(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run that is the current folder, and has modules in it; return the file that is there once they were run."""
    (tmp_path / "run.json").write_text('{"state": "done"}')
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return trapped(tmp_path)


def test_a_run_that_is_the_current_folder_runs_no_code_of_its_own(gift: Path) -> None:
    with PageProcess(".", PageSettings(port=0)) as page:
        run_everything(page.link)
    assert not gift.exists()


def test_a_run_that_is_the_current_folder_of_the_command_runs_no_code_of_its_own(gift: Path) -> None:
    with subprocess.Popen([PROGRAM, "serve", ".", "--port", "0"], stdout=subprocess.PIPE, text=True) as serving:
        try:
            assert serving.stdout is not None
            run_everything(serving.stdout.readline().split()[1])
        finally:
            serving.terminate()
    assert not gift.exists()
