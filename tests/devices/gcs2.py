"""A GCS 2 controller with one rotation axis, served over TCP or a pty: what pipython really asks, motion and faults.

The motion is the controller's own profile, a trapezoid of speed with acceleration, so that the stage's true angle is
known at any time.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

IDENTITY = "(c)2015 Physik Instrumente (PI) GmbH & Co. KG, C-863.11, 0115500620, 1.2.1.0"
ACCELERATION_DEG_S2 = 2000.0


class Piece(NamedTuple):
    """Of a motion: from when on, where it begins, with which speed and acceleration."""

    start_s: float
    angle_deg: float
    speed_deg_s: float
    acceleration_deg_s2: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Angle and speed."""
        since = max(0.0, time_s - self.start_s)
        return (
            self.angle_deg + self.speed_deg_s * since + self.acceleration_deg_s2 * since**2 / 2,
            self.speed_deg_s + self.acceleration_deg_s2 * since,
        )


@dataclass
class Faults:
    """What the controller does wrong, to be changed while it runs."""

    is_silent: bool = False
    delay_s: Callable[[], float] = lambda: 0.0
    """Before each answer."""
    answer_share: float = 0.5
    """Of the delay that passes after the answer was worked out: 1 is an answer that is as old as the delay."""
    refuses: dict[str, int] = field(default_factory=dict)
    """Command to the error code that it gets."""
    garbles: bool = False
    stalls: bool = False
    """A motion error: servo off, at rest, error -1024."""


class Controller:
    """One axis, ``1``; every line that comes is kept in `heard`."""

    def __init__(self, *, is_referenced: bool = False, range_deg: float = 1e6, reference_s: float = 0.2) -> None:
        self.faults = Faults()
        self.heard: list[str] = []
        self.is_referenced, self.servo, self.error = is_referenced, False, 0
        self._range, self._reference_s, self._busy_until = range_deg, reference_s, 0.0
        self._velocity, self._pieces = 10.0, [Piece(0.0, 37.0, 0.0, 0.0)]
        self._zero_follows_switch = True

    def angle_at(self, time_s: float) -> float:
        """The true angle at a time of `time.monotonic`."""
        return self._state(time_s)[0]

    def answer(self, command: str) -> str | None:
        """Carry out a command, or answer a question."""
        self.heard.append(command)
        if command == "\x05":
            return f"{int(self._state(time.monotonic())[1] != 0):x}"
        if command == "\x07":
            return "\xb0" if time.monotonic() < self._busy_until else "\xb1"
        if command == "\x18":
            self._order("STP", [])
            return None
        name, *arguments = command.split()
        if name.endswith("?"):
            return self._question(name, arguments)
        self._order(name, arguments)
        return None

    def _question(self, name: str, arguments: list[str]) -> str | None:
        now = time.monotonic()
        if self.faults.stalls:
            self._rest(now)
            self.servo, self.error, self.faults.stalls = False, -1024, False
        if name == "ERR?":
            code, self.error = self.error, 0
            return str(code)
        known: dict[str, object] = {
            "CSV?": "2.0", "*IDN?": IDENTITY, "SAI?": "1", "CST?": "1=M-060.DG", "FRF?": f"1={self.is_referenced:d}",
            "SVO?": f"1={self.servo:d}", "TMX?": f"1={self._range:.4f}", "TMN?": f"1={-self._range:.4f}",
            "VEL?": f"1={self._velocity:.4f}", "POS?": f"1={self._state(now)[0]:.4f}",
        }  # fmt: skip
        if name not in known:
            self.error = 2
            return None
        if arguments not in ([], ["1"]):
            self.error = 15
            return None
        return str(known[name])

    def _order(self, name: str, arguments: list[str]) -> None:
        now = time.monotonic()
        if name in self.faults.refuses:
            self.error = self.faults.refuses[name]
        elif name in ("HLT", "STP"):
            self._rest(now, ACCELERATION_DEG_S2 if name == "HLT" else math.inf)
            self.error = 10
        elif name == "SVO":
            self.servo = arguments == ["1", "1"]
        elif name == "RON":
            self._zero_follows_switch = arguments == ["1", "1"]
        elif name == "POS" and not self._zero_follows_switch:
            self.is_referenced = True
            self._go_on_with(Piece(now, float(arguments[1]), 0.0, 0.0))
        elif name == "FRF":
            self._busy_until, self.is_referenced = now + self._reference_s, True
            self._go_on_with(Piece(now, 0.0, 0.0, 0.0))
        elif name == "VEL":
            self._velocity = float(arguments[1])
        elif name == "MOV":
            self._move(now, float(arguments[1]))
        else:
            self.error = 2

    def _move(self, now: float, target_deg: float) -> None:
        if not (self.servo and self.is_referenced):
            self.error = 5
        elif abs(target_deg) > self._range:
            self.error = 7
        else:
            here, speed = self._state(now)
            wanted = math.copysign(self._velocity, target_deg - here)
            speeding = Piece(now, here, speed, math.copysign(ACCELERATION_DEG_S2, wanted - speed))
            at_speed = now + abs(wanted - speed) / ACCELERATION_DEG_S2
            even = Piece(at_speed, speeding.at(at_speed)[0], wanted, 0.0)
            braking_s = abs(wanted) / ACCELERATION_DEG_S2
            brake_from = target_deg - wanted * braking_s / 2
            brake_at = at_speed + (brake_from - even.angle_deg) / wanted
            braking = Piece(brake_at, brake_from, wanted, -math.copysign(ACCELERATION_DEG_S2, wanted))
            self._go_on_with(speeding, even, braking, Piece(brake_at + braking_s, target_deg, 0.0, 0.0))

    def _rest(self, now: float, deceleration: float = math.inf) -> None:
        here, speed = self._state(now)
        if math.isinf(deceleration) or speed == 0:
            self._go_on_with(Piece(now, here, 0.0, 0.0))
            return
        slowing = Piece(now, here, speed, -math.copysign(deceleration, speed))
        rest_at = now + abs(speed) / deceleration
        self._go_on_with(slowing, Piece(rest_at, slowing.at(rest_at)[0], 0.0, 0.0))

    def _go_on_with(self, *pieces: Piece) -> None:
        """Replace what was to come; what has been stays, so that the past can be asked for."""
        self._pieces = [piece for piece in self._pieces if piece.start_s < pieces[0].start_s] + list(pieces)

    def _state(self, time_s: float) -> tuple[float, float]:
        return [piece for piece in self._pieces if piece.start_s <= time_s or piece is self._pieces[0]][-1].at(time_s)


