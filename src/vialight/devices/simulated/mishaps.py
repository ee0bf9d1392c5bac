"""What goes wrong with simulated devices, on request."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mishaps:
    """Faults of devices in time; all times are on the print's clock, which begins when the camera does.

    Faults of the optics and of the resin are `vialight.twin.Faults`.

    Parameters
    ----------
    camera_silent_s
        From when to when the camera grabs nothing.
    lost_share, doubled_share, swapped_share
        Of the frames, at random: lost (their numbers are left out), handed over twice, or after their successor.
    time_jump_at_s, time_jump_s
        When the camera's timestamps jump, and by how much.
    stage_slow_at_s, stage_slow_share
        When the stage gets slower, and to which share of its speed.
    stage_stops_at_s, stage_goes_on_at_s
        When it stops, and turns again.
    stage_silent_at_s
        When it answers no more.
    seed
        Of all that is random.
    """

    camera_silent_s: tuple[float, float] | None = None
    lost_share: float = 0.0
    doubled_share: float = 0.0
    swapped_share: float = 0.0
    time_jump_at_s: float = float("inf")
    time_jump_s: float = 0.0
    stage_slow_at_s: float = float("inf")
    stage_slow_share: float = 0.8
    stage_stops_at_s: float = float("inf")
    stage_goes_on_at_s: float = float("inf")
    stage_silent_at_s: float = float("inf")
    seed: int = 0
