"""The page's outermost layer: who and what passes, and what browsers are told to refuse."""

from __future__ import annotations

import json
import logging
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from vialight.web.access import BODY_LIMIT_BYTES, Access, Asked, Refusal, name_of
from vialight.web.serving import CONNECTION, PageProtocol

_LOG = logging.getLogger("vialight.web")
_MOST_DIGITS = 9
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'{stop}; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


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
        asked = asked_of(scope)
        try:
            is_known = self._check(asked, scope)
            body = b"" if asked.is_socket else await _whole_body(asked, receive)
        except Refusal as refusal:
            await self._refuse(scope, receive, send, refusal)
            return
        if is_known:
            let_in(scope)
        else:
            _show_in(scope)
        if asked.is_socket:
            await self._app(scope, receive, send)
        else:
            await self._pass(asked, scope, _replay(body, receive), send)

    async def _pass(self, asked: Asked, scope: Scope, receive: Receive, send: Send) -> None:
        is_begun = False

        async def watched(message: Message) -> None:
            nonlocal is_begun
            is_begun = True
            await send(message)

        try:
            await self._app(scope, receive, self._with_headers(watched, name_of(asked.header("host"))))
        except Exception:
            _LOG.exception("while answering %s %.200s", asked.method, scope["path"])
            if is_begun:
                raise
            await self._refuse(scope, receive, send, Refusal(500, "a fault of the server's own; its log has more"))

    def _check(self, asked: Asked, scope: Scope) -> bool:
        """Tell whether a request comes from someone who is let in; everybody may have what is public."""
        self._access.check_names(asked)
        if scope.get("query_string"):
            raise Refusal(400, "addresses of this server have no query")
        if not asked.is_socket and self._is_public(asked.method, scope["path"]):
            return self._access.has_cookie(asked)
        self._access.check_secret(asked)
        return True

    def _with_headers(self, send: Send, name: str | None) -> Send:
        """Add what browsers are told; `name`: the host's, where it is one of ours."""
        port = self._access.stop_port
        stop = "" if name is None or port is None else f" http://{name}:{port}"

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.setdefault("Content-Security-Policy", _POLICY.format(stop=stop))
                for header, value in _HEADERS.items():
                    headers.setdefault(header, value)
            await send(message)

        return guarded

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, refusal: Refusal) -> None:
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
        guarded = self._with_headers(send, None)
        await guarded(start)
        await guarded({"type": "http.response.body", "body": body})


def asked_of(scope: Scope) -> Asked:
    """Return what a request asks, as far as it decides about being let in."""
    headers: dict[str, list[str]] = defaultdict(list)
    for name, value in scope["headers"]:
        headers[name.decode("latin-1").lower()].append(value.decode("latin-1"))
    is_socket = scope["type"] == "websocket"
    method = "GET" if is_socket else scope["method"]
    client, own = (scope.get("client") or ("",))[0], (scope.get("server") or (None,))[0]
    return Asked(method, headers, client, own, is_socket)


def let_in(scope: Scope) -> None:
    """Give a request's connection a place that no stranger can take."""
    connection = scope.get("state", {}).get(CONNECTION)
    if isinstance(connection, PageProtocol):
        connection.let_in()


def _show_in(scope: Scope) -> None:
    connection = scope.get("state", {}).get(CONNECTION)
    if isinstance(connection, PageProtocol):
        connection.show_in()


async def _whole_body(asked: Asked, receive: Receive) -> bytes:
    too_large = Refusal(413, f"larger than {BODY_LIMIT_BYTES} bytes")
    announced = asked.header("content-length", "0")
    if len(announced) > _MOST_DIGITS or not announced.isdecimal() or int(announced) > BODY_LIMIT_BYTES:
        raise too_large
    body: bytes = b""
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return body
        body += bytes(message.get("body", b""))
        if len(body) > BODY_LIMIT_BYTES:
            raise too_large
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
