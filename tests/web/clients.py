"""Clients that say exactly what a test wants said."""

from __future__ import annotations

import http.client
import json
import socket
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from websockets.sync.client import ClientConnection, connect


@dataclass
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass
class Client:
    """Speaks to a page's server, by default as a program that knows the token."""

    link: str
    headers: dict[str, str] = field(default_factory=dict)

    @property
    def host(self) -> str:
        return urlsplit(self.link).netloc

    @property
    def token(self) -> str:
        return urlsplit(self.link).fragment.removeprefix("token=")

    @property
    def origin(self) -> str:
        return f"http://{self.host}"

    @property
    def bearer(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}

    def ask(
        self, path: str, method: str = "GET", body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> Answer:
        """Send a request with these headers, or with the token where none are given; `Host` may be among them."""
        connection = http.client.HTTPConnection(self.host, timeout=10)
        try:
            given = self.bearer if headers is None else headers
            connection.putrequest(method, path, skip_host="Host" in given, skip_accept_encoding=True)
            for name, value in given.items():
                connection.putheader(name, value)
            if body is not None:
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body)
            response = connection.getresponse()
            return Answer(
                response.status, {name.lower(): value for name, value in response.getheaders()}, response.read()
            )
        finally:
            connection.close()

    def post(self, path: str, body: Any = None, headers: dict[str, str] | None = None) -> Answer:
        return self.ask(path, "POST", b"" if body is None else json.dumps(body).encode(), headers)

    def cookie(self) -> str:
        """Let a page in, as the page does."""
        answer = self.post("/api/session", {"token": self.token}, {"Origin": self.origin})
        assert answer.status == 204, answer.body
        return answer.headers["set-cookie"].split(";")[0]

    def page_headers(self) -> dict[str, str]:
        """Return what a browser sends from our own page."""
        return {"Origin": self.origin, "Cookie": self.cookie()}

    def socket(self, path: str, headers: dict[str, str] | None = None, host: str | None = None) -> ClientConnection:
        port = int(self.host.rsplit(":", 1)[1])
        given = self.bearer if headers is None else headers
        return connect(
            f"ws://{host or self.host}{path}", sock=socket.create_connection(("127.0.0.1", port), timeout=10),
            additional_headers=given, max_size=2**26, compression=None, open_timeout=10, close_timeout=2, proxy=None,
        )  # fmt: skip
