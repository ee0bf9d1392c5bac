"""Who is let in: by a real server, over real sockets."""

from __future__ import annotations

import hmac
import json
import re
import socket as sockets
import time
from collections.abc import Iterator
from contextlib import ExitStack
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from vialight.web import PageProcess, PageSettings, network_warning
from vialight.web.access import BODY_LIMIT_BYTES, Access, RateLimit
from vialight.web.sockets import MESSAGE_LIMIT_BYTES, MOST_SOCKETS
from web.clients import Client
from web.pretend_print import PretendPrint

pytestmark = pytest.mark.alone

PRIVATE = ("/api/session", "/api/runs", "/api/runs/x", "/api/runs/x/report", "/api/runs/x/files/run.json")


@pytest.fixture
def lone_client(tmp_path: Path) -> Iterator[Client]:
    """A server of its own, for tests that use up what its clients are allowed."""
    (tmp_path / "run.json").write_text("{}")
    with PageProcess(tmp_path, PageSettings(port=0)) as page:
        yield Client(page.link)


@pytest.mark.parametrize("path", PRIVATE)
def test_without_a_token_nothing_is_told(client: Client, path: str) -> None:
    assert client.ask(path, headers={}).status == 401


def test_a_wrong_token_is_refused(lone_client: Client) -> None:
    for given in ("Bearer wrong", "Bearer ", "Basic dG9rZW4=", "Bearer \xe9", f"Bearer {lone_client.token[:-1]}"):
        assert lone_client.ask("/api/runs", headers={"Authorization": given}).status == 401


def test_a_right_token_lets_programs_in_and_pages_get_a_cookie_that_scripts_cannot_read(client: Client) -> None:
    assert client.ask("/api/runs").status == 200
    answer = client.post("/api/session", {"token": client.token}, {"Origin": client.origin})
    flags = answer.headers["set-cookie"].lower()
    assert "httponly" in flags
    assert "samesite=strict" in flags
    assert client.token not in flags
    cookie = answer.headers["set-cookie"].split(";")[0]
    assert client.ask("/api/runs", headers={"Cookie": cookie}).status == 200


def test_what_is_no_token_is_refused(lone_client: Client) -> None:
    for body in (b"", b"null", b"{", b"[]", b'{"token": 3}', b'{"token": "\\ud800"}', b"\xff"):
        answer = lone_client.ask("/api/session", "POST", body, {"Origin": lone_client.origin})
        assert answer.status in (400, 401)
        assert "set-cookie" not in answer.headers


def test_a_token_in_the_address_is_not_taken(client: Client) -> None:
    assert client.ask(f"/api/runs?token={client.token}", headers={}).status == 400
    assert client.ask(f"/api/runs?token={client.token}").status == 400


def test_the_token_is_told_behind_the_hash_only_and_is_long(client: Client) -> None:
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/#token=[\w-]{43}", client.link)


def test_tokens_are_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    compared = []

    def spy(a: bytes, b: bytes) -> bool:
        compared.append((a, b))
        return a == b

    monkeypatch.setattr(hmac, "compare_digest", spy)
    access = Access("secret", 80)
    assert not access.is_token("guess")
    assert access.is_cookie(access.cookie_value)
    assert compared == [(b"guess", b"secret"), (access.cookie_value.encode(), access.cookie_value.encode())]


def test_guessing_is_slowed_and_who_has_the_token_may_still_give_orders(printing: PretendPrint) -> None:
    with PageProcess(printing.run, PageSettings(port=0)) as page:
        _guess_until_refused(Client(page.link))


def _guess_until_refused(client: Client) -> None:
    run_path = f"/api/runs/{client.ask('/api/runs').json[0]['key']}"
    page = client.page_headers()
    answers = [client.ask("/api/runs", headers={"Authorization": "Bearer guess"}) for _ in range(12)]
    assert [answer.status for answer in answers] == [401] * 10 + [429] * 2
    assert int(answers[-1].headers["retry-after"]) > 50
    assert client.post("/api/session", {"token": "guess"}, {"Origin": client.origin}).status == 429
    assert client.post("/api/session", {"token": client.token}, {"Origin": client.origin}).status == 204
    assert client.ask("/api/runs").status == 200
    assert client.ask("/api/runs", headers=page).status == 200
    assert client.post(f"{run_path}/orders", {"do": "mode", "mode": "manual"}, page).status == 200


