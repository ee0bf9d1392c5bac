"""A camera made of traced rays, to hold the closed forms against.

It knows Snell's law in vector form, straight lines and cylinders, and steps through a density; no formula is shared
with ``vialight.refraction``, and of vialight it uses the names of the rig's quantities only.  Frames of reference are
those of ``docs/theory.md``: the pupil at ``(0, -D, 0)`` looks along +y, a stage angle theta turns the object
counter-clockwise seen from above.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from vialight.arrays import FloatArray
from vialight.config import Camera, Optics

CURED = 200.0
"""Counts per mm of a cured interior, as in the shared cases."""

EDGE_MM = 0.2
"""Width of the soft edge of a part, as in the shared cases."""

READ_NOISE = 3.0
"""Standard deviation of a pixel's read-out, counts."""

Field = Callable[[Any, Any, Any], Any]
"""A scalar of (x, y, z) in the object frame, mm; arrays in, arrays of the same shape and type out."""


class Rays(NamedTuple):
    """Straight rays inside the resin, camera frame; NaN where a ray does not get there."""

    origin_mm: FloatArray
    """(..., xyz) where the ray enters the resin."""
    direction: FloatArray
    """(..., xyz) unit vectors."""


def trace(x_c_mm: ArrayLike, z_c_mm: ArrayLike, optics: Optics) -> Rays:
    """Trace the rays of pixels from the pupil through air and glass into the resin."""
    x_c, z_c = np.broadcast_arrays(np.asarray(x_c_mm, dtype=np.float64), np.asarray(z_c_mm, dtype=np.float64))
    pixel = np.stack([x_c, np.zeros_like(x_c), z_c], axis=-1)
    if np.isinf(optics.distance_mm):
        direction = np.broadcast_to([0.0, 1.0, 0.0], pixel.shape)
    else:
        direction = pixel - [0.0, -optics.distance_mm, 0.0]
        direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    surfaces = (
        (optics.outer_radius_mm, 1.0, optics.wall_index),
        (optics.inner_radius_mm, optics.wall_index, optics.resin_index),
    )
    point = pixel
    for radius, index_before, index_after in surfaces:
        point = _front_of_cylinder(point, direction, radius)
        direction = _refract(direction, point * [1 / radius, 1 / radius, 0], index_before / index_after)
    return Rays(point, direction)


def _front_of_cylinder(point: FloatArray, direction: FloatArray, radius: float) -> FloatArray:
    """Move points along their rays to the side of a cylinder about z that faces the camera."""
    steepness = _dot(direction[..., :2], direction[..., :2])
    to_middle = -_dot(point[..., :2], direction[..., :2]) / steepness
    middle = point + to_middle[..., None] * direction
    with np.errstate(invalid="ignore"):
        half_chord = np.sqrt((radius**2 - _dot(middle[..., :2], middle[..., :2])) / steepness)
    return np.asarray(middle - half_chord[..., None] * direction)


def _refract(direction: FloatArray, outward: FloatArray, index_ratio: float) -> FloatArray:
    """Snell's law in vector form, for rays that come from outside; NaN where reflection is total."""
    cosine = -_dot(direction, outward)
    with np.errstate(invalid="ignore"):
        cosine_after = np.sqrt(1 - index_ratio**2 * (1 - cosine**2))
    return np.asarray(index_ratio * direction + (index_ratio * cosine - cosine_after)[..., None] * outward)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a * b).sum(axis=-1))


def soft(signed_distance: Field) -> Field:
    """Return the density of a cured part: half of `CURED` where the signed distance is 0, soft over `EDGE_MM`."""

    def density(x: Any, y: Any, z: Any) -> Any:
        return CURED * expit(-4 / EDGE_MM * signed_distance(x, y, z))

    return density


@dataclass(frozen=True)
class RaytracedCamera:
    """A camera that looks at a vial.

    Parameters
    ----------
    optics
        Vial, resin and distance.
    camera
        Pixel and axis.
    rows, columns
        Size of the image.
    """

    optics: Optics
    camera: Camera
    rows: int
    columns: int

    def frames(
        self, density: Field, angles_rad: FloatArray, *, reach_mm: float, step_mm: float = 0.1, symmetry: int = 1
    ) -> FloatArray:
        """Integrate a density along every pixel's ray, without noise.

        Parameters
        ----------
        density
            Counts per mm, of object coordinates.
        angles_rad
            (frame,) stage angles.
        reach_mm
            Radius about the axis beyond which the density is nil.
        step_mm
            At most this far apart, in plan view, are the density's samples; half of a soft edge is fine enough, for
            the trapezoidal rule converges exponentially where density ends softly.
        symmetry
            The density looks the same after this part of a turn: with angles of equal steps over one turn, only the
            first `1 / symmetry` of the frames are rendered, and repeated.

        Returns
        -------
        numpy.ndarray
            (frame, row, column) counts.
        """
        x_c = (np.arange(self.columns) - self.camera.axis_column) * self.camera.pixel_mm
        z_c = (self.camera.optical_row - np.arange(self.rows)) * self.camera.pixel_mm
        rays = trace(x_c, z_c[:, None], self.optics)
        plan = np.hypot(rays.direction[..., 0], rays.direction[..., 1])
        to_middle = -_dot(rays.origin_mm[..., :2], rays.direction[..., :2]) / plan**2
        middle = rays.origin_mm + to_middle[..., None] * rays.direction
        miss = np.hypot(middle[..., 0], middle[..., 1])
        hits = miss < reach_mm  # NaN does not
        half_chord = np.sqrt(reach_mm**2 - miss[hits] ** 2) / plan[hits]
        count = int(np.ceil(2 * reach_mm / step_mm))
        share = (2 * np.arange(count) + 1) / count - 1
        # Single precision places samples to 1 nm and halves the time.
        points = middle[hits][:, None] + (half_chord[:, None] * share)[..., None] * rays.direction[hits][:, None]
        x, y, z = np.moveaxis(points, -1, 0).astype(np.float32)

        def render(angle: float) -> FloatArray:
            c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
            image = np.zeros((self.rows, self.columns))
            image[hits] = density(c * x + s * y, c * y - s * x, z).mean(axis=1) * 2 * half_chord
            return image

        with ThreadPoolExecutor(2) as pool:
            rendered = list(pool.map(render, angles_rad[: len(angles_rad) // symmetry]))
        return np.concatenate([np.stack(rendered)] * symmetry)


def photograph(
    expected: FloatArray, rng: np.random.Generator, *, offset: float | FloatArray = 0.0
) -> NDArray[np.uint16]:
    """Count photons and read them out: Poisson noise, `READ_NOISE`, an offset for each pixel, whole numbers."""
    counts = rng.poisson(expected) + rng.normal(offset, READ_NOISE, expected.shape)
    return np.clip(np.rint(counts), 0, np.iinfo(np.uint16).max).astype(np.uint16)
