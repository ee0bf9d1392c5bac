"""Starting the server: here, until it is told to end, or in a process of its own beside a print."""

from __future__ import annotations

import contextlib
import ipaddress
import json
import logging
import multiprocessing
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from vialight.core.errors import InputError
from vialight.system import deaf_to_interrupts, leave_interrupts_to_the_print

if TYPE_CHECKING:
    import uvicorn

    from vialight.web.access import Access
    from vialight.web.serving import PageHttpServer
    from vialight.web.stopping import StopProcess

DEFAULT_PORT = 8765
_START_TIMEOUT_S = 30.0
_LINGER_S = 60.0
"""For how long the page is served on after the process that prints was killed: it says so."""
_BACKLOG = 1024
"""Connections that the system holds until they are accepted."""
_NICE = 5
"""Recording and measuring go first."""
_LOOPBACK_NAMES = ("localhost", "ip6-localhost")


@dataclass(frozen=True)
class PageSettings:
    """Where the page is served.

    Parameters
    ----------
    host
        Address to listen on.
    port
        0: any that is free; None: the usual one, or any where that is taken.
    names
        More host names that people type to reach this machine.
    """

    host: str = "127.0.0.1"
    port: int | None = None
    names: tuple[str, ...] = ()

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach it."""
        if self.host in _LOOPBACK_NAMES:
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


def serve(
    root: str | Path, settings: PageSettings | None = None, *, announce: Callable[[str], None] | None = None
) -> None:
    """Serve the page of a run, or of a folder of runs, until Ctrl-C or SIGTERM.

    Parameters
    ----------
    root
        The folder.
    settings
        Where.
    announce
        Called with the link to open, when it can be opened.

    Raises
    ------
    InputError
        There is no such folder, or the address cannot be listened on.
    """
    settings = settings or PageSettings()
    with contextlib.closing(_prepare(Path(root), settings)) as prepared:
        if announce is not None:
            announce(prepared.link)
        with contextlib.suppress(KeyboardInterrupt):
            prepared.server.run(sockets=[prepared.listener])


class PageProcess:
    """The page's server in a process of its own, so that it can slow nothing down.

    Parameters
    ----------
    root
        A run's folder; its print need not have begun.
    settings
        Where.

    Attributes
    ----------
    link : str
        To be opened in a browser.  The secret is behind ``#``: no server sees it.
    stop_port : int
        Where Stop has its own listener.
    warning : str or None
        What to tell where others than this machine can reach the page.

    Raises
    ------
    InputError
        There is no such folder, the address cannot be listened on, or the process does not start in time.
    """

    def __init__(self, root: str | Path, settings: PageSettings | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        near, far = context.Pipe(duplex=False)
        settings = settings or PageSettings()
        self.warning = network_warning(settings)
        self._process: SpawnProcess = context.Process(
            target=_serve_beside, args=(Path(root).resolve(), settings, far), name="vialight page", daemon=True
        )
        with deaf_to_interrupts():
            self._process.start()
        far.close()
        with near:
            answer = _told(near) if near.poll(_START_TIMEOUT_S) else None
        if answer is None or "error" in answer:
            self.close()
            raise InputError(*(answer or {"error": ("page", "its server has not started")})["error"])
        self.link: str = answer["link"]
        self.stop_port: int = answer["stop_port"]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def is_running(self) -> bool:
        """Whether the server is there."""
        return self._process.is_alive()

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until the server ends."""
        self._process.join(timeout_s)

    def close(self) -> None:
        """End the server."""
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(5)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(5)


def network_warning(settings: PageSettings) -> str | None:
    """Return what to tell where others than this machine can reach the page; None where they cannot."""
    if settings.is_local:
        return None
    return (
        f"the page is served on {settings.host}, without encryption: whoever can listen to that network can read the "
        "token and stop the print; use a network that you trust, or an SSH tunnel to 127.0.0.1"
    )


@dataclass
class _Prepared:
    """What is ready to be served."""

    server: PageHttpServer
    listener: socket.socket
    stop: StopProcess
    link: str
    stop_port: int

    def close(self) -> None:
        self.listener.close()
        self.stop.close()


