"""What a running print publishes, as messages for the page."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.messages import CameraImage, Snapshot, SurfaceSnapshot
from vialight.web.encoding import images_of, pack, pack_surface, to_levels
from vialight.web.reference import ViewGrid

WIDEST = 640
"""Columns of a picture of camera or projector as it is shown; more are averaged."""


class LivePictures:
    """Packs what is published; every method may be called from any thread."""

    def __init__(self) -> None:
        self._white = 1.0

    def snapshot(self, snapshot: Snapshot) -> bytes:
        """Return a live snapshot as a message."""
        names = (
            "frames", "time_s", "angle_deg", "latency_s", "frame_rate_hz", "voxel_mm", "centre_z_mm",
            "cured_volume_mm3", "provisional_share",
        )  # fmt: skip
        header = {name: getattr(snapshot, name) for name in names}
        images = images_of("density", snapshot.density) | images_of("cured", snapshot.cured)
        return pack({"kind": "snapshot", **header}, images)

    def planes(self, surface: SurfaceSnapshot) -> bytes:
        """Return the slices and gel times that came with a live surface."""
        images = images_of("slice", surface.slices) | images_of("gel", surface.gel_time_s)
        return pack({"kind": "planes", "frames": surface.frames, "time_s": surface.time_s}, images)

    def live_surface(self, surface: SurfaceSnapshot) -> bytes:
        """Return a live surface as a message."""
        names = ("frames", "time_s", "lit_s", "rmse_mm", "reverse_rmse_mm", "iou", "cured_volume_mm3")
        header: dict[str, Any] = {"kind": "surface", **{name: getattr(surface, name) for name in names}}
        if surface.forecast is not None:
            header["forecast"] = vars(surface.forecast)
        return pack_surface(header, surface.vertices_mm, surface.faces, surface.deviation_mm)

    def camera(self, image: CameraImage) -> bytes:
        """Return the camera's picture, averaged to what is shown, on a scale that only grows."""
        step = -(-image.counts.shape[1] // WIDEST)
        small = _block_mean(image.counts, step)
        self._white = max(self._white, float(np.quantile(small[::2, ::2], 0.999)))
        header = {
            "kind": "camera", "frame": image.frame, "time_s": image.time_s, "angle_deg": image.angle_deg, "step": step,
            "rows": image.counts.shape[0], "columns": image.counts.shape[1],
        }  # fmt: skip
        return pack(header, {"counts": to_levels(small, 0.0, self._white)})


def grid_of(snapshot: Snapshot) -> ViewGrid:
    """Return where the pixels of a snapshot lie."""
    (z, x), y = snapshot.density.xz.shape, snapshot.density.xy.shape[0]
    return ViewGrid((z, y, x), snapshot.voxel_mm, snapshot.centre_z_mm)


def _block_mean(counts: NDArray[Any], step: int) -> NDArray[np.float32]:
    if step == 1:
        return counts.astype(np.float32)
    rows, columns = (size // step for size in counts.shape)
    blocks = counts[: rows * step, : columns * step].reshape(rows, step, columns, step)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))
