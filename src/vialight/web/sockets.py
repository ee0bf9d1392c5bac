"""Websockets: each sends the newest message of its kinds, one of a kind at a time, and takes orders."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from vialight.core.errors import InputError
from vialight.store import to_json
from vialight.web.orders import OrderDesk, check_order
from vialight.web.runs import CannotTellError
from vialight.web.watching import CHANNELS, RunWatch

_LOG = logging.getLogger("vialight.web")

MOST_SOCKETS = 48
"""Three a page: sixteen pages."""
MESSAGE_LIMIT_BYTES = 1024
_PENDING_ORDERS = 4
_MOST_PENDING_STOPS = 16
_MOST_ORDERS = 1 << 53
"""A socket counts no further: what the page's numbers can tell apart."""
_TRY_LATER, _NOT_UNDERSTOOD = 1013, 1003


async def serve_socket(socket: WebSocket, watch: RunWatch, channel: str, desk: OrderDesk) -> None:
    """Feed a page until it leaves.

    The page answers every message with ``{"got": kind}``; until then no other of that kind is sent, so that a slow page
    skips ahead.  ``{"order": {...}, "id": n}`` is answered with ``{"kind": "answer", "id": n, ...}``.

    Parameters
    ----------
    socket
        Not accepted yet.
    watch
        Of the run.
    channel
        One of `CHANNELS`.
    desk
        Takes the orders.
    """
    await socket.accept()
    page = _Page(socket, watch, CHANNELS[channel], desk)
    watch.board.enter(page.wake, page.kinds)
    tasks = {asyncio.create_task(page.send()), asyncio.create_task(page.receive())}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
                task.result()
    finally:
        watch.board.leave(page.wake)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def refuse_socket(socket: WebSocket, why: str) -> None:
    """Tell a page why it gets no socket; accepted first, since browsers hide the reason of a refused one."""
    await socket.accept()
    await socket.close(_TRY_LATER, why)


class _Page:
    def __init__(self, socket: WebSocket, watch: RunWatch, kinds: tuple[str, ...], desk: OrderDesk) -> None:
        self._socket, self._watch, self.kinds, self._desk = socket, watch, kinds, desk
        self.wake = asyncio.Event()
        self._sent = dict.fromkeys(kinds, 0)
        self._under_way: set[str] = set()
        self._orders: set[asyncio.Task[None]] = set()
        self._sending = asyncio.Lock()
        self.wake.set()

    async def send(self) -> None:
        while True:
            await self.wake.wait()
            self.wake.clear()
            for kind in self.kinds:
                number, message = self._watch.board.newest(kind)
                if kind in self._under_way or number <= self._sent[kind] or not message:
                    continue
                self._sent[kind] = number
                self._under_way.add(kind)
                await self._put(message)

    async def _put(self, message: str | bytes) -> None:
        async with self._sending:
            if isinstance(message, str):
                await self._socket.send_text(message)
            else:
                await self._socket.send_bytes(message)

    async def receive(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            given = _parse(message.get("text"))
            match given:
                case {"got": str(kind)} if kind in self.kinds:
                    self._under_way.discard(kind)
                    self.wake.set()
                case {"order": order, "id": int(number)} if 0 <= number < _MOST_ORDERS:
                    self._take_order(order, number)
                case _:
                    await self._socket.close(_NOT_UNDERSTOOD, "not understood")
                    return

    def _take_order(self, order: Any, number: int) -> None:
        is_stop = isinstance(order, dict) and order.get("do") == "stop"
        if len(self._orders) >= (_MOST_PENDING_STOPS if is_stop else _PENDING_ORDERS):
            return  # a press of Stop is under way
        task = asyncio.create_task(self._answer(order, number))
        self._orders.add(task)
        task.add_done_callback(self._orders.discard)

    async def _answer(self, order: Any, number: int) -> None:
        by = f"page at {self._socket.client.host if self._socket.client else 'unknown'}"
        try:
            answer = await self._desk.obey(self._watch.run, check_order(order), by)
        except CannotTellError as error:
            answer = {"error": str(error), "cannot_tell": True}
        except InputError as error:
            answer = {"error": str(error)}
        except Exception:
            _LOG.exception("while passing an order on")
            answer = {"error": "a fault of the server's own", "cannot_tell": True}
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
            await self._put(to_json({"kind": "answer", "id": number, "answer": answer}))


def _parse(text: str | None) -> Any:
    if text is None or len(text) > MESSAGE_LIMIT_BYTES:
        return None
    with contextlib.suppress(ValueError, RecursionError):
        return json.loads(text)
    return None
