"""Stop's own listener: a process that does nothing else, on a port of its own, with the smallest possible HTTP.

It takes ``POST /api/runs/KEY/stop`` and nothing more.  It reads no run, so that none can hold it up; whoever fills the
page's places, or hangs the page's process, is not in its way.  It ends with the process that has started it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from typing import Any

from vialight.core.errors import InputError
from vialight.system import leave_interrupts_to_the_print
from vialight.web.access import BODY_LIMIT_BYTES, Access, Asked, Refusal
from vialight.web.connections import Acceptor, Limits, Places, Reserve
from vialight.web.orders import OrderDesk
from vialight.web.runs import CannotTellError, cannot_tell, find_run

_LOG = logging.getLogger("vialight.web")
_LIMITS = Limits(strangers=64, of_one=64, inside=64)
_ANSWER_WITHIN_S = 10.0
_HEAD_LIMIT_BYTES = 8192
_SPARE_DESCRIPTORS = 12
_PRESS = re.compile(r"/api/runs/([0-9a-f]{12})/stop")
_AGAIN_S = 0.5
"""Before a listener that has died is started again."""


class StopListener:
    """Answers presses of Stop.

    Parameters
    ----------
    root
        A run's folder, or a folder of runs.
    access
        Who is let in; the same as for the page.
    """

    def __init__(self, root: Path, access: Access) -> None:
        assert access.stop_port is not None
        self.root, self.access, self.port = root, access, access.stop_port
        self.reserve = Reserve(_SPARE_DESCRIPTORS)
        self.desk = OrderDesk(self.reserve)
        self.places = Places(_LIMITS)
        self.tasks: set[asyncio.Task[None]] = set()

    async def serve(self, listener: socket.socket, until: asyncio.Event) -> None:
        """Serve on a socket that is listened on already, until an event is set."""
        acceptor = Acceptor(listener, lambda: _Press(self), self.places, self.reserve)
        acceptor.start()
        await until.wait()
        acceptor.close()
        self.desk.close()

    async def answer(self, asked: Asked, path: str, let_in: Callable[[], None]) -> tuple[int, dict[str, Any]]:
        """Return the status and what is told; `let_in` is called where the request has the right to ask."""
        try:
            self.access.check_names(asked, self.port)
            self.access.check_secret(asked)
            let_in()
            if asked.method != "POST":
                return 405, {"error": "takes POST only"}
            found = _PRESS.fullmatch(path)
            run = await asyncio.to_thread(self.reserve.spent_on, find_run, self.root, found[1]) if found else None
            if run is None:
                return 404, {"error": "no such run"}
            return 200, await self.desk.obey(run, {"do": "stop"}, f"page at {asked.client}")
        except Refusal as refusal:
            return refusal.status, {"error": refusal.why}
        except CannotTellError as error:
            return 503, {"error": str(error)}
        except InputError as error:
            return 409, {"error": str(error)}
        except OSError as error:
            return 503, {"error": str(cannot_tell(error.strerror or str(error)))}
        except Exception:
            _LOG.exception("while answering a press of Stop")
            return 500, {"error": "a fault of the server's own; use the switch on the machine"}


class _Press(asyncio.Protocol):
    """One connection: one request, one answer."""

    def __init__(self, listener: StopListener) -> None:
        self._listener = listener
        self._received = bytearray()
        self._is_heard = False
        self.address = ""

    @property
    def is_idle(self) -> bool:
        """Whether cutting it interrupts nothing."""
        return False

    def cut(self) -> None:
        """Close it, without a word and without waiting."""
        self._timer.cancel()
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to wait, not for long."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.address = str((transport.get_extra_info("peername") or ("",))[0])
        self._timer = asyncio.get_running_loop().call_later(_LIMITS.patience_s, self.cut)
        self._listener.places.enter(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give up the place; a press that was heard goes through."""
        self._timer.cancel()
        self._listener.places.leave(self)

    def data_received(self, data: bytes) -> None:
        """Hear a part of the request."""
        if self._is_heard:
            return
        self._received += data
        head, is_whole, body = bytes(self._received).partition(b"\r\n\r\n")
        if len(head) > _HEAD_LIMIT_BYTES:
            self._begin(None, (431, "too long"))
        elif is_whole:
            self._take(head, body)

    def _take(self, head: bytes, body: bytes) -> None:
        parsed = _parsed(head)
        if parsed is None:
            self._begin(None, (400, "no request"))
            return
        method, path, headers = parsed
        length = (headers.get("content-length") or ["0"])[0]
        if "transfer-encoding" in headers or not re.fullmatch("[0-9]{1,9}", length):
            self._begin(None, (400, "a body of unknown length"))
        elif int(length) > BODY_LIMIT_BYTES:
            self._begin(None, (413, f"larger than {BODY_LIMIT_BYTES} bytes"))
        elif len(body) >= int(length):
            own = self._transport.get_extra_info("sockname")
            self._begin((Asked(method, headers, self.address, str(own[0]) if own else None), path), None)

    def _begin(self, request: tuple[Asked, str] | None, fault: tuple[int, str] | None) -> None:
        """Answer on a task of its own, from now on in a place of its own."""
        self._is_heard = True
        self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(_ANSWER_WITHIN_S, self.cut)
        task = asyncio.get_running_loop().create_task(self._answer(request, fault))
        self._listener.tasks.add(task)
        task.add_done_callback(self._listener.tasks.discard)

    async def _answer(self, request: tuple[Asked, str] | None, fault: tuple[int, str] | None) -> None:
        more = {}
        if request is None:
            status, told = (fault[0], {"error": fault[1]}) if fault else (400, {})
        else:
            asked, path = request
            status, told = await self._listener.answer(asked, path, lambda: self._listener.places.let_in(self))
            origin = asked.header("origin")
            if origin.lower() in self._listener.access.origins(asked.header("host")):
                # What is told is for our page alone, which stands on another port.
                more = {"Access-Control-Allow-Origin": origin, "Access-Control-Allow-Credentials": "true"}
        self._transport.write(_response(status, told, more))
        self._transport.close()


