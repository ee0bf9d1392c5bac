"""Connections of strangers: many, slow and silent; and what they must not keep from those who are let in."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket as sockets
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from vialight.web import PageProcess, PageSettings
from vialight.web.connections import Acceptor, Limits, Places, Reserve
from web.clients import Client
from web.pretend_print import PretendPrint
from web.test_server import take, wait_for

pytestmark = pytest.mark.alone

QUICK_S = 0.5
PATIENCE_S = Limits().silence_s + Limits().patience_s
SERVE = """
import json, resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[2]),) * 2)
from vialight.web import PageProcess, PageSettings
if __name__ == "__main__":
    with PageProcess(sys.argv[1], PageSettings(port=0)) as page:
        print(json.dumps({"link": page.link, "stop_port": page.stop_port}), flush=True)
        sys.stdin.read()
"""


@contextlib.contextmanager
def silent(client: Client, count: int, port: int | None = None) -> Iterator[list[sockets.socket]]:
    """Hold many connections that say nothing; a refused one is opened no second time."""
    host, page_port = client.host.split(":")
    held: list[sockets.socket] = []
    try:
        while len(held) < count:
            held.append(sockets.create_connection((host, port or int(page_port)), timeout=10))
        yield held
    finally:
        for one in held:
            one.close()


def is_closed(connection: sockets.socket, within_s: float) -> bool:
    connection.settimeout(within_s)
    try:
        return connection.recv(4096) == b""
    except TimeoutError:
        return False
    except OSError:
        return True


def run_path_of(client: Client) -> str:
    return f"/api/runs/{client.ask('/api/runs').json[0]['key']}"


@pytest.fixture
def stoppable(tmp_path: Path) -> Iterator[tuple[PretendPrint, Client]]:
    with PretendPrint(tmp_path / "ring") as made, PageProcess(made.run, PageSettings(port=0)) as page:
        yield made, Client(page.link)


def test_300_silent_connections_keep_no_stop_from_the_print(stoppable: tuple[PretendPrint, Client]) -> None:
    printing, client = stoppable
    path = run_path_of(client)
    wait_for(lambda: printing.is_lit)
    with silent(client, 300):
        began = time.monotonic()
        answer = client.post(f"{path}/stop")
        assert time.monotonic() - began < QUICK_S
    assert (answer.status, answer.json) == (200, {"state": "after", "is_dark": True, "is_over": True})
    assert not printing.is_lit


def test_1100_silent_connections_and_1024_descriptors_keep_no_stop_from_the_print(tmp_path: Path) -> None:
    with PretendPrint(tmp_path / "ring") as printing:
        process = subprocess.Popen(
            [sys.executable, "-c", SERVE, str(printing.run), "1024"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True,
        )  # fmt: skip
        with process:
            assert process.stdout is not None
            client = Client(json.loads(process.stdout.readline())["link"])
            path = run_path_of(client)
            wait_for(lambda: printing.is_lit)
            with raised_limit(4096), silent(client, 1100):
                began = time.monotonic()
                answer = client.post(f"{path}/stop")
                assert time.monotonic() - began < QUICK_S
            assert (answer.status, answer.json) == (200, {"state": "after", "is_dark": True, "is_over": True})
            process.communicate("")


@contextlib.contextmanager
def raised_limit(count: int) -> Iterator[None]:
    """Let this process, which attacks, hold more descriptors."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(before[0], count), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_page_that_is_in_goes_on_while_strangers_connect(client: Client, run_path: str) -> None:
    with client.socket(f"/ws/{run_path.rsplit('/', 1)[1]}/images") as socket:
        take(socket, "snapshot")
        with silent(client, 400):
            began = time.monotonic()
            for _ in range(10):
                take(socket, "snapshot")
            assert time.monotonic() - began < 2.5
            assert client.ask(run_path).status == 200


@pytest.mark.parametrize(
    "said",
    [
        b"", b"GET / HT", b"POST /api/session HTTP/1.1\r\nHost: {host}\r\nContent-Length: 9\r\n\r\n{",
        b"GET /api/runs HTTP/1.1\r\nHost: {host}\r\nX: ",
    ],
)  # fmt: skip
def test_a_connection_that_asks_for_nothing_is_closed_in_seconds(client: Client, said: bytes) -> None:
    with silent(client, 1) as (connection,):
        connection.sendall(said.replace(b"{host}", client.host.encode()))
        began = time.monotonic()
        assert is_closed(connection, PATIENCE_S + 2)
        assert time.monotonic() - began > Limits().silence_s - 0.5


def test_headers_that_come_a_byte_at_a_time_are_not_waited_for(client: Client) -> None:
    with silent(client, 1) as (connection,):
        connection.sendall(f"GET /api/runs HTTP/1.1\r\nHost: {client.host}\r\nX: ".encode())
        began = time.monotonic()
        with contextlib.suppress(OSError):  # a broken pipe, or a connection that was reset
            while time.monotonic() - began < PATIENCE_S + 3:
                connection.sendall(b"x")
                time.sleep(0.1)
        assert time.monotonic() - began < PATIENCE_S + 2


