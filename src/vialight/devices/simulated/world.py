"""The process in which the resin cures: it follows the display and the stage, and takes the camera's frames."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vialight.core.codec import decoder_of, encode
from vialight.core.errors import InputError
from vialight.core.plan import Patterns
from vialight.devices.clocks import SimulatedClock
from vialight.devices.protocols import CameraFrame
from vialight.devices.simulated.display import BLACK, read_flips
from vialight.devices.simulated.mishaps import Mishaps
from vialight.devices.simulated.motion import Segments, angle_at
from vialight.planning.target import voxelise
from vialight.store import read_plan, write_stl
from vialight.store.foreign.meshes import load_mesh
from vialight.system import leave_interrupts_to_the_print
from vialight.system.mailboxes import Mailbox
from vialight.twin import Twin, TwinSettings, find_rig, grid_round, load_resin

NEWS_S = 0.015
"""By the wall clock, after a frame's time: until then news of the light that it saw may arrive."""


@dataclass(frozen=True)
class WorldSettings:
    """What the simulated printer is made of.

    Parameters
    ----------
    plan_path
        For the patterns and the size of the part; None where nothing is printed.
    rig
        The printer as it is: TOML, or the name of a preset.
    resin
        What is in its vial: the name of a preset, or TOML.
    voxel_mm
        Of the resin.
    twin
        How closely to look.
    mishaps
        What is to go wrong.
    rate
        Seconds of the print in a second of the wall clock, where the machine keeps up.
    part_path
        Without a plan: mesh of what is put into the vial, cured, when that is asked for.
    """

    plan_path: Path | None
    rig: str
    resin: str
    voxel_mm: float = 0.2
    twin: TwinSettings = field(default_factory=TwinSettings)
    mishaps: Mishaps = field(default_factory=Mishaps)
    rate: float = 1.0
    part_path: Path | None = None

    @property
    def full_level(self) -> int:
        """Counts at which a (binned) pixel of the camera is saturated."""
        return int(min((2**self.twin.sensor.bits - 1) * self.twin.binning**2, 65535))


class WorldOrder(NamedTuple):
    """What the simulated printer is to do: "frames" at a rate, "put in" the part, or write the "truth" to a file."""

    do: str
    frame_rate_hz: float = 0.0
    path: str = ""


class WorldAnswer(NamedTuple):
    """What it says when it has begun, and of the truth."""

    image_shape: tuple[int, int]
    truth: dict[str, float] | None = None


class _TurnedTwin(Twin):
    """A twin that stands on a stage of its own."""

    segments: Segments = ()

    def true_angle_rad(self, time_s: float | None = None) -> float:
        """Return by how much the object has turned; the faults' ripple comes on top of the stage's motion."""
        turned = angle_at(self.segments, self.time_s if time_s is None else time_s)
        return self.settings.faults.angle(1.0, self.rig.stage.direction * turned)


def run_world(
    settings: WorldSettings, folder: Path, orders: Connection[Any, Any], frames: Connection[Any, Any]
) -> None:
    """Simulate until told to end, or until the process that prints is gone."""
    leave_interrupts_to_the_print()
    with contextlib.suppress(OSError, AttributeError):
        os.nice(5)  # the simulation waits for the print, never the other way round
    resin, rig = load_resin(settings.resin), find_rig(settings.rig)
    plan = None if settings.plan_path is None else read_plan(settings.plan_path)
    part = plan.reference if plan is not None else load_mesh(settings.part_path or "no part")
    optics = resin.in_vial_of(rig).writing_optics()
    reach = np.inf if optics is None else float(optics.field_radius_mm)
    twin = _TurnedTwin(rig, resin, grid_round(part, settings.voxel_mm, reach_mm=reach), settings.twin)
    world = _World(settings, twin, None if plan is None else plan.patterns, folder, frames)
    orders.send_bytes(encode(WorldAnswer(twin.image_shape)))
    parent = multiprocessing.parent_process()
    assert parent is not None
    with contextlib.suppress(EOFError, ConnectionError):  # the process that prints has gone meanwhile
        while not wait([parent.sentinel], timeout=0):
            if orders.poll(0 if world.is_due() else 0.002):
                order = decoder_of(WorldOrder)(orders.recv_bytes())
                if order.do == "frames":
                    world.start_camera(order.frame_rate_hz)
                elif order.do == "put in":
                    twin.harden(voxelise(part, twin.grid, coverage=True))
                elif order.do == "truth":
                    orders.send_bytes(encode(WorldAnswer(twin.image_shape, _write_truth(twin, Path(order.path)))))
                else:
                    return
            world.tick()


