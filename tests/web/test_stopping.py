"""Stop's own listener, and what is answered when it cannot be told whether anything prints."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from vialight.core.errors import InputError, VialightError
from vialight.printing.live_link import LiveLink
from vialight.web import PageProcess, PageSettings, orders, runs
from vialight.web.connections import Reserve
from vialight.web.orders import OrderDesk, check_order
from vialight.web.runs import CannotTellError, Run
from web.clients import Client
from web.pretend_print import PretendPrint, PretendProcess
from web.test_connections import QUICK_S, is_closed, raised_limit, run_path_of, silent
from web.test_server import wait_for

pytestmark = pytest.mark.alone


class Stoppable:
    """A print, a client of the page's port, and one of Stop's own."""

    def __init__(self, printing: PretendPrint, page: PageProcess) -> None:
        self.printing, self.page = printing, page
        self.client = Client(page.link)
        token = page.link[page.link.index("#") :]
        self.stop = Client(f"http://127.0.0.1:{page.stop_port}/{token}")
        self.path = f"{run_path_of(self.client)}/stop"

    @property
    def process(self) -> psutil.Process:
        """The one that listens for Stop."""
        (found,) = [
            child
            for child in psutil.Process(self.page._process.pid).children()
            if "vialight.web.stopping" in child.cmdline()
        ]
        return found


@pytest.fixture
def stoppable(tmp_path: Path) -> Iterator[Stoppable]:
    with PretendPrint(tmp_path / "ring") as made, PageProcess(tmp_path, PageSettings(port=0)) as page:
        given = Stoppable(made, page)
        wait_for(lambda: made.is_lit)
        yield given


def test_stops_own_listener_takes_a_right_token_once_and_again(stoppable: Stoppable) -> None:
    answer = stoppable.stop.post(stoppable.path)
    assert (answer.status, answer.json) == (200, {"state": "after", "is_dark": True, "is_over": True})
    assert not stoppable.printing.is_lit
    assert stoppable.printing.orders == [{"do": "stop", "by": "page at 127.0.0.1"}]


def test_stops_own_listener_takes_the_pages_cookie_from_the_pages_origin_alone(stoppable: Stoppable) -> None:
    ours = {"Origin": stoppable.client.origin, "Cookie": stoppable.client.cookie(), "Sec-Fetch-Site": "same-site"}
    for headers, status in (
        ({"Cookie": ours["Cookie"]}, 401),
        (ours | {"Origin": "http://evil.example"}, 403),
        (ours | {"Origin": stoppable.stop.origin}, 403),
        (ours | {"Sec-Fetch-Site": "cross-site"}, 403),
        (ours | {"Host": f"evil.example:{stoppable.page.stop_port}"}, 421),
    ):
        answer = stoppable.stop.ask(stoppable.path, "POST", b"", headers)
        assert answer.status == status, headers
        assert answer.headers.get("access-control-allow-origin") in (None, stoppable.client.origin)
    assert stoppable.printing.is_lit
    answer = stoppable.stop.ask(stoppable.path, "POST", b"", ours)
    assert answer.status == 200
    assert answer.headers["access-control-allow-origin"] == stoppable.client.origin
    assert answer.headers["access-control-allow-credentials"] == "true"
    assert not stoppable.printing.is_lit


def test_stops_own_listener_takes_nothing_else(stoppable: Stoppable) -> None:
    stop, bearer = stoppable.stop, stoppable.stop.bearer
    assert stop.ask(stoppable.path, "POST", b"", {}).status == 401
    assert stop.ask(stoppable.path, "POST", b"", {"Authorization": "Bearer guess"}).status == 401
    assert stop.ask(stoppable.path, "GET").status == 405
    assert stop.ask("/", "POST", b"").status == 404
    assert stop.ask("/api/runs/000000000000/stop", "POST", b"").status == 404
    assert stop.ask(f"/api/runs/{'9' * 300}/stop", "POST", b"").status == 404
    assert stop.ask(stoppable.path, "POST", b"x" * 5000, bearer).status == 413
    assert stop.ask(stoppable.path, "POST", None, bearer | {"Content-Length": "9" * 300}).status == 400
    assert stop.ask(stoppable.path, "POST", None, bearer | {"Transfer-Encoding": "chunked"}).status == 400
    assert stop.ask(stoppable.path, "POST", b"", bearer | {"X": "x" * 9000}).status == 431
    assert stoppable.printing.is_lit


def test_guessing_at_stops_own_listener_is_slowed_and_who_has_the_token_may_still_stop(stoppable: Stoppable) -> None:
    guess = {"Authorization": "Bearer guess"}
    told = [stoppable.stop.ask(stoppable.path, "POST", b"", guess).status for _ in range(11)]
    assert told == [401] * 10 + [429]
    assert stoppable.stop.post(stoppable.path).status == 200  # a program, at the same address as who guesses
    ours = {"Origin": stoppable.client.origin, "Cookie": stoppable.client.cookie()}
    assert stoppable.stop.ask(stoppable.path, "POST", b"", ours).status == 200


def test_stops_own_listener_answers_while_the_pages_process_and_its_readers_hang(stoppable: Stoppable) -> None:
    page = psutil.Process(stoppable.page._process.pid)
    hung = [page, *(child for child in page.children() if "vialight.web.reading" in child.cmdline())]
    for process in hung:
        process.send_signal(signal.SIGSTOP)
    try:
        began = time.monotonic()
        assert stoppable.stop.post(stoppable.path).status == 200
        assert time.monotonic() - began < QUICK_S
        assert not stoppable.printing.is_lit
    finally:
        for process in hung:
            process.send_signal(signal.SIGCONT)


def test_stop_on_the_pages_port_is_answered_while_its_readers_hang(stoppable: Stoppable) -> None:
    page = psutil.Process(stoppable.page._process.pid)
    hung = [child for child in page.children() if "vialight.web.reading" in child.cmdline()]
    assert hung
    for process in hung:
        process.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    assert stoppable.client.post(stoppable.path).status == 200
    assert time.monotonic() - began < QUICK_S


def test_stops_own_listener_answers_among_300_silent_connections_of_its_own(stoppable: Stoppable) -> None:
    with raised_limit(4096), silent(stoppable.stop, 300):
        began = time.monotonic()
        assert stoppable.stop.post(stoppable.path).status == 200
        assert time.monotonic() - began < QUICK_S


def test_a_slow_press_is_not_waited_for(stoppable: Stoppable) -> None:
    with silent(stoppable.stop, 1) as (connection,):
        connection.sendall(b"POST /api/runs/")
        assert is_closed(connection, 6)


def test_stop_goes_through_when_its_process_has_no_descriptor_left_but_those_in_reserve(stoppable: Stoppable) -> None:
    process = stoppable.process
    held = {int(path.name) for path in Path(f"/proc/{process.pid}/fd").iterdir()}
    assert held == set(range(len(held)))  # so that a limit of their count leaves none
    psutil.Process(process.pid).rlimit(psutil.RLIMIT_NOFILE, (len(held), len(held)))
    for _ in range(2):
        began = time.monotonic()
        answer = stoppable.stop.post(stoppable.path)
        assert (answer.status, answer.json) == (200, {"state": "after", "is_dark": True, "is_over": True})
        assert time.monotonic() - began < 2 * QUICK_S
    assert not stoppable.printing.is_lit


def test_stops_own_listener_comes_back_when_it_was_killed_and_goes_with_the_page(stoppable: Stoppable) -> None:
    first = stoppable.process
    first.kill()
    assert stoppable.stop.post(stoppable.path).status == 200  # on the same port
    second = stoppable.process
    assert second.pid != first.pid
    stoppable.page._process.kill()
    wait_for(lambda: not second.is_running() or second.status() == psutil.STATUS_ZOMBIE, 5)


def test_the_page_is_told_stops_port_and_may_connect_to_exactly_that(stoppable: Stoppable) -> None:
    port = stoppable.page.stop_port
    assert stoppable.client.ask("/api/session").json["stop_port"] == port
    policy = stoppable.client.ask("/").headers["content-security-policy"]
    assert f"connect-src 'self' http://127.0.0.1:{port};" in policy
    evil = stoppable.client.ask("/", headers={"Host": "evil.example"}).headers["content-security-policy"]
    assert "connect-src 'self';" in evil


@pytest.mark.parametrize(
    "fault",
    [
        OSError(errno.EMFILE, "Too many open files"), PermissionError(errno.EACCES, "denied"), TimeoutError(),
        VialightError("?"),
    ],
)  # fmt: skip
def test_what_cannot_be_told_is_never_told_as_not_running(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "live.json").write_text("{}")

    def find(folder: Path) -> LiveLink | None:
        raise fault

    monkeypatch.setattr(runs, "find_live_print", find)
    with pytest.raises(CannotTellError, match=r"cannot tell whether it is running.*use the switch on the machine"):
        press(Run.of(run))


def test_a_live_file_that_may_not_be_opened_is_no_proof_that_nothing_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "live.json").write_text("{}")

    def refuse(*_: Any) -> int:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(CannotTellError):
        runs.find_print(Run.of(tmp_path))


def test_a_print_that_is_not_there_a_print_that_refuses_and_one_that_is_silent_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="is not running") as gone:
        press(Run.of(tmp_path))
    assert not isinstance(gone.value, CannotTellError)

    monkeypatch.setattr(orders, "find_print", lambda run: object())
    monkeypatch.setattr(orders, "send_order", failing(InputError("print", "is over")))
    with pytest.raises(InputError, match="is over") as refused:
        press(Run.of(tmp_path))
    assert not isinstance(refused.value, CannotTellError)

    monkeypatch.setattr(orders, "send_order", failing(ConnectionRefusedError(errno.ECONNREFUSED, "refused")))
    with pytest.raises(CannotTellError):
        press(Run.of(tmp_path))

    monkeypatch.setattr(orders, "_PATIENCE_S", 0.1)
    monkeypatch.setattr(orders, "send_order", lambda link, order: time.sleep(0.5))
    with pytest.raises(CannotTellError, match="has not answered within"):
        press(Run.of(tmp_path))


def failing(error: Exception) -> Any:
    def fail(*_: Any) -> None:
        raise error

    return fail


def press(run: Run) -> dict[str, Any]:
    async def pressed() -> dict[str, Any]:
        desk = OrderDesk(Reserve(2))
        try:
            return await desk.obey(run, {"do": "stop"}, "a test")
        finally:
            desk.close()

    return asyncio.run(pressed())


def test_a_print_that_hangs_is_answered_for_with_503_and_the_switch(tmp_path: Path) -> None:
    with PretendProcess(tmp_path / "ring") as printing, PageProcess(tmp_path, PageSettings(port=0)) as page:
        client = Client(page.link)
        path = run_path_of(client)
        printing.process.send_signal(signal.SIGSTOP)
        try:
            answer = client.post(f"{path}/orders", {"do": "mode", "mode": "auto"})
        finally:
            printing.process.send_signal(signal.SIGCONT)
        assert answer.status == 503
        assert "cannot tell whether it is running" in answer.json["error"]
        assert "use the switch on the machine" in answer.json["error"]


@pytest.mark.parametrize("turns", [10**400, -(10**400), float("inf"), float("nan"), 0, 100.5])
def test_a_number_of_turns_that_nothing_can_do_is_refused_whatever_its_size(turns: float) -> None:
    with pytest.raises(InputError, match="turns cannot be that many"):
        check_order({"do": "extend", "turns": turns})
