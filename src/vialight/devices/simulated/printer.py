"""Opens a simulated printer: starts its processes and hands out its devices."""

from __future__ import annotations

import contextlib
import multiprocessing
import shutil
import time
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from vialight.core.arrays import FloatArray
from vialight.core.codec import decoder_of, encode
from vialight.devices.clocks import SimulatedClock
from vialight.devices.projecting import ProjectorParts, ProjectorProcess
from vialight.devices.protocols import CameraFrame, DeviceError, Devices, DeviceTimeoutError
from vialight.devices.simulated.display import DisplayCover, DisplayWindow, run_display
from vialight.devices.simulated.motion import Segments, SimulatedStage
from vialight.devices.simulated.world import WorldAnswer, WorldOrder, WorldSettings, run_world
from vialight.system import deaf_to_interrupts, shared_folder
from vialight.system.mailboxes import Mailbox

_START_TIMEOUT_S = 120.0
_TRUTH_TIMEOUT_S, _DRAIN_S = 60.0, 0.02
_END_TIMEOUT_S = 3.0


class SimulatedPrinter:
    """A printer, its resin and its camera, all simulated.

    Parameters
    ----------
    settings
        What it is made of.
    pattern_angles_rad
        (angle,) of the plan's patterns.
    refresh_hz
        Of the projector.
    projector_log
        CSV file of what was due and shown.

    Attributes
    ----------
    devices : Devices
        To print with.
    processes : dict
        Name to process, for those who want to kill one.
    told : tuple of str
        What a person should know before the light goes on: nothing.

    Raises
    ------
    DeviceError
        A part of it does not start.
    """

    told: tuple[str, ...] = ()

    def __init__(
        self, settings: WorldSettings, pattern_angles_rad: FloatArray, refresh_hz: float, projector_log: Path
    ) -> None:
        self.folder = shared_folder()
        context = multiprocessing.get_context("spawn")
        motion = Mailbox(self.folder / "motion", Segments, 10_000)
        (self.folder / "flips").touch()
        self._orders, their_orders = context.Pipe()
        self._frames, their_frames = context.Pipe()
        world = context.Process(
            target=run_world, args=(settings, self.folder, their_orders, their_frames), name="world", daemon=True
        )
        ready, their_ready = context.Pipe()
        display = context.Process(target=run_display, args=(self.folder, their_ready), name="display", daemon=True)
        self.processes: dict[str, Any] = {"world": world, "display": display}
        try:
            with deaf_to_interrupts():
                world.start()
            answer = decoder_of(WorldAnswer)(_answer(self._orders, their_orders, "simulated printer"))
            with deaf_to_interrupts():
                display.start()
            _answer(ready, their_ready, "simulated display")
            their_frames.close()
            clock = SimulatedClock(self.folder / "clock")
            parts = ProjectorParts(
                partial(DisplayWindow, self.folder, refresh_hz),
                partial(DisplayCover, self.folder),
                pattern_angles_rad,
                projector_log,
            )
            projector = ProjectorProcess(parts, clock, self.folder)
        except BaseException:
            self._end()
            raise
        self.projector = projector
        camera = _SimulatedCamera(answer.image_shape, settings.full_level, self._frames, self._orders)
        assert world.pid is not None
        self.devices = Devices(clock, camera, SimulatedStage(clock, motion, settings.mishaps, world.pid), projector)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def put_in(self) -> None:
        """Put the part that the settings name into the vial, cured."""
        self._orders.send_bytes(encode(WorldOrder("put in")))

    def write_truth(self, path: Path) -> dict[str, float] | None:
        """Write what has truly gelled as STL and return its volume and the largest dose; None where that fails."""
        with contextlib.suppress(OSError, EOFError):
            self._orders.send_bytes(encode(WorldOrder("truth", path=str(path))))
            deadline = time.monotonic() + _TRUTH_TIMEOUT_S
            while not self._orders.poll(_DRAIN_S):
                while self._frames.poll():  # the world waits for room for a frame that nobody takes any more
                    self._frames.recv_bytes()
                if time.monotonic() > deadline:
                    return None
            answer: WorldAnswer = decoder_of(WorldAnswer)(self._orders.recv_bytes())
            return answer.truth
        return None

    def close(self) -> None:
        """End all of its processes."""
        self.projector.close()
        self._end()

    def _end(self) -> None:
        for process in self.processes.values():
            if process.pid is not None and process.is_alive():
                process.terminate()
                process.join(_END_TIMEOUT_S)
                if process.is_alive():  # it was stopped, or hangs
                    process.kill()
                    process.join(_END_TIMEOUT_S)
        shutil.rmtree(self.folder, ignore_errors=True)


def _answer(connection: Connection[Any, Any], other_end: Connection[Any, Any], who: str) -> bytes:
    """Return the first thing that a new process says; its end is closed here, so that its death is seen."""
    other_end.close()
    try:
        if connection.poll(_START_TIMEOUT_S):
            return connection.recv_bytes()
    except EOFError:
        raise DeviceError(who, "has ended while it started") from None
    raise DeviceError(who, f"has not started within {_START_TIMEOUT_S:g} s")


class _SimulatedCamera:
    """Hands out the frames that the world takes; the connection is its buffer."""

    def __init__(
        self, image_shape: tuple[int, int], full_level: int, frames: Connection[Any, Any], orders: Connection[Any, Any]
    ) -> None:
        self.image_shape, self.full_level = image_shape, full_level
        self._frames, self._orders = frames, orders

    def start(self, frame_rate_hz: float) -> None:
        """Begin to grab."""
        self._orders.send_bytes(encode(WorldOrder("frames", frame_rate_hz)))

    def next_frame(self, timeout_s: float) -> CameraFrame:
        """Return the oldest frame not yet handed over."""
        try:
            if self._frames.poll(timeout_s):
                frame: CameraFrame = decoder_of(CameraFrame)(self._frames.recv_bytes())
                return frame
        except (EOFError, OSError) as error:
            raise DeviceError("camera", "the simulated printer has ended") from error
        raise DeviceTimeoutError("camera", f"no frame within {timeout_s:g} s")

    def close(self) -> None:
        """Let go."""
        self._frames.close()
