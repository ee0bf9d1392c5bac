"""What `vialight.control` knows before a print: a plan rehearsed in resins that differ from the believed one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from vialight.control.rehearsal import Rehearser
from vialight.control.stop_model import Doubt, StopModel
from vialight.core.arrays import BoolArray, FloatArray, Grid
from vialight.core.config import Rig
from vialight.core.plan import Patterns, Plan
from vialight.twin import ResinModel, dose_of

SENSITIVITIES = (0.6, 0.8, 1.0, 1.25, 1.6)
PHASES = 12

# What may be wrong with the believed resin, by one standard deviation of what is held possible, as factors.
_DOUBTED_CHEMISTRY: dict[str, dict[str, float]] = {
    "diffusion of oxygen": {"oxygen_diffusion_mm2_per_s": 1.5},
    "oxygen, and so induction": {"oxygen_mol_per_m3": 0.7},
    # Both, so that gelling takes as much light as before.
    "lifetime of radicals": {"radical_decay_per_s": 1.5, "propagation_m3_per_mol_s": 1.5},
}
_DOUBTED_MIDDLE = 1.07


def stop_model_for(
    plan: Plan,
    rig: Rig,
    resin: ResinModel,
    *,
    voxel_mm: float = 0.2,
    resolution_mm: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> StopModel:
    """Rehearse a plan, for `vialight.control` to tell from what is seen when to stop.

    Parameters
    ----------
    plan
        What will be printed.
    rig
        The printer; its camera is that of the recorded, binned pixels.
    resin
        What the resin is believed to be; its sensitivity counts as 1.
    voxel_mm
        Of the rehearsal, and edge of the places watched.
    resolution_mm
        Standard deviation of the live volume's point spread; by default that of the rig's camera, see
        `camera_resolution_mm`.
    progress
        Called with rehearsals done and to do.

    Raises
    ------
    InputError
        The resin does not gel, or the rig says too little.
    """
    if resolution_mm is None:
        resolution_mm = camera_resolution_mm(resin.in_vial_of(rig), voxel_mm)
    rehearser = Rehearser(plan, rig, resin, voxel_mm, resolution_mm)
    doubted = doubted_resins(resin)
    to_do = [(resin, s) for s in SENSITIVITIES] + [(changed, 1.0) for changed in doubted.values()]
    runs = []
    for model, sensitivity in to_do:
        runs.append(rehearser.rehearse(model, sensitivity))
        if progress:
            progress(len(runs), len(to_do))
    by_sensitivity, by_doubt = runs[: len(SENSITIVITIES)], runs[len(SENSITIVITIES) :]
    nominal = by_sensitivity[SENSITIVITIES.index(1.0)]
    return StopModel(
        points_mm=rehearser.points_mm,
        size_mm=voxel_mm,
        sensitivities=np.array(SENSITIVITIES),
        crossing_s=np.stack([run.crossing_s for run in by_sensitivity]),
        stop_s=np.array([run.stop_s for run in by_sensitivity]),
        doubts=tuple(
            Doubt(name, np.log(run.crossing_s / nominal.crossing_s), float(np.log(run.stop_s / nominal.stop_s)))
            for name, run in zip(doubted, by_doubt, strict=True)
        ),
        turn_s=rehearser.turn_s,
        waiting_s=waiting_s(plan, rehearser.rig, rehearser.grid, rehearser.near_surface),
        gel_share=resin.gel_density / rehearser.surface_density(nominal.at_stop, resin),
    )


def camera_resolution_mm(rig: Rig, cube_mm: float) -> float:
    """Return the standard deviation of a live volume's point spread, averaged over cubes.

    Rays lie `pixel / n` apart.  A cosine filter is two deltas half of that off, which are a variance of 1/4;
    interpolation between rays is a triangle, 1/6; a cube adds a twelfth of its edge squared.

    Examples
    --------
    >>> from vialight.core.config import Camera
    >>> camera = Camera(pixel_mm=0.2, axis_column=50, optical_row=50)
    >>> round(camera_resolution_mm(Rig(geometry="parallel", camera=camera), 0.1), 3)
    0.132
    """
    optics = rig.imaging_optics()
    spacing = rig.need_camera().pixel_mm / (1.0 if optics is None else optics.resin_index)
    return float(np.sqrt(spacing**2 * (1 / 4 + 1 / 6) + cube_mm**2 / 12))


def doubted_resins(resin: ResinModel) -> dict[str, ResinModel]:
    """Return resins that differ from the believed one in what may be wrong, by one standard deviation of its prior."""
    chemistry, scattering = resin.chemistry, resin.scattering
    resins = {
        name: replace(
            resin, chemistry=replace(chemistry, **{key: by * getattr(chemistry, key) for key, by in factors.items()})
        )
        for name, factors in _DOUBTED_CHEMISTRY.items()
    }
    seen_later = replace(scattering, middle_conversion=_DOUBTED_MIDDLE * scattering.middle_conversion)
    return resins | {"density at the gel point": replace(resin, scattering=seen_later)}


def waiting_s(plan: Plan, rig: Rig, grid: Grid, near_surface: BoolArray) -> FloatArray:
    """Return (phase,) by how many seconds places near the design's surface are ahead or behind after a part of a turn.

    Root mean square over places, and over the angle at which the turn began: light may have paused.
    """
    patterns = plan.patterns
    count = len(patterns.levels)
    phases = min(PHASES, count)
    edges = np.linspace(0, count, phases + 1).round().astype(int)
    parts = np.stack([
        dose_of(
            Patterns(
                patterns.levels[a:b], patterns.angles_rad[a:b], patterns.first_row, patterns.first_column,
                patterns.dose_rate_per_level,
            ),
            rig, grid, turns=(b - a) / count,
        )[near_surface]
        for a, b in pairwise(edges)
    ])  # fmt: skip
    whole = parts.sum(axis=0)
    shares = np.concatenate([parts, parts])[:, whole > 0] / whole[whole > 0]
    ahead = np.concatenate([np.zeros((1, shares.shape[1])), np.cumsum(shares, axis=0)])
    begins = np.arange(phases)
    turn_s = 360 / rig.stage.speed_deg_s
    return turn_s * np.array(
        [np.sqrt(np.mean((ahead[begins + k] - ahead[begins] - k / phases) ** 2)) for k in range(phases)]
    )