def test_headers_without_an_end_are_not_kept(client: Client) -> None:
    with silent(client, 1) as (connection,), contextlib.suppress(OSError):
        connection.sendall(b"GET / HTTP/1.1\r\nX: " + b"x" * 200_000)
        assert connection.recv(4096).startswith(b"HTTP/1.1 4")


def test_a_connection_is_kept_from_one_request_to_the_next_and_not_for_ever(client: Client) -> None:
    with silent(client, 1) as (connection,):
        asked = f"GET /api/session HTTP/1.1\r\nHost: {client.host}\r\nAuthorization: Bearer {client.token}\r\n\r\n"
        for _ in range(3):
            connection.sendall(asked.encode())
            answer = b""
            while not answer.endswith(b"}"):
                answer += connection.recv(65536)
            assert answer.startswith(b"HTTP/1.1 200")
            time.sleep(0.3)
        assert is_closed(connection, 12)


class Someone:
    def __init__(self, address: str = "127.0.0.1", *, is_idle: bool = True) -> None:
        self.address, self.is_idle, self.is_cut = address, is_idle, False

    def cut(self) -> None:
        self.is_cut = True


def test_strangers_take_each_others_places_and_of_one_address_first() -> None:
    places = Places(Limits(strangers=4, of_one=2, inside=2))
    here, there = [Someone("a") for _ in range(3)], [Someone(name) for name in "bcd"]
    for one in (*here, *there):
        places.enter(one)
    assert [one.is_cut for one in here] == [True, True, False]
    assert [one.is_cut for one in there] == [False] * 3
    assert places.counts == (4, 0)


def test_who_is_let_in_is_never_cut_for_a_stranger_and_for_one_let_in_only_when_idle() -> None:
    places = Places(Limits(strangers=2, of_one=2, inside=2))
    busy, idle, third = Someone(is_idle=False), Someone(), Someone()
    for one in (busy, idle):
        places.enter(one)
        places.let_in(one)
    for _ in range(50):
        places.enter(Someone())
    assert not busy.is_cut
    assert not idle.is_cut
    places.enter(third)
    places.let_in(third)
    assert (busy.is_cut, idle.is_cut, third.is_cut) == (False, True, False)


def test_an_acceptor_out_of_descriptors_cuts_a_stranger_and_goes_on_at_once(tmp_path: Path) -> None:
    """In a child, whose descriptors can be used up."""
    script = tmp_path / "child.py"
    script.write_text(CHILD)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < QUICK_S


CHILD = """
import asyncio, os, resource, socket, sys, time
from vialight.web.connections import Acceptor, Limits, Places, Reserve

class Echo(asyncio.Protocol):
    address, is_idle = "", True
    def connection_made(self, transport):
        self.transport = transport
        places.enter(self)
    def data_received(self, data):
        places.let_in(self)
        self.transport.write(data)
    def connection_lost(self, error):
        places.leave(self)
    def cut(self):
        self.transport.abort()

places = Places(Limits(1000, 1000, 1000))

async def main():
    listener = socket.create_server(("127.0.0.1", 0), backlog=512)
    address = listener.getsockname()
    reserve = Reserve(2)
    acceptor = Acceptor(listener, Echo, places, reserve)
    acceptor.start()
    # All that is left is taken: here by the other ends, in another process' stead.
    limit = 120
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    strangers = []
    while len(strangers) < 40:
        one = socket.socket()
        one.setblocking(False)
        one.connect_ex(address)
        strangers.append(one)
        await asyncio.sleep(0.002)
    asking = socket.socket()
    asking.setblocking(False)
    asking.connect_ex(address)
    fillers = []
    try:
        while True:
            fillers.append(os.open(os.devnull, os.O_RDONLY))
    except OSError:
        pass
    began = time.monotonic()
    loop = asyncio.get_running_loop()
    await loop.sock_sendall(asking, b"stop")
    assert await asyncio.wait_for(loop.sock_recv(asking, 16), 5) == b"stop"
    print(time.monotonic() - began)

asyncio.run(main())
"""


def descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def test_descriptors_in_reserve_are_there_when_no_other_is() -> None:
    reserve = Reserve(3)
    before = descriptors()
    with reserve.lent():
        assert descriptors() == before - 3
    assert descriptors() == before
    reserve.close()
    assert descriptors() == before - 3


def test_nobody_is_accepted_while_the_reserve_is_lent() -> None:
    async def accepted() -> tuple[int, int]:
        places, reserve = Places(Limits()), Reserve(1)
        made: list[asyncio.Protocol] = []

        def make() -> asyncio.Protocol:
            made.append(asyncio.Protocol())
            return made[-1]

        with sockets.create_server(("127.0.0.1", 0)) as listener:
            acceptor = Acceptor(listener, make, places, reserve)
            acceptor.start()
            with reserve.lent(), sockets.create_connection(listener.getsockname()):
                await asyncio.sleep(0.2)
                meanwhile = len(made)
            await asyncio.sleep(0.2)
            acceptor.close()
        reserve.close()
        return meanwhile, len(made)

    assert asyncio.run(accepted()) == (0, 1)