def _prepare(root: Path, settings: PageSettings, *, is_nice: bool = False) -> _Prepared:
    from vialight.web.access import Access
    from vialight.web.stopping import StopProcess
    from vialight.web.tokens import token_for

    root = root.resolve()
    if not root.is_dir():
        raise InputError(root, "there is no such folder", accepted="a run's folder, or a folder of runs")
    listener = _listen(settings)
    port = listener.getsockname()[1]
    stop_listener = _listen_beside(settings.host, port)
    access = Access(token_for(root), port, _names(settings), stop_listener.getsockname()[1])
    stop = StopProcess(root, access, stop_listener)  # first, and not nice: nothing goes before Stop
    try:
        if is_nice:
            with contextlib.suppress(OSError):
                os.nice(_NICE)
        server = _http_server(root, access)
    except BaseException:
        stop.close()
        listener.close()
        raise
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    shown = {"0.0.0.0": socket.gethostname(), "[::]": socket.gethostname()}.get(host, host)
    assert access.stop_port is not None
    return _Prepared(server, listener, stop, f"http://{shown}:{port}/#token={access.token}", access.stop_port)


def _http_server(root: Path, access: Access) -> PageHttpServer:
    import uvicorn

    from vialight.web.app import PageServer
    from vialight.web.catalogue import Catalogue
    from vialight.web.connections import Limits, Places
    from vialight.web.serving import HEADERS_LIMIT_BYTES, PageHttpServer, PageSocketProtocol
    from vialight.web.sockets import MESSAGE_LIMIT_BYTES

    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
    config = uvicorn.Config(
        PageServer(Catalogue(root), access).app(),
        log_config=None,
        access_log=False,  # nobody reads it, and the run's log says who stopped a print
        proxy_headers=False,  # an address that a client claims would get round the limit on tokens
        server_header=False,
        http="h11",
        h11_max_incomplete_event_size=HEADERS_LIMIT_BYTES,
        ws=PageSocketProtocol,
        ws_max_size=MESSAGE_LIMIT_BYTES,
        ws_per_message_deflate=False,  # pictures are packed already
        ws_ping_interval=5.0,
        ws_ping_timeout=10.0,
        timeout_graceful_shutdown=1,
    )
    return PageHttpServer(config, Places(Limits.of_this_process()))


def _listen_beside(host: str, port: int) -> socket.socket:
    """Listen on the port after the page's, where it is free, so that a page finds Stop again after a restart."""
    for wanted in (port + 1, 0):
        if wanted < 65536:
            with contextlib.suppress(OSError):
                return _bind(host, wanted)
    raise InputError("page", f"cannot listen on {host} for Stop", accepted="an address with a free port")


def _names(settings: PageSettings) -> tuple[str, ...]:
    own = () if settings.is_local else (socket.gethostname(), socket.getfqdn(), settings.host)
    return tuple(dict.fromkeys((*own, *settings.names)))


def _listen(settings: PageSettings) -> socket.socket:
    wanted = DEFAULT_PORT if settings.port is None else settings.port
    try:
        return _bind(settings.host, wanted)
    except OSError as error:
        if settings.port is None:
            with contextlib.suppress(OSError):
                return _bind(settings.host, 0)
        raise InputError(
            "page", f"cannot listen on {settings.host} port {wanted} ({error.strerror})",
            accepted="an address of this machine and a free port", remedy="choose another --port",
        ) from error  # fmt: skip


def _bind(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)  # who is given the link may use it at once
    except BaseException:
        listener.close()
        raise
    return listener


def _told(pipe: Connection[Any, Any]) -> dict[str, Any] | None:
    """Return what the page's process says, which is data and runs nothing; None where it says nothing, or no JSON."""
    try:
        told: dict[str, Any] = json.loads(pipe.recv_bytes())
    except (EOFError, ValueError):
        return None
    return told


def _serve_beside(root: Path, settings: PageSettings, pipe: Connection[Any, Any]) -> None:
    leave_interrupts_to_the_print()
    try:
        prepared = _prepare(root, settings, is_nice=True)
    except InputError as error:
        where, _, what = str(error).partition(": ")
        pipe.send_bytes(json.dumps({"error": (where, what)}).encode())
        return
    pipe.send_bytes(json.dumps({"link": prepared.link, "stop_port": prepared.stop_port}).encode())
    pipe.close()
    server = prepared.server
    with _ended_by_sigterm(server), contextlib.closing(prepared):
        threading.Thread(target=_outlive_for_a_while, args=(server, os.getppid()), daemon=True).start()
        import asyncio

        asyncio.run(server._serve([prepared.listener]))


@contextlib.contextmanager
def _ended_by_sigterm(server: uvicorn.Server) -> Iterator[None]:
    """Take the place of uvicorn's own handlers, which would end the server with every Ctrl-C of the print."""

    def stop(number: int, frame: object) -> None:
        server.should_exit = True

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _outlive_for_a_while(server: uvicorn.Server, parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    time.sleep(_LINGER_S)
    server.should_exit = True