def test_failures_count_for_a_minute_and_for_their_own_address() -> None:
    now = 0.0
    limit = RateLimit(most=3, most_in_all=5, clock=lambda: now)
    for _ in range(3):
        limit.fail("a")
    assert limit.wait_s("a") == 60
    assert limit.wait_s("b") == 0
    limit.fail("b")
    limit.fail("c")
    assert limit.wait_s("d") == 60  # many addresses together
    now = 60.0
    assert limit.wait_s("a") == 0


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1", "https://127.0.0.1:{port}"])
def test_a_page_of_another_origin_is_refused(client: Client, origin: str) -> None:
    given = client.bearer | {"Origin": origin.format(port=client.host.rsplit(":")[1])}
    assert client.ask("/api/runs", headers=given).status == 403
    assert client.ask("/", headers=given).status == 403
    with pytest.raises(InvalidStatus):
        client.socket("/ws/x/state", given)


def test_a_page_of_another_site_is_refused_by_what_browsers_say_of_it(client: Client) -> None:
    for site in ("cross-site", "same-site"):
        assert client.ask("/api/runs", headers=client.bearer | {"Sec-Fetch-Site": site}).status == 403


def test_a_form_of_another_site_cannot_give_orders(client: Client) -> None:
    """Even where a browser sends the cookie along and does not say where the form stands."""
    cookie = client.cookie()
    assert client.ask("/api/runs/x/stop", "POST", b"", {"Cookie": cookie}).status == 401
    with pytest.raises(InvalidStatus):
        client.socket("/ws/x/state", {"Cookie": cookie})


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "", "127.0.0.1:{port}.evil"]
)
def test_a_name_that_was_bound_to_our_address_is_refused(client: Client, host: str) -> None:
    name = host.format(port=client.host.rsplit(":")[1])
    given = client.bearer | {"Host": name}
    assert client.ask("/api/runs", headers=given).status in (400, 421)
    assert client.ask("/", headers=given).status in (400, 421)
    if ":" in name and "." not in name.rsplit(":")[1]:
        with pytest.raises(InvalidStatus):
            client.socket("/ws/x/state", host=name)


def test_localhost_is_a_name_of_ours(client: Client) -> None:
    port = client.host.rsplit(":")[1]
    assert client.ask("/", headers={"Host": f"localhost:{port}"}).status == 200


@pytest.mark.parametrize(
    "path",
    [
        "/static/../access.py", "/static/%2e%2e/access.py", "/static/..%2faccess.py", "//etc/passwd",
        "/static//etc/passwd",
        "/api/runs/..", "/api/runs/..%2f..%2f..%2fetc%2fpasswd", "{run}/files/..%2frun.json", "{run}/files/frames.h5",
        "{run}/files/%2fetc%2fpasswd", "{run}/files/live.json", "{run}/moments/..%2f0", "{run}/moments/-1",
        "{run}/surfaces/99999999999999999999999", "{run}/log/x", "/static/", "/static/vendor",
    ],
)  # fmt: skip
def test_no_address_reaches_the_file_system(client: Client, run_path: str, path: str) -> None:
    answer = client.ask(path.format(run=run_path))
    assert answer.status in (400, 401, 404)
    assert b"root:" not in answer.body
    assert b"/tmp" not in answer.body


def test_what_is_too_large_is_refused(client: Client) -> None:
    large = b"x" * (BODY_LIMIT_BYTES + 1)
    assert client.ask("/api/session", "POST", large, {}).status == 413
    chunked = {"Transfer-Encoding": "chunked"}
    body = b"%x\r\n%s\r\n0\r\n\r\n" % (len(large), large)
    assert _raw(client, "POST /api/session", chunked, body).startswith(b"HTTP/1.1 413")
    assert client.ask("/").status == 200


