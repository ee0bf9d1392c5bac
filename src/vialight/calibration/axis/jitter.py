"""By how much the angles of single frames are off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.calibration.opposite_sums import add_up_angles
from vialight.calibration.opposite_views import ViewComparison
from vialight.core.arrays import FloatArray

_WEAKEST = 1e-3
"""Of the best determined combination of angles: weaker ones, such as a turn of all frames, say nothing."""

SMOOTH_FRAMES = 6
"""Waves longer than this are not taken for jitter."""


@dataclass(frozen=True)
class Jitter:
    """Errors of the frames' angles.

    Parameters
    ----------
    std_rad, uncertainty_rad
        Standard deviation from frame to frame, and its standard uncertainty.
    errors_rad
        (frame,) most likely error of each frame's angle: it was taken so much farther on than its file says.
    """

    std_rad: float
    uncertainty_rad: float
    errors_rad: FloatArray


def find_jitter(compared: ViewComparison, angles_rad: FloatArray) -> Jitter:
    """Estimate how far single frames are off in angle, from how they differ from their opposite views.

    Only what changes from frame to frame is asked for: what is smooth over `SMOOTH_FRAMES` may as well be the model's.

    A combination of angles that the frames determine with variance v is normally distributed with ``s^2 + v``; the
    likeliest s is taken, and each combination shrunk by ``s^2 / (s^2 + v)``.

    Parameters
    ----------
    compared
        Frames and their opposites, with the right axis.
    angles_rad
        (frame,) ascending.
    """
    frames, depth = len(angles_rad), compared.gamma_rad.shape[1]
    normal, gradient = np.zeros((frames, frames)), np.zeros((depth, frames))
    add_up_angles(
        compared.differences, compared.by_angle, compared.weights, compared.gamma_rad, angles_rad, normal, gradient
    )
    rough = _rough(frames)
    strength, modes = np.linalg.eigh(rough.T @ normal @ rough)
    modes = rough @ modes
    known = strength > _WEAKEST * strength[-1]
    strength, modes = strength[known], modes[:, known]
    by_row = gradient @ modes / strength
    found = by_row.sum(axis=0)
    # Rows see the same angles through noise of their own; neighbours share some of it, so that they count in pairs.
    pairs = np.add.reduceat(by_row - found / depth, np.arange(0, depth, 2), axis=0)
    scatter = (pairs**2).sum(axis=0) * len(pairs) / max(len(pairs) - 1, 1)
    # From few rows each combination's own scatter is a poor estimate; noise is alike in all of them.
    variance = (scatter * strength).mean() / strength
    tried = np.concatenate([[0.0], np.geomspace(1e-5, 0.1, 400)])
    spread = tried[:, None] ** 2 + variance
    likelihood = -0.5 * (np.log(spread) + found**2 / spread).sum(axis=1)
    best = int(likelihood.argmax())
    std = float(tried[best])
    within = tried[likelihood > likelihood[best] - 0.5]
    return Jitter(std, float(np.ptp(within) / 2), modes @ (found * std**2 / (std**2 + variance)))


def _rough(frames: int) -> FloatArray:
    """Return an orthonormal basis (frame, k) of what changes within `SMOOTH_FRAMES`."""
    wave = np.arange(1, frames // SMOOTH_FRAMES + 1)
    phase = 2 * np.pi / frames * np.arange(frames)[:, None] * wave
    smooth = np.column_stack([np.ones(frames), np.cos(phase), np.sin(phase)])
    return np.asarray(np.linalg.qr(smooth, mode="complete")[0][:, smooth.shape[1] :])