def _parsed(head: bytes) -> tuple[str, str, dict[str, list[str]]] | None:
    """Return method, path and headers; None where it is no request of HTTP/1."""
    first, *lines = head.decode("latin-1").split("\r\n")
    request = re.fullmatch(r"([A-Z]{1,16}) (/[!-~]*) HTTP/1\.[01]", first)
    headers: dict[str, list[str]] = defaultdict(list)
    for line in lines:
        found = re.fullmatch(r"([!-9;-~]+):[ \t]*(.*?)[ \t]*", line)
        if found is None:
            return None
        headers[found[1].lower()].append(found[2])
    return (request[1], request[2], headers) if request else None


def _response(status: int, told: dict[str, Any], more: dict[str, str]) -> bytes:
    body = json.dumps(told).encode()
    headers = {
        "Content-Type": "application/json", "Content-Length": str(len(body)), "Connection": "close",
        "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Vary": "Origin", **more,
    }  # fmt: skip
    lines = [f"HTTP/1.1 {status} {HTTPStatus(status).phrase}", *(f"{name}: {value}" for name, value in headers.items())]
    return "\r\n".join([*lines, "", ""]).encode("latin-1") + body


class StopProcess:
    """Keeps Stop's listener running, in a process of its own.

    Parameters
    ----------
    root
        A run's folder, or a folder of runs.
    access
        Who is let in.
    listener
        Stop's own; it is kept open here, too, so that presses wait in it while the process is started (again).
    """

    def __init__(self, root: Path, access: Access, listener: socket.socket) -> None:
        self._listener = listener
        self._settings = {
            "root": str(root), "token": access.token, "port": access.port, "names": list(access.names),
            "stop_port": access.stop_port,
        }  # fmt: skip
        self._is_closed = False
        self._process = self._begin()
        threading.Thread(target=self._keep, name="stop", daemon=True).start()

    @property
    def pid(self) -> int:
        """Of the process that listens now."""
        return self._process.pid

    def close(self) -> None:
        """End it."""
        self._is_closed = True
        with contextlib.suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(2)
        if self._process.poll() is None:
            self._process.kill()
        self._listener.close()

    def _begin(self) -> subprocess.Popen[bytes]:
        number = self._listener.fileno()
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, str(number)], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
            pass_fds=[number],
        )  # fmt: skip
        assert process.stdin is not None
        with contextlib.suppress(OSError):  # it has ended already: it is begun again
            # The token goes where no other user can see it, as arguments can be seen.
            process.stdin.write(json.dumps(self._settings).encode() + b"\n")
            process.stdin.flush()
        return process

    def _keep(self) -> None:
        while not self._is_closed:
            self._process.wait()
            time.sleep(_AGAIN_S)
            if not self._is_closed:
                with contextlib.suppress(OSError):
                    self._process = self._begin()


async def _serve(listener: StopListener, number: int) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()

    def hear() -> None:
        if not os.read(0, 4096):
            loop.remove_reader(0)
            ended.set()

    loop.add_reader(0, hear)
    with socket.socket(fileno=number) as listening:
        await listener.serve(listening, ended)


def _main(number: int) -> None:
    leave_interrupts_to_the_print()
    settings = json.loads(sys.stdin.buffer.readline())
    access = Access(settings["token"], settings["port"], tuple(settings["names"]), settings["stop_port"])
    asyncio.run(_serve(StopListener(Path(settings["root"]), access), number))
    os._exit(0)  # without waiting for threads whose print does not answer


if __name__ == "__main__":
    _main(int(sys.argv[1]))
