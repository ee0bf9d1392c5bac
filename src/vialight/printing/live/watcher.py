"""The live measurement as one thing: its processes, whether they are well, and what they forecast."""

from __future__ import annotations

import contextlib
import multiprocessing
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Literal, TypeVar

import numpy as np

from vialight.core.errors import InputError
from vialight.core.messages import StopForecast
from vialight.devices.panel import LightPanel
from vialight.printing.live.analysing import analyse
from vialight.printing.live.analysis import grid_of, region_of
from vialight.printing.live.following import LiveSettings, follow
from vialight.printing.live.talking import DONE, FAULT, FINISH, READY
from vialight.system import deaf_to_interrupts, state_of
from vialight.system.mailboxes import Mailbox
from vialight.tomography.reconstruct import grid_of_view
from vialight.tomography.sliding.window import beam_of

Name = Literal["follower", "analyst"]
_T = TypeVar("_T")
_Work = Callable[[LiveSettings, Any], None]

_FINISH_TIMEOUT_S = 60.0
_LOOK_S = 0.1
_END_TIMEOUT_S = 2.0
_HUNG_S: dict[Name, float] = {"follower": 3.0, "analyst": 30.0}
"""Without a sign of life after which it is taken for hung: a frame takes a tenth of a second, a surface a few."""

_FLOAT_BYTES, _HALF_BYTES = 4, 2
_SURFACE_BYTES = 42
"""Of a PLY, for each voxel that the surface passes: one vertex with its deviation, two triangles."""


class LiveWatcher:
    """Follows a recording in two processes: one renews the volume, one measures it.

    The thread that prints starts and ends it; any thread may ask how it is.

    Parameters
    ----------
    settings
        What to follow.

    Attributes
    ----------
    processes : dict
        Name to process.
    """

    def __init__(self, settings: LiveSettings) -> None:
        self._settings = settings
        self.processes: dict[Name, Any] = {}
        self._orders: dict[Name, Connection[Any, Any]] = {}
        self._ready: set[str] = set()
        self._faults: dict[str, str] = {}
        self._has_started = False
        self._lock = threading.Lock()
        """Of what was started and who is ready: a message that two threads wait for would leave one of them waiting."""
        self._boxes: dict[str, Mailbox[Any]] = {}

    def room_for(self, image_shape: tuple[int, int], turns: float) -> int:
        """Return the bytes that what it keeps of a print may take at most: volumes, surfaces, history.

        Parameters
        ----------
        image_shape
            Of the frames.
        turns
            Of the stage.
        """
        settings = self._settings
        if settings.every_deg is None:
            return 0
        camera, optics = settings.rig.need_camera(), settings.rig.imaging_optics()
        beam = beam_of(camera, optics, image_shape, settings.frames_per_turn)
        grid = grid_of_view(image_shape[0], camera, optics, beam, settings.voxel_mm)
        part = grid_of(grid, region_of(grid, settings.reference))
        area_mm2 = 0.0 if settings.reference is None else float(settings.reference.face_areas_mm2.sum())
        kept = _FLOAT_BYTES * np.prod(part.shape) + _SURFACE_BYTES * area_mm2 / grid.voxel_mm**2
        moment = sum(2 * _planes(shape) for shape in (grid.shape, part.shape)) * _HALF_BYTES
        turn_s = 360 / settings.rig.stage.speed_deg_s
        return int(kept * (turns * 360 / settings.every_deg + 1) + moment * turns * turn_s)

    def start(self) -> None:
        """Begin to follow; what had been started before is ended first, and the recording is read again."""
        self._has_started = True
        self._end()
        self._panel = LightPanel.of(self._settings.mailboxes)
        (self._settings.mailboxes / "volume").unlink(missing_ok=True)
        context = multiprocessing.get_context("spawn")
        processes: dict[Name, Any] = {}
        orders: dict[Name, Connection[Any, Any]] = {}
        works: dict[Name, Callable[[LiveSettings, Connection[Any, Any]], None]] = {
            "follower": follow,
            "analyst": analyse,
        }
        for name, work in works.items():
            orders[name], theirs = context.Pipe()
            processes[name] = context.Process(target=work, args=(self._settings, theirs), name=name, daemon=True)
            with deaf_to_interrupts():
                processes[name].start()
            theirs.close()
        with self._lock:
            self.processes, self._orders = processes, orders

    def is_ready(self) -> bool:
        """Whether both processes follow."""
        with self._lock:
            for name, orders in self._orders.items():
                with contextlib.suppress(EOFError, OSError):
                    if name in self._ready or not orders.poll():
                        continue
                    told = orders.recv_bytes()
                    if told == READY:
                        self._ready.add(name)
                    elif told.startswith(FAULT):
                        self._faults[name] = told.removeprefix(FAULT).decode()
            return len(self._ready) == len(self._orders) > 0

    def has_ended(self) -> bool:
        """Whether a process has ended by itself, or hangs: it does not come back in either case."""
        return any(self._is_lost(name) is not None for name in self.processes)

    def fault(self) -> str | None:
        """Say which process has ended, or that they are not ready yet."""
        if not self._has_started:
            return None
        is_ready = self.is_ready()
        for name in self.processes:
            if (lost := self._is_lost(name)) is not None:
                return f"the {name} {lost}"
        return None if is_ready else "catching up"

    def _is_lost(self, name: Name) -> str | None:
        """Say why a process is taken for dead; None while it is well."""
        process = self.processes.get(name)
        if process is None:
            return None
        if not process.is_alive():
            return self._faults.get(name) or f"has ended (exit code {process.exitcode})"
        if state_of(process.pid) == "stopped":
            return "was stopped"
        silent_s = self._panel.age_s(name)
        if name in self._ready and _HUNG_S[name] < silent_s < float("inf"):
            return f"has given no sign of life for {silent_s:.0f} s"
        return None

    def forecast(self) -> StopForecast | None:
        """Return when the light should go off, as far as known."""
        return self._newest("forecast", StopForecast)

    def close(self) -> None:
        """Let both processes finish with what is recorded, and end them."""
        for name in _HUNG_S:
            self._finish(name)
        self._end()

    def _finish(self, name: Name) -> None:
        orders, process = self._orders.get(name), self.processes.get(name)
        if orders is None or process is None or self._is_lost(name) is not None:
            return
        deadline = time.monotonic() + _FINISH_TIMEOUT_S
        with contextlib.suppress(EOFError, OSError):
            orders.send_bytes(FINISH)
            while self._is_lost(name) is None and time.monotonic() < deadline:
                if orders.poll(_LOOK_S) and orders.recv_bytes() == DONE:
                    process.join(_END_TIMEOUT_S)
                    return

    def _end(self) -> None:
        with self._lock:
            processes, orders = self.processes, self._orders
            self.processes, self._orders, self._boxes, self._ready, self._faults = {}, {}, {}, set(), {}
        for process in processes.values():
            if process.is_alive():
                process.kill()
                process.join(_END_TIMEOUT_S)
        for connection in orders.values():
            connection.close()

    def _newest(self, name: str, kind: type[_T]) -> _T | None:
        boxes = self._boxes  # the thread that prints may put others in their place meanwhile
        try:
            box = boxes.get(name)
            if box is None or box.is_replaced:
                box = boxes[name] = Mailbox(self._settings.mailboxes / name, kind)
            found: tuple[int, _T] | None = box.newest()
        except InputError:
            return None
        return None if found is None else found[1]


def _planes(shape: tuple[int, int, int]) -> int:
    """Return the pixels of a moment's three images."""
    z, y, x = shape
    return y * x + z * x + z * y