def _write_truth(twin: Twin, path: Path) -> dict[str, float] | None:
    try:
        surface = twin.surface()
    except InputError:
        return None  # nothing has gelled
    write_stl(path, surface)
    return {"volume_mm3": surface.volume_mm3, "largest_dose_mj_per_cm2": float(twin.dose_mj_per_cm2.max())}


class _World:
    """Steps the twin from one camera frame to the next, behind the clock."""

    def __init__(
        self,
        settings: WorldSettings,
        twin: _TurnedTwin,
        patterns: Patterns | None,
        folder: Path,
        frames: Connection[Any, Any],
    ) -> None:
        self._twin, self._folder, self._frames, self._mishaps = twin, folder, frames, settings.mishaps
        self._levels = [] if patterns is None else list(patterns.levels)
        self._corner = (0, 0) if patterns is None else (patterns.first_row, patterns.first_column)
        self._motion = Mailbox(folder / "motion", Segments)
        self._rng = np.random.default_rng(settings.mishaps.seed)
        self._flips_seen = 0
        self._period_s = 0.1
        self._is_grabbing = False
        self._number = 0
        self._late: CameraFrame | None = None
        self._next_s = self._period_s
        self._clock = SimulatedClock(folder / "clock", settings.rate)
        self._slack_s = NEWS_S * settings.rate
        self._clock.allow_until(self._next_s + self._slack_s)

    def start_camera(self, frame_rate_hz: float) -> None:
        self._period_s, self._is_grabbing, self._number = 1 / frame_rate_hz, True, 0

    def is_due(self) -> bool:
        """Whether the next frame's time, and that in which news of the light arrive, have passed.

        Time begins when the camera does.
        """
        return self._is_grabbing and self._clock.now_s() >= self._next_s + self._slack_s

    def tick(self) -> None:
        """Bring the world to the next frame's time, where that has come."""
        if not self.is_due():
            return
        # From here on the clock may run to the end of the next frame while this one is computed.
        self._clock.allow_until(self._next_s + self._period_s + self._slack_s)
        self._twin.segments = (self._motion.newest() or (0, ()))[1]
        for at, _, pattern in read_flips(self._folder, self._flips_seen):
            if at > self._next_s:
                break
            self._flips_seen += 1
            self._twin.advance(max(0.0, at - self._twin.time_s))
            self._twin.show(None if pattern == BLACK else self._levels[pattern], self._corner)
        self._twin.advance(self._next_s - self._twin.time_s)
        self._grab()
        self._next_s += self._period_s

    def _grab(self) -> None:
        now, mishaps = self._next_s, self._mishaps
        silent = mishaps.camera_silent_s
        if silent and silent[0] <= now < silent[1]:
            return
        number, self._number = self._number, self._number + 1
        taken = self._twin.frame()
        if taken is None or self._rng.uniform() < mishaps.lost_share:
            return
        jump = mishaps.time_jump_s if now >= mishaps.time_jump_at_s else 0.0
        frame = CameraFrame(taken.counts, taken.time_s + jump, number)
        if self._late is None and self._rng.uniform() < mishaps.swapped_share:
            self._late = frame
            return
        self._send(frame)
        if self._late is not None:
            self._send(self._late)
            self._late = None
        if self._rng.uniform() < mishaps.doubled_share:
            self._send(frame)

    def _send(self, frame: CameraFrame) -> None:
        self._frames.send_bytes(encode(frame))
