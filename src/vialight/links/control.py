"""Orders to a running print, each answered: stop, extend, change of mode."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Mapping
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client, Connection, Listener
from types import TracebackType
from typing import Any, Self

from vialight.errors import InputError
from vialight.links.live import LiveLink

Order = Mapping[str, Any]
Obey = Callable[[Order], Mapping[str, Any]]

_ANSWER_TIMEOUT_S = 2.0


class ControlServer:
    """Takes orders from other processes of this user while the print runs.

    Parameters
    ----------
    obey
        Called, on a thread of the server, with each order; returns the answer.  An `InputError` is sent back as text.

    Attributes
    ----------
    address, key : str
        What a `LiveLink` needs.
    """

    def __init__(self, obey: Obey) -> None:
        self._obey = obey
        secret = os.urandom(32)
        self.key = secret.hex()
        self._listener = Listener(authkey=secret)
        self.address = str(self._listener.address)
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
                connection = self._listener.accept()
            except (OSError, EOFError, AuthenticationError):
                continue  # who cannot prove that he belongs here, or left in the middle of it
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: Connection[Any, Any]) -> None:
        with connection, contextlib.suppress(OSError, EOFError):
            while True:
                order = connection.recv()
                try:
                    answer = dict(self._obey(order))
                except InputError as error:
                    answer = {"error": str(error)}
                connection.send(answer)


def send_order(link: LiveLink, order: Order, *, timeout_s: float = _ANSWER_TIMEOUT_S) -> dict[str, Any]:
    """Send an order to a running print and return its answer.

    Orders are ``{"do": "stop"}``, ``{"do": "extend", "turns": 1.0}`` and ``{"do": "mode", "mode": "auto"}`` (or
    ``"manual"``); each may say who asks: ``"by": "page"``.

    Raises
    ------
    InputError
        The print refuses, does not answer in time, or is gone.
    """
    try:
        with Client(link.control, authkey=bytes.fromhex(link.key)) as connection:
            connection.send(dict(order))
            if not connection.poll(timeout_s):
                raise InputError("print", f"has not answered {order} within {timeout_s:g} s", remedy="try again")
            answer: dict[str, Any] = connection.recv()
    except (OSError, EOFError, AuthenticationError) as error:
        raise InputError("print", f"cannot be reached ({error})", remedy="check that it is running") from error
    if "error" in answer:
        raise InputError("print", str(answer["error"]))
    return answer
