"""From projections in the resin to grey levels of a real projector."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from vialight.core.arrays import TURN_RAD, Float32Array, FloatArray, Grid
from vialight.core.compiling import FAST_MATH
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.plan import Patterns
from vialight.optics.viewing import PixelRays, pixel_rays, pixels_in_reach
from vialight.planning.projections.forward import Light

LEVELS = 255


def make_patterns(
    projections: Float32Array, light: Light, grid: Grid, rig: Rig, *, count: int | None = None
) -> Patterns:
    """Resample projections for the vial and the projector, and round them to grey levels.

    Each pixel, at each stage angle, lights a patch of the resin: it gets the mean of the projection over that patch,
    strips and slices by the share that they have in it, divided by what the way takes: spreading by the vial's lens,
    reflection at the glass, absorption up to the point closest to the axis.  Between angles the projection is
    interpolated by Catmull-Rom's cubics; where they swing below 0 there is no light.  The brightest pixel of all gets
    level 255; nothing else is clipped.

    Parameters
    ----------
    projections
        (psi, s, z) non-negative, of half a turn or a full one.
    light, grid
        Where they lie.
    rig
        With a projector and the resin's writing index.
    count
        Patterns in a turn; by default as many as projections.

    Raises
    ------
    InputError
        The rig lacks what writing needs, or all projections are dark.
    """
    projector = rig.need_projector()
    sinogram = full_turn(projections) if light.geometry.from_both_sides else projections
    count = count or len(sinogram)
    rows, columns, rays = _part_lit(light, grid, rig)
    angles = np.arange(count, dtype=np.float64) * (TURN_RAD / count)
    irradiance = np.zeros((count, rows.stop - rows.start, columns.stop - columns.start), np.float32)
    strips = _Footprints(
        (rays.virtual_x_mm - light.geometry.first_s_mm) / light.geometry.spacing_mm,
        rays.width_mm / light.geometry.spacing_mm,
    )
    slices = _Footprints((rays.mid_height_mm - grid.z_mm[0]) / grid.voxel_mm, rays.height_mm / grid.voxel_mm)
    turned = angles - np.radians(projector.azimuth_deg) - light.geometry.psi_rad[0]
    _read(
        np.ascontiguousarray(sinogram), turned, rays.direction_rad,
        strips.start, strips.stop, slices.start, slices.stop,
        np.where(rays.delivery > 0, 1 / np.maximum(rays.delivery, 1e-9), 0).astype(np.float32), irradiance,
    )  # fmt: skip
    brightest = float(irradiance.max())
    if brightest <= 0:
        raise InputError("projections", "are dark everywhere", accepted="some light", remedy="check part and target")
    irradiance *= np.float32(LEVELS / brightest)
    levels = np.rint(irradiance, out=irradiance).astype(np.uint8)
    return Patterns(levels, angles, rows.start, columns.start, brightest / LEVELS)


def full_turn(projections: Float32Array) -> Float32Array:
    """Return projections (psi, s, z) of a full turn from those of a half, ``p(psi + pi, s) = p(psi, -s)``."""
    return np.concatenate([projections, projections[:, ::-1]])


class _Footprints(NamedTuple):
    """Where pixels' patches lie along one axis of the projections, which count by index from the edge of the first."""

    middle: FloatArray
    """In indices, whose wholes are the centres of samples."""
    width: FloatArray

    @property
    def start(self) -> FloatArray:
        return self.middle - self.width / 2 + 0.5

    @property
    def stop(self) -> FloatArray:
        return self.middle + self.width / 2 + 0.5


def _part_lit(light: Light, grid: Grid, rig: Rig) -> tuple[slice, slice, PixelRays]:
    """Return rows and columns of the image whose rays meet the projections, with their rays."""
    projector, optics = rig.need_projector(), rig.writing_optics()
    camera, size = projector.as_camera(), (projector.columns, projector.rows)
    reach = -light.geometry.first_s_mm + light.geometry.spacing_mm / 2
    ends = grid.z_mm[0] - grid.voxel_mm / 2, grid.z_mm[-1] + grid.voxel_mm / 2
    near = pixels_in_reach(*size, camera, optics, reach + camera.pixel_mm, ends[0] - camera.pixel_mm,
                           ends[1] + camera.pixel_mm)  # fmt: skip
    first = near[0].start, near[1].start
    rays = pixel_rays(
        near[1].stop - first[1], near[0].stop - first[0], camera, optics, rig.resin.absorption_per_mm or 0.0,
        first=first,
    )  # fmt: skip
    lit = (
        (np.abs(rays.virtual_x_mm) < reach + rays.width_mm / 2)
        & (rays.mid_height_mm > ends[0] - rays.height_mm / 2)
        & (rays.mid_height_mm < ends[1] + rays.height_mm / 2)
    )
    if not lit.any():
        raise InputError("[projector]", "none of its pixels reaches the part", accepted="a projector that sees it")
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    part = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    return (
        slice(first[0] + part[0].start, first[0] + part[0].stop),
        slice(first[1] + part[1].start, first[1] + part[1].stop),
        PixelRays(*(values[part] for values in rays)),
    )


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _read(
    sinogram: Float32Array,
    theta: FloatArray,
    direction: FloatArray,
    first_strip: FloatArray,
    last_strip: FloatArray,
    first_slice: FloatArray,
    last_slice: FloatArray,
    gain: Float32Array,
    out: Float32Array,
) -> None:
    """Average (psi, s, z) over the patch of every pixel at every stage angle; outside it is dark."""
    angles, samples, depth = sinogram.shape
    for k in prange(len(theta)):
        for r in range(out.shape[1]):
            for c in range(out.shape[2]):
                if gain[r, c] == 0:
                    continue
                turn = ((theta[k] + direction[r, c]) / TURN_RAD % 1.0) * angles
                a = int(turn)
                w = turn - a
                w0, w3 = np.float32(-0.5 * w * (1 - w) ** 2), np.float32(-0.5 * w**2 * (1 - w))
                w1, w2 = np.float32(1 - w**2 * (2.5 - 1.5 * w)), np.float32(1 - (1 - w) ** 2 * (1 + 1.5 * w))
                before, here = sinogram[(a - 1) % angles], sinogram[a % angles]
                after, beyond = sinogram[(a + 1) % angles], sinogram[(a + 2) % angles]
                s0, s1, z0, z1 = first_strip[r, c], last_strip[r, c], first_slice[r, c], last_slice[r, c]
                total = np.float32(0)
                for i in range(max(int(np.floor(s0)), 0), min(int(np.ceil(s1)), samples)):
                    wide = min(s1, i + 1.0) - max(s0, i)
                    for z in range(max(int(np.floor(z0)), 0), min(int(np.ceil(z1)), depth)):
                        share = np.float32(wide * (min(z1, z + 1.0) - max(z0, z)))
                        total += share * (w0 * before[i, z] + w1 * here[i, z] + w2 * after[i, z] + w3 * beyond[i, z])
                if total > 0:
                    out[k, r, c] = gain[r, c] * total / np.float32((s1 - s0) * (z1 - z0))