class _Wire:
    """Cuts what comes into commands, and answers them."""

    def __init__(self, controller: Controller, read: Callable[[], bytes], write: Callable[[bytes], object]) -> None:
        self._controller, self._read, self._write = controller, read, write

    def serve(self) -> None:
        """Until the other side has gone."""
        pending = ""
        while content := self._read():
            for character in content.decode("cp1252"):
                pending += character
                if character == "\n" or (len(pending) == 1 and pending in "\x05\x07\x18"):
                    self._one(pending.strip("\r\n "))
                    pending = ""

    def _one(self, command: str) -> None:
        faults = self._controller.faults
        if not command or faults.is_silent:
            return
        delay = faults.delay_s() if "?" in command else 0.0
        time.sleep(delay * (1 - faults.answer_share))
        answer = self._controller.answer(command)
        time.sleep(delay * faults.answer_share)
        if answer is not None:
            self._write(("1=what\n" if faults.garbles else f"{answer}\n").encode("cp1252"))


class TcpServer:
    """A controller on a port of this machine; `drop` cuts all connections."""

    def __init__(self, controller: Controller, port: int = 0) -> None:
        self._controller = controller
        self._listener = socket.create_server(("127.0.0.1", port))
        self._connections: list[socket.socket] = []
        self.address = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def drop(self) -> None:
        """Cut the connections."""
        for connection in self._connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Cut the connections, and take no more."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.drop()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections.append(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            _Wire(self._controller, lambda: connection.recv(1024), connection.sendall).serve()


@contextlib.contextmanager
def served_over_tcp(controller: Controller) -> Iterator[str]:
    """Serve a controller; hands out its address."""
    server = TcpServer(controller)
    try:
        yield server.address
    finally:
        server.close()


@contextlib.contextmanager
def served_over_pty(controller: Controller) -> Iterator[str]:
    """Serve a controller as a serial port; hands out its address."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    ending = threading.Event()

    def read() -> bytes:
        while not ending.is_set():
            if select.select([ours], [], [], 0.05)[0]:
                return os.read(ours, 1024)
        return b""

    thread = threading.Thread(target=_Wire(controller, read, lambda content: os.write(ours, content)).serve)
    thread.start()
    try:
        yield f"serial://{os.ttyname(theirs)}?baud=115200"
    finally:
        ending.set()
        thread.join()
        os.close(ours)
        os.close(theirs)
