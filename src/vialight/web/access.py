"""Who may speak to the page's server: token, Host and Origin, sizes, and what browsers are told to refuse.

The token never stands in an address that is sent: the link that is printed has it behind ``#``, which browsers keep
to themselves; the page sends it once, in a body, and gets a cookie that scripts cannot read.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

BODY_LIMIT_BYTES = 4096
"""Orders and tokens are short; nothing is uploaded."""
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


class RateLimit:
    """Counts failures by address over a time that slides.

    Parameters
    ----------
    most
        Failures of one address that are borne.
    most_in_all
        Of all addresses together.
    window_s
        How long a failure counts.
    clock
        Seconds.

    Examples
    --------
    >>> limit = RateLimit(most=2, clock=lambda: 0.0)
    >>> for _ in range(2):
    ...     limit.fail("10.0.0.9")
    >>> limit.wait_s("10.0.0.9"), limit.wait_s("10.0.0.8")
    (60.0, 0.0)
    """

    def __init__(
        self, most: int = 10, most_in_all: int = 100, window_s: float = 60.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._most, self._most_in_all, self._window_s, self._clock = most, most_in_all, window_s, clock
        self._failures: deque[tuple[float, str]] = deque()

    def fail(self, address: str) -> None:
        """Count a failure."""
        self._failures.append((self._clock(), address))
        while len(self._failures) > self._most_in_all:
            self._failures.popleft()

    def wait_s(self, address: str) -> float:
        """Return how long an address must wait; 0 where it need not."""
        now = self._clock()
        while self._failures and self._failures[0][0] <= now - self._window_s:
            self._failures.popleft()
        own = [when for when, of in self._failures if of == address]
        counted = own if len(own) >= self._most else [when for when, _ in self._failures]
        is_over = len(own) >= self._most or len(self._failures) >= self._most_in_all
        return counted[0] + self._window_s - now if is_over else 0.0


@dataclass
class Access:
    """What is let in.

    Parameters
    ----------
    token
        The secret.
    port
        Where the server listens.
    names
        Host names, besides those of this machine's loopback, under which the page may be asked for.
    limit
        On wrong tokens.
    """

    token: str
    port: int
    names: tuple[str, ...] = ()
    limit: RateLimit = field(default_factory=RateLimit)

    @property
    def cookie_name(self) -> str:
        """Cookies do not tell ports apart; their names do."""
        return f"vialight-{self.port}"

    @property
    def cookie_value(self) -> str:
        """Proves that the token was known, also to the server that comes after a restart."""
        return hmac.new(self.token.encode(), b"vialight page", hashlib.sha256).hexdigest()

    def is_host(self, host: str, own_address: str | None) -> bool:
        """Tell whether a Host header names this server.

        A page of another site whose name was bound to our address (DNS rebinding) comes with that site's name.  The
        very address that the connection came to is always ours.
        """
        known = [*_LOOPBACK, *self.names]
        if own_address:
            known.append(f"[{own_address}]" if ":" in own_address else own_address)
        allowed = {f"{name.lower()}:{self.port}" for name in known}
        if self.port == 80:
            allowed |= {name.lower() for name in known}
        return host.lower() in allowed

    def is_token(self, given: str) -> bool:
        """Compare in constant time."""
        return hmac.compare_digest(_bytes(given), _bytes(self.token))

    def is_cookie(self, given: str) -> bool:
        """Compare in constant time."""
        return hmac.compare_digest(_bytes(given), _bytes(self.cookie_value))


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")  # what JSON may hold, and UTF-8 not


class Refusal(Exception):  # noqa: N818 - it is an answer, not a fault of ours
    """A request that is not let in."""

    def __init__(self, status: int, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.status, self.why, self.wait_s = status, why, wait_s


class Gate:
    """The outermost layer: nothing behind it sees a request that is not ours.

    Parameters
    ----------
    app
        What is behind.
    access
        What is let in.
    is_public
        Whether a method and path need no token: the page itself, which holds nothing, and the place to send it to.
    """

    def __init__(self, app: ASGIApp, access: Access, is_public: Callable[[str, str], bool]) -> None:
        self._app, self._access, self._is_public = app, access, is_public

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answer it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        try:
            self._check(scope)
        except Refusal as refusal:
            await _refuse(scope, receive, send, refusal)
            return
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return
        try:
            body = await _whole_body(scope, receive)
        except Refusal as refusal:
            await _refuse(scope, receive, send, refusal)
            return
        await self._app(scope, _replay(body, receive), _with_headers(send))

    def _check(self, scope: Scope) -> None:
        headers = Headers(scope=scope)
        is_socket = scope["type"] == "websocket"
        method = "GET" if is_socket else scope["method"]
        hosts, own = headers.getlist("host"), (scope.get("server") or (None,))[0]
        if len(hosts) != 1 or not self._access.is_host(hosts[0], own):
            raise Refusal(421, "this name is not one of this server's; use the address that vialight printed")
        origins = headers.getlist("origin")
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            raise Refusal(403, "asked for by a page of another origin")
        is_plain_visit = method == "GET" and headers.get("sec-fetch-mode") == "navigate" and not is_socket
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not is_plain_visit:
            raise Refusal(403, "asked for by a page of another site")
        if scope.get("query_string"):
            raise Refusal(400, "addresses of this server have no query")
        if not is_socket and self._is_public(method, scope["path"]):
            return
        self._check_secret(headers, scope, is_own=bool(origins) or (method == "GET" and not is_socket))

    def _check_secret(self, headers: Headers, scope: Scope, *, is_own: bool) -> None:
        """Take the cookie from our own page, or the token from a program.

        A browser says where an order or a socket comes from; without that (`is_own`) a cookie proves nothing.
        """
        address = (scope.get("client") or ("",))[0]
        cookie, bearer = _cookie(headers, self._access.cookie_name), headers.get("authorization", "")
        if cookie is not None and is_own and self._access.is_cookie(cookie):
            return  # also while others at this address guess: who may stop the print must not be locked out
        wait_s = self._access.limit.wait_s(address)
        if wait_s > 0:
            raise Refusal(429, f"too many wrong tokens; wait {wait_s:.0f} s", wait_s)
        if bearer.lower().startswith("bearer "):
            if self._access.is_token(bearer[7:].strip()):
                return
            self._access.limit.fail(address)
            raise Refusal(401, "wrong token")
        if cookie is not None and is_own:
            self._access.limit.fail(address)
            raise Refusal(401, "the token has changed; open the link that vialight printed")
        raise Refusal(401, "needs the token; open the link that vialight printed")


def _cookie(headers: Headers, name: str) -> str | None:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(name)
    except CookieError:
        return None
    return found.value if found else None


async def _whole_body(scope: Scope, receive: Receive) -> bytes:
    announced = Headers(scope=scope).get("content-length", "0")
    if not announced.isdigit() or int(announced) > BODY_LIMIT_BYTES:
        raise Refusal(413, f"larger than {BODY_LIMIT_BYTES} bytes")
    body: bytes = b""
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return body
        body += bytes(message.get("body", b""))
        if len(body) > BODY_LIMIT_BYTES:
            raise Refusal(413, f"larger than {BODY_LIMIT_BYTES} bytes")
        if not message.get("more_body"):
            return body


def _replay(body: bytes, receive: Receive) -> Receive:
    is_given = False

    async def again() -> Message:
        nonlocal is_given
        if is_given:
            return await receive()
        is_given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


def _with_headers(send: Send) -> Send:
    async def guarded(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return guarded


async def _refuse(scope: Scope, receive: Receive, send: Send, refusal: Refusal) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": refusal.why})
        return
    body = json.dumps({"error": refusal.why}).encode()
    headers: list[tuple[bytes, bytes]] = [
        (b"content-type", b"application/json"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    if refusal.wait_s:
        headers.append((b"retry-after", str(int(refusal.wait_s) + 1).encode()))
    start: dict[str, Any] = {"type": "http.response.start", "status": refusal.status, "headers": headers}
    guarded = _with_headers(send)
    await guarded(start)
    await guarded({"type": "http.response.body", "body": body})
