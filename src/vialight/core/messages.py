"""What a live print is known to be at one moment: immutable, to be shown, stored and decided upon.

The process that computes makes them; the operator's page, the recording of history and the decision read them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array


@dataclass(frozen=True)
class Sums:
    """Sums of a volume along each axis, times the voxel: projections as seen along z, y and x.

    Row 0 is the lowest coordinate of the first axis.
    """

    xy: Float32Array
    """(y, x): along z, seen from above."""
    xz: Float32Array
    """(z, x): along y."""
    yz: Float32Array
    """(z, y): along x."""


@dataclass(frozen=True)
class Snapshot:
    """The print after one frame."""

    frames: int
    """Frames used; the newest is number `frames - 1` of the recording."""
    time_s: float
    """Of the newest frame used, on the print's clock."""
    angle_deg: float
    """Of the stage at that frame."""
    latency_s: float
    """From that frame's arrival to this snapshot."""
    frame_rate_hz: float
    """Of the last seconds."""
    voxel_mm: float
    centre_z_mm: float
    density: Sums
    """Counts, as sums of counts per mm along mm."""
    cured: Sums
    """Mm of path above the gelation threshold."""
    cured_volume_mm3: float
    provisional_share: float
    """Share of the rays in use that are older than the newest turn, or were never seen."""


@dataclass(frozen=True)
class StopForecast:
    """When the light should go off, as lit time, and how sure that is."""

    stop_s: float
    sigma_s: float
    why: str


@dataclass(frozen=True)
class SurfaceSnapshot:
    """The surface about once a second, measured against the reference."""

    frames: int
    time_s: float
    lit_s: float
    """For how long light had been on."""
    vertices_mm: Float32Array
    """(vertex, xyz)."""
    faces: NDArray[np.int32]
    """(face, corner)."""
    deviation_mm: Float32Array
    """(vertex,) signed distance to the reference, negative inside; empty without a reference."""
    rmse_mm: float | None
    """Of the print's surface to the reference, weighted by area; None without a surface or a reference."""
    reverse_rmse_mm: float | None
    """Of the reference to the print's surface: sees what is missing."""
    iou: float | None
    cured_volume_mm3: float
    slices: Sums
    """Density in the middle planes z = centre, y = 0 and x = 0, counts per mm."""
    gel_time_s: Sums
    """Mean gel time, as lit time, of what has gelled along each axis; NaN where nothing has."""
    forecast: StopForecast | None = None


@dataclass(frozen=True)
class CameraImage:
    """The newest frame that is safely recorded."""

    frame: int
    """Its number in the recording."""
    counts: NDArray[np.uint16]
    """(row, column)."""
    time_s: float
    angle_deg: float
    arrivals_monotonic_s: tuple[float, ...] = (0.0,)
    """When it came from the camera, by `time.monotonic`, and before that when those before it did."""

    @property
    def arrived_monotonic_s(self) -> float:
        """When it came from the camera, by `time.monotonic`."""
        return self.arrivals_monotonic_s[-1]

    def arrival_of(self, frame: int) -> float:
        """Return when a frame came that is not newer; NaN where it is too old to be known.

        Examples
        --------
        >>> image = CameraImage(7, np.zeros((1, 1), np.uint16), 0.7, 14.0, (10.5, 10.6, 10.7))
        >>> image.arrival_of(6), image.arrival_of(4)
        (10.6, nan)
        """
        back = self.frame - frame
        return self.arrivals_monotonic_s[-1 - back] if 0 <= back < len(self.arrivals_monotonic_s) else float("nan")


@dataclass(frozen=True)
class PrintStatus:
    """How the print itself is doing."""

    state: str
    """preflight, background, printing, dark (held by a fault), after (imaging on), finishing, done or failed."""
    message: str
    """The last thing that happened, for a person."""
    time_s: float
    """On the print's clock."""
    lit_s: float
    """For how long light has been on."""
    turn: float
    """Turns since the print began."""
    remaining_s: float | None
    """Until the light is to go off, as far as known."""
    mode: str
    """auto, manual or turns."""
    frames: int
    missed: int
    """Frames that should have come and did not."""
    disk_free_bytes: int
    disk_left_s: float
    """For how long the disk lasts."""
    pattern: int | None
    """Index of the pattern that is shown; None where it is black."""
    devices: dict[str, str] = field(default_factory=dict)
    """Name to "ok", or to what is wrong."""
    doubts: tuple[str, ...] = ()
    """What makes the calibration doubtful."""
