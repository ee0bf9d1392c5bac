"""The page's HTTP server: uvicorn, with places for its connections (see `vialight.web.connections`)."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

from vialight.web.connections import Acceptor, Places, Reserve

CONNECTION = "vialight.connection"
"""Where a request's scope has its connection, under ``state``."""
_SPARE_DESCRIPTORS = 8
_PATIENCE_WITH_VISITORS_S = 20.0
"""For someone without a token to take one of the page's own files; others may need the place sooner."""
HEADERS_LIMIT_BYTES = 16_384


class PageProtocol(H11Protocol):
    """A connection that counts as a stranger's until the gate has let a request of it in."""

    def __init__(
        self,
        config: uvicorn.Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        places: Places,
    ) -> None:
        super().__init__(config, server_state, {**app_state, CONNECTION: self}, _loop)
        self._places = places
        self._timer: asyncio.TimerHandle | None = None
        self._is_socket = False

    @property
    def address(self) -> str:
        """The other side's."""
        return self.client[0] if self.client else ""

    @property
    def is_idle(self) -> bool:
        """Whether nothing is asked or answered."""
        return not self._is_socket and (self.cycle is None or self.cycle.response_complete)

    def cut(self) -> None:
        """Close it, without a word and without waiting."""
        self._wait_no_longer()
        self.transport.abort()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a stranger's place."""
        super().connection_made(transport)
        self._places.enter(self)
        self._wait(self._places.limits.patience_s)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give up the place."""
        self.left()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Wait for the next request, which must come in whole in time, too."""
        self._wait(self._places.limits.patience_s + self.timeout_keep_alive)
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Go on as a websocket, in the same place."""
        self._is_socket = True
        super().handle_websocket_upgrade(event)

    def let_in(self) -> None:
        """Hear that a request has come in whole, from someone who may ask."""
        self._wait_no_longer()
        self._places.let_in(self)

    def show_in(self) -> None:
        """Hear that a stranger is given what everybody may have."""
        self._wait(_PATIENCE_WITH_VISITORS_S)

    def left(self) -> None:
        """Give up the place."""
        self._wait_no_longer()
        self._places.leave(self)

    def _wait(self, seconds: float) -> None:
        self._wait_no_longer()
        if not self.transport.is_closing():
            self._timer = self.loop.call_later(seconds, self.cut)

    def _wait_no_longer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class PageSocketProtocol(WebSocketsSansIOProtocol):
    """A websocket, which keeps the place of the connection that it came by."""

    def connection_lost(self, exc: Exception | None) -> None:
        """Give up the place."""
        self.app_state[CONNECTION].left()
        super().connection_lost(exc)


class PageHttpServer(uvicorn.Server):
    """Serves on sockets that are listened on already.

    Parameters
    ----------
    config
        Of uvicorn.
    places
        For connections.
    """

    def __init__(self, config: uvicorn.Config, places: Places) -> None:
        super().__init__(config)
        self._places = places
        self._reserve = Reserve(_SPARE_DESCRIPTORS)
        self._acceptors: list[Acceptor] = []

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to accept."""
        await super().startup(sockets=[])
        self._acceptors = [Acceptor(one, self._protocol, self._places, self._reserve) for one in sockets or []]
        for acceptor in self._acceptors:
            acceptor.start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept no more, and end what is under way."""
        for acceptor in self._acceptors:
            acceptor.close()
        await super().shutdown(sockets=sockets)
        self._reserve.close()

    def _protocol(self) -> asyncio.Protocol:
        return PageProtocol(self.config, self.server_state, self.lifespan.state, places=self._places)
