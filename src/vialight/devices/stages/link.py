"""The line to a GCS controller, over TCP or a serial port, as pipython wants it.

pipython has lines of its own.  They poll without a pause, which holds a processor and Python's lock; they connect
without a timeout, wait for ever once a socket is closed, and do not say when an answer came.  This one waits in the
system, sees the end of a connection, and keeps the times.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

from vialight.core.errors import InputError
from vialight.devices.protocols import Clock, DeviceError, DeviceTimeoutError

CODEPAGE = "cp1252"
_WAIT_S = 0.01
"""Of one look for an answer."""
_CONNECT_S = 2.0
ADDRESSES = "socket://HOST:PORT or serial:///dev/ttyUSB0?baud=115200"


class Link:
    """Sends questions and takes answers; times of the last ones are on the print's clock.

    Parameters
    ----------
    address
        ``socket://HOST:PORT`` or ``serial:///dev/ttyUSB0?baud=115200``.
    clock
        The print's.

    Attributes
    ----------
    asked_s, answered_s : float
        When the last question left, and when the first of its answer came.

    Raises
    ------
    InputError
        The address is neither.
    DeviceError
        Nobody answers there.
    """

    connectionid = 0

    def __init__(self, address: str, clock: Clock) -> None:
        self._address, self._clock = address, clock
        self._timeout_ms = 1000
        self._port: _Port | None = _opened(address)
        self.asked_s = self.answered_s = 0.0
        self._has_begun = True

    def __str__(self) -> str:
        return self._address

    @property
    def connected(self) -> bool:
        """Whether the line is open."""
        return self._port is not None

    @property
    def timeout(self) -> int:
        """Milliseconds after which pipython gives up an answer."""
        return self._timeout_ms

    def settimeout(self, timeout_ms: int) -> None:
        """Set the timeout."""
        self._timeout_ms = timeout_ms

    def send(self, message: str) -> None:
        """Send a question or a command."""
        self._has_begun = False
        self.asked_s = self._clock.now_s()
        self._open_port().write(message.encode(CODEPAGE))

    def read(self) -> str:
        """Return what has come, waiting a moment for it; empty where nothing has."""
        content = self._open_port().read()
        if content and not self._has_begun:
            self._has_begun, self.answered_s = True, self._clock.now_s()
        return content.decode(CODEPAGE, errors="replace")

    def flush(self) -> None:
        """Drop what has come."""
        while self.read():
            pass

    def resynchronise(self, identity: str, timeout_s: float) -> None:
        """Bring questions and answers in step again: ask for the identity, and drop all that comes before it.

        Raises
        ------
        DeviceTimeoutError
            It does not come.
        """
        deadline = time.monotonic() + timeout_s
        self.send("*IDN?\n")
        received = ""
        while not received.endswith(identity):
            if time.monotonic() > deadline:
                raise DeviceTimeoutError("stage", f"has not answered within {timeout_s:.2g} s")
            received += self.read()

    def close(self) -> None:
        """Close the line; again does nothing."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()

    unload = close

    def register_connection_status_changed_callback(self, callback: Callable[[Any], None]) -> None:
        """Do nothing: pipython need not be told of changes."""

    unregister_connection_status_changed_callback = register_connection_status_changed_callback

    def _open_port(self) -> _Port:
        if self._port is None:
            raise OSError("the line is closed")
        return self._port


class _Port(Protocol):
    def read(self) -> bytes: ...
    def write(self, content: bytes) -> None: ...
    def close(self) -> None: ...


class _TcpPort:
    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=_CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self) -> bytes:
        self._socket.settimeout(_WAIT_S)
        try:
            content = self._socket.recv(4096)
        except TimeoutError:
            return b""
        if not content:
            raise ConnectionResetError("closed by the controller")
        return content

    def write(self, content: bytes) -> None:
        self._socket.settimeout(_CONNECT_S)
        self._socket.sendall(content)

    def close(self) -> None:
        self._socket.close()


class _SerialPort:
    def __init__(self, path: str, baud: int) -> None:
        import serial  # comes with pipython

        self._port = serial.Serial(path, baud, timeout=_WAIT_S, write_timeout=_CONNECT_S)
        # Left alone, a USB adapter keeps answers for 16 ms.  Not every system, or adapter, can be asked not to.
        with contextlib.suppress(AttributeError, OSError, ValueError):
            self._port.set_low_latency_mode(True)

    def read(self) -> bytes:
        first: bytes = self._port.read(1)
        return first + self._port.read(self._port.in_waiting) if first else first

    def write(self, content: bytes) -> None:
        self._port.write(content)

    def close(self) -> None:
        self._port.close()


def _opened(address: str) -> _Port:
    parts = urlsplit(address)
    try:
        if parts.scheme == "socket" and parts.hostname and parts.port:
            return _TcpPort(parts.hostname, parts.port)
        if parts.scheme == "serial" and parts.path and set(parse_qs(parts.query)) <= {"baud"}:
            return _SerialPort(parts.path, int(parse_qs(parts.query).get("baud", ["115200"])[0]))
    except ValueError as error:
        raise InputError("[stage.settings]", f"address is {address!r} ({error})", accepted=ADDRESSES) from error
    except OSError as error:
        raise DeviceError(
            "stage", f"cannot be reached at {address} ({error})", "check that it is on, and its address"
        ) from error
    raise InputError("[stage.settings]", f"address is {address!r}", accepted=ADDRESSES)
