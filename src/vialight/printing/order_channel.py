"""Orders to a running print, each answered: stop, extend, change of mode.

Orders and answers are short JSON objects, each with its length before it, over a socket in the print's private folder
(or, where the system has no such sockets, on a port of this machine).  Stop needs none of that: the switch of the
`LightPanel` is pressed first, and the panel tells when the light is gone, also while the print's own process hangs.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from vialight.core.errors import InputError
from vialight.devices.panel import LightPanel
from vialight.printing.live_link import LiveLink
from vialight.system import wait_for

Order = Mapping[str, Any]
Obey = Callable[[Order], Mapping[str, Any]]

_ANSWER_TIMEOUT_S = 2.0
_DARK_TIMEOUT_S = 1.0
"""By which the projector is black, or its process is gone, after Stop: four times what is promised."""
_WRITTEN_DOWN_S = 0.3
"""That Stop waits for the print to say what it makes of it, once the projector is black."""
_PATIENCE_S = 5.0
"""For a connection to send its order."""
_MOST_CONNECTIONS = 16
_LARGEST_BYTES = 16_384
_LENGTH = struct.Struct("<I")
_SOCKET = "control"


class ControlServer:
    """Takes orders from other processes of this user while the print runs.

    Parameters
    ----------
    folder
        The print's shared folder.
    obey
        Called, on a thread of the server, with each order; returns the answer.  An `InputError` is sent back as text.

    Attributes
    ----------
    key, port
        What a `LiveLink` needs.
    """

    def __init__(self, folder: Path, obey: Obey) -> None:
        self._obey = obey
        self.key = os.urandom(32).hex()
        self._listener, self.port = _listen(folder)
        self._places = threading.BoundedSemaphore(_MOST_CONNECTIONS)
        self._closing = False
        threading.Thread(target=self._accept, name="control", daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Take no more orders."""
        self._closing = True
        self._listener.close()

    def _accept(self) -> None:
        while not self._closing:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                time.sleep(0.01)  # out of descriptors, or closed
                continue
            connection.settimeout(_PATIENCE_S)
            if not self._places.acquire(blocking=False):
                connection.close()
                continue
            try:
                threading.Thread(target=self._serve, args=(connection,), name="order", daemon=True).start()
            except RuntimeError:  # the system has no thread left: who asks again may find one
                self._places.release()
                connection.close()

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection, contextlib.suppress(OSError, ValueError):
                order = _receive(connection)
                if not hmac.compare_digest(str(order.pop("key", "")).encode(), self.key.encode()):
                    return
                try:
                    answer = dict(self._obey(order))
                except InputError as error:
                    answer = {"error": str(error)}
                _send(connection, answer)
        finally:
            self._places.release()


def send_order(link: LiveLink, order: Order, *, timeout_s: float = _ANSWER_TIMEOUT_S) -> dict[str, Any]:
    """Send an order to a running print and return its answer.

    Orders are ``{"do": "stop"}``, ``{"do": "extend", "turns": 1.0}`` and ``{"do": "mode", "mode": "auto"}`` (or
    ``"manual"``); each may say who asks: ``"by": "page"``.  For Stop see `stop_print`.

    Raises
    ------
    InputError
        The print refuses, does not answer in time, or is gone.
    """
    if not link.key:
        raise InputError("print", "is a recording that is replayed: it has no light", remedy="nothing is to be done")
    if order.get("do") == "stop":
        return stop_print(link, str(order.get("by", "unknown")), timeout_s=timeout_s)
    return _asked(link, order, timeout_s)


def stop_print(link: LiveLink, by: str, *, timeout_s: float = _ANSWER_TIMEOUT_S) -> dict[str, Any]:
    """End the light of a running print for good, and return what the projector then shows.

    The switch is pressed first of all.  The print's own process is told afterwards, so that it writes down who it was;
    where it hangs, that comes when it goes on, or never.

    Returns
    -------
    dict
        ``is_dark``, ``is_over``, and what the print answers.

    Raises
    ------
    InputError
        The light was not seen to go off.
    """
    panel = LightPanel(link.mailboxes)
    panel.press_stop()
    answers: list[dict[str, Any]] = []

    def tell() -> None:
        with contextlib.suppress(InputError):
            answers.append(_asked(link, {"do": "stop", "by": by}, timeout_s))

    telling = threading.Thread(target=tell, name="stop", daemon=True)
    telling.start()
    if wait_for(lambda: panel.is_dark_for_good, timeout_s=_DARK_TIMEOUT_S, every_s=0.002) is not None:
        raise InputError(
            "print",
            f"the light has not been seen to go off within {_DARK_TIMEOUT_S:g} s",
            remedy="use the switch on the machine",
        ) from TimeoutError()
    telling.join(min(timeout_s, _WRITTEN_DOWN_S))
    return (answers[0] if answers else {}) | {"is_dark": True, "is_over": True}


def _asked(link: LiveLink, order: Order, timeout_s: float) -> dict[str, Any]:
    try:
        with _connect(link) as connection:
            connection.settimeout(timeout_s)
            _send(connection, {**order, "key": link.key})
            answer = _receive(connection)
    except TimeoutError as error:
        raise InputError(
            "print", f"has not answered {dict(order)} within {timeout_s:g} s", remedy="try again"
        ) from error
    except (OSError, ValueError) as error:
        raise InputError("print", f"cannot be reached ({error})", remedy="check that it is running") from error
    if "error" in answer:
        raise InputError("print", str(answer["error"]))
    return answer


def _listen(folder: Path) -> tuple[socket.socket, int]:
    if hasattr(socket, "AF_UNIX"):
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(folder / _SOCKET))
        port = 0
    else:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.bind(("127.0.0.1", 0))
        port = int(listener.getsockname()[1])
    listener.listen(_MOST_CONNECTIONS)
    return listener, port


def _connect(link: LiveLink) -> socket.socket:
    if not link.port:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        address: Any = str(link.mailboxes / _SOCKET)
    else:
        connection, address = socket.socket(socket.AF_INET, socket.SOCK_STREAM), ("127.0.0.1", link.port)
    connection.settimeout(_ANSWER_TIMEOUT_S)
    try:
        connection.connect(address)
    except BaseException:
        connection.close()
        raise
    return connection


def _send(connection: socket.socket, table: Mapping[str, Any]) -> None:
    content = json.dumps(table).encode()
    connection.sendall(_LENGTH.pack(len(content)) + content)


def _receive(connection: socket.socket) -> dict[str, Any]:
    (length,) = _LENGTH.unpack(_exactly(connection, _LENGTH.size))
    if length > _LARGEST_BYTES:
        raise ValueError(f"{length} bytes where {_LARGEST_BYTES} are the most")
    try:
        table = json.loads(_exactly(connection, length))
    except RecursionError as error:
        raise ValueError("is no order") from error
    if not isinstance(table, dict):
        raise ValueError("is no order")  # noqa: TRY004 - what came is wrong, not what was called
    return table


def _exactly(connection: socket.socket, count: int) -> bytes:
    content = b""
    while len(content) < count:
        part = connection.recv(count - len(content))
        if not part:
            raise OSError("the other side has closed it")
        content += part
    return content
