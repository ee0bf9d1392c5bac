"""Pictures of flat targets by rays that are traced surface by surface, in air and in the vial."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics
from vialight.twin.rays import trace

IN_VIAL = Optics(12.4, 11.3, 1.472, 1.48, 190.0)
IN_AIR = Optics(60.0, 60.0, 1.0, 1.0, 190.0)
"""A vial of nothing, as wide as all that is seen."""
CAMERA = Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=87.3, optical_row=57.2)
SHAPE = (120, 176)
_A_SIDE = 4
_SOFT = 0.06
"""Of the pitch: width of an edge, so that four rays a side find its place."""


@dataclass(frozen=True)
class Target:
    """A target and how it is held.

    Parameters
    ----------
    kind, pitch_mm
        What it is.
    depth_mm
        Of its plane behind the axis.
    yaw_deg, pitch_deg, roll_deg
        Its lean about z, x and y, in the order y, x, z.
    beside_mm
        Of one of its points from the foot of the axis, to the right and up.
    """

    kind: Literal["dots", "chessboard"]
    pitch_mm: float
    depth_mm: float = 0.0
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    beside_mm: tuple[float, float] = (0.27, -0.36)

    def brightness(self, right_mm: FloatArray, up_mm: FloatArray) -> FloatArray:
        """Return 0 where it is black, 1 where white; white beyond 20 mm x 16 mm and a little less."""
        u, v = ((w - at) / self.pitch_mm for w, at in zip((right_mm, up_mm), self.beside_mm, strict=True))
        half = np.array([10.0, 8.0]) / self.pitch_mm
        if self.kind == "dots":
            white = np.clip((np.hypot(u - np.rint(u), v - np.rint(v)) - 0.27) / _SOFT + 0.5, 0, 1)
            u, v = np.rint(u), np.rint(v)  # whole dots only
        else:
            waves = (np.clip(np.sin(np.pi * w) / np.pi / _SOFT * 2, -1, 1) for w in (u, v))
            white = (1 - np.prod(list(waves), axis=0)) / 2
        return np.where((np.abs(u) < half[0] - 0.3) & (np.abs(v) < half[1] - 0.3), white, 1.0)


def picture(
    target: Target, optics: Optics, *, turned_deg: float = 0.0, camera: Camera = CAMERA, shape: tuple[int, int] = SHAPE,
    distortion: float = 0.0, blur: float = 0.6, noise: float = 8.0, seed: int = 0,
) -> NDArray[np.uint16]:  # fmt: skip
    """Return (row, column) counts of a target that is lit from behind.

    ``distortion`` is how many columns the lens moves outwards what is seen half an image's width from its middle.
    """
    aside = (np.arange(_A_SIDE) + 0.5) / _A_SIDE - 0.5
    column = (np.arange(shape[1])[:, None] + aside).ravel()
    row = (np.arange(shape[0])[:, None] + aside).ravel()[:, None]
    across, down = np.broadcast_arrays(column - (shape[1] - 1) / 2, row - camera.optical_row)
    shrunk = 1 - distortion * (across**2 + down**2) / (shape[1] / 2) ** 3
    x_c = ((shape[1] - 1) / 2 + across * shrunk - camera.axis_column) * camera.pixel_mm
    rays = trace(x_c, -down * shrunk * camera.pixel_mm, optics)
    pose = Rotation.from_euler("yxz", [target.roll_deg, target.pitch_deg, target.yaw_deg + turned_deg], degrees=True)
    lean = Rotation.from_euler("z", turned_deg, degrees=True)
    normal = (pose * Rotation.identity()).apply([0.0, 1.0, 0.0])
    assert np.allclose(lean.inv().apply(normal)[2], normal[2])
    along = (target.depth_mm - rays.origin_mm @ normal) / (rays.direction @ normal)
    met = pose.inv().apply((rays.origin_mm + along[..., None] * rays.direction).reshape(-1, 3)).reshape(*x_c.shape, 3)
    fine = np.where(np.isfinite(met[..., 0]), target.brightness(met[..., 0], met[..., 2]), 0.4)
    clean = fine.reshape(shape[0], _A_SIDE, shape[1], _A_SIDE).mean(axis=(1, 3))
    lit = 300 + 2200 * gaussian_filter(clean, blur) * (1 - 0.2 * np.linspace(-1, 1, shape[1]))
    noisy = lit + np.random.default_rng(seed).normal(0, noise, shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 4095), dtype=np.uint16)