def test_nothing_is_uploaded_and_no_other_method_is_known(client: Client) -> None:
    for method in ("PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"):
        assert client.ask("/api/runs", method).status == 405


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("{", 1003), ("null", 1003), ("[" * 900, 1003), ('{"got": "nothing"}', 1003), ('{"got": 3}', 1003),
        ('{"order": {"do": "stop"}}', 1003), (b"\x00\x01", 1003), ("x" * (MESSAGE_LIMIT_BYTES + 1), 1009),
    ],
)  # fmt: skip
def test_messages_that_are_none_end_their_socket_alone(client: Client, message: str | bytes, code: int) -> None:
    key = client.ask("/api/runs").json[0]["key"]
    with client.socket(f"/ws/{key}/state") as other, client.socket(f"/ws/{key}/state") as socket:
        socket.send(message)
        with pytest.raises(ConnectionClosed) as closed:
            _read_to_the_end(socket)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == code
        assert json.loads(other.recv(timeout=5))["kind"] == "status"


def test_more_sockets_than_allowed_are_told_so_and_may_come_when_others_left(lone_client: Client) -> None:
    key = lone_client.ask("/api/runs").json[0]["key"]
    with ExitStack() as stack:
        for _ in range(MOST_SOCKETS):
            stack.enter_context(lone_client.socket(f"/ws/{key}/images"))
        with lone_client.socket(f"/ws/{key}/state") as late, pytest.raises(ConnectionClosed) as closed:
            late.recv(timeout=5)
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1013, "too many pages are open; close some")
    deadline = time.monotonic() + 10
    while True:
        with lone_client.socket(f"/ws/{key}/state") as socket:
            try:
                assert json.loads(socket.recv(timeout=5))["kind"] == "status"
                break
            except ConnectionClosed:
                assert time.monotonic() < deadline


@pytest.mark.parametrize("path", ["/", "/static/js/main.js", "/api/runs", "/nothing", "/api/runs?x"])
def test_every_answer_forbids_what_a_page_must_not_do(client: Client, path: str) -> None:
    for given in ({}, client.bearer):
        headers = client.ask(path, headers=given).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "script-src 'self';" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "access-control-allow-origin" not in headers
        assert "server" not in headers


def test_the_page_holds_no_script_or_style_inside() -> None:
    class Finder(HTMLParser):
        faults: list[str] = []  # noqa: RUF012

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            names = dict(attrs)
            if (tag == "script" and "src" not in names) or tag == "style":
                self.faults.append(tag)
            self.faults += [name for name in names if name == "style" or name.startswith("on")]
            self.faults += [value for value in names.values() if value and value.startswith(("http:", "//", "data:"))]

    page = (files("vialight.web") / "static" / "index.html").read_text(encoding="utf-8")
    finder = Finder()
    finder.feed(page)
    assert page.count("<script") == 1
    assert finder.faults == []


def test_scripts_never_write_markup_and_need_no_network() -> None:
    folder = files("vialight.web") / "static" / "js"
    for script in folder.iterdir():
        text = script.read_text(encoding="utf-8")
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function", text)
        assert not re.search(r"https?://", text)


def test_the_page_is_served_to_this_machine_alone_unless_asked_otherwise(client: Client) -> None:
    assert PageSettings().is_local
    assert network_warning(PageSettings()) is None
    for host in ("0.0.0.0", "192.168.1.5", "printer.example", "::"):
        assert "without encryption" in str(network_warning(PageSettings(host)))
    for host in ("127.0.0.2", "::1", "localhost"):
        assert network_warning(PageSettings(host)) is None


def test_on_all_addresses_too_only_own_names_and_a_token_let_in(printing: PretendPrint) -> None:
    with PageProcess(printing.run, PageSettings("0.0.0.0", port=0, names=("printer.lab",))) as page:
        port = page.link.split("/#")[0].rsplit(":")[-1]
        client = Client(f"http://127.0.0.1:{port}/{page.link[page.link.index('#') :]}")
        assert page.warning is not None
        assert client.ask("/api/runs", headers={}).status == 401
        for name, status in (("printer.lab", 200), ("127.0.0.1", 200), ("evil.example", 421)):
            assert client.ask("/api/runs", headers=client.bearer | {"Host": f"{name}:{port}"}).status == status


def _read_to_the_end(socket: ClientConnection) -> None:
    while True:
        socket.recv(timeout=5)


def _raw(client: Client, request: str, headers: dict[str, str], body: bytes) -> bytes:
    host, port = client.host.split(":")
    lines = [f"{request} HTTP/1.1", f"Host: {client.host}", *(f"{name}: {value}" for name, value in headers.items())]
    with sockets.create_connection((host, int(port)), timeout=10) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode() + body)
        return connection.recv(4096)
