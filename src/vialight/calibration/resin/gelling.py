"""How much light each place had got when it was seen to gel: the critical exposure, from a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_erosion

from vialight.calibration.findings import Finding, Findings
from vialight.control.looking_back import LOOKS_A_TURN, Place, see_again, times_of
from vialight.control.stop_model import REHEARSAL, StopModel
from vialight.core.arrays import FloatArray, Volume
from vialight.core.errors import InputError
from vialight.metrology.kinetics import doses_over_time, mj_per_cm2
from vialight.metrology.kinetics.shown_light import ShownLight, light_of
from vialight.store import open_frames, read_json, read_plan, read_volume
from vialight.store.rig_files import load_rig
from vialight.system import file_in

FEWEST = 50
"""Voxels within what gelled while there was light."""
_MOST = 100
_PIECES = 16
"""Of the print, whose medians tell how well that of the whole is known."""
_WITHIN_MM = 0.6
"""That places lie within what gelled: at the rim, blur and noise decide when the threshold is passed."""
_RATES_DIFFER = 1.2
"""Dose rates of runs, the highest over the lowest, from which on they tell how much later than its dose resin gels."""


@dataclass(frozen=True)
class GelDoses:
    """Doses at which places gelled.

    Parameters
    ----------
    dose_mj_per_cm2, gel_time_s
        (place,) and when, on the run's clock.
    rate_mj_per_cm2_s
        Dose a second of light, in the median.
    delay_s, delay_std_s
        By which gelling was seen late, which is allowed for, and its standard uncertainty.
    delay_std_mj_per_cm2
        What that is in dose, in the median.
    source
        Of the gel times, in words.
    """

    dose_mj_per_cm2: FloatArray
    gel_time_s: FloatArray
    rate_mj_per_cm2_s: float
    delay_s: float
    delay_std_s: float
    delay_std_mj_per_cm2: float
    source: str

    @property
    def critical_mj_per_cm2(self) -> float:
        """Median of the doses."""
        return float(np.median(self.dose_mj_per_cm2))

    @property
    def spread_mj_per_cm2(self) -> float:
        """Robust standard deviation of the doses."""
        return 1.4826 * float(np.median(np.abs(self.dose_mj_per_cm2 - self.critical_mj_per_cm2)))

    @property
    def critical_std_mj_per_cm2(self) -> float:
        """Standard uncertainty of the median: by how much pieces of the print differ, and of the delay."""
        medians = [np.median(piece) for piece in np.array_split(self.dose_mj_per_cm2, _PIECES)]
        return float(np.hypot(np.std(medians, ddof=1), self.delay_std_mj_per_cm2))


def gel_doses(
    run: str | Path, plan: str | Path | None = None, *, voxel_mm: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> GelDoses:  # fmt: skip
    """Find how much light places within a print had got when they gelled.

    Parameters
    ----------
    run
        A run's folder: a twin's, whose ``gel_time.zarr`` is true, or any other, whose frames are read again.
    plan
        By default the run's ``plan.h5``.
    voxel_mm
        In which frames are read again; by default a pixel.
    progress
        Called with frames done and to do.

    Raises
    ------
    InputError
        The run lacks what is needed, or too little gelled while there was light.
    """
    run = Path(run)
    rig = load_rig(file_in(run, "rig.toml"))
    plan_path = file_in(run, "plan.h5") if plan is None else Path(plan)
    if not plan_path.exists():
        raise InputError(plan_path, "there is no such file", accepted="the plan that was printed", remedy="give --plan")
    patterns = read_plan(plan_path).patterns
    factor = mj_per_cm2(patterns, rig)
    if factor is None:
        raise InputError(
            run / "rig.toml", "[projector] has no irradiance_mw_per_cm2", accepted="that of level 255, in air",
            remedy="measure it with a power meter in the plane of the axis",
        )  # fmt: skip
    with open_frames(file_in(run, "frames.h5")) as frames:
        light = light_of(run, rig, frames, patterns)
        if (stored := file_in(run, "gel_time.zarr")).exists():
            times, delay_s, delay_std_s = read_volume(stored), 0.0, 0.0
            source = "gel times of the twin (gel_time.zarr)"
        else:
            lit_s = light.lit_at(times_of(frames, rig))
            nowhere = Place((0.0, 0.0, 0.0))
            level = _gel_share(run) * rig.need_threshold()
            seen = see_again(frames, rig, nowhere, lit_s, level, voxel_mm=voxel_mm, progress=progress)
            times = Volume(seen.gel_time_s, seen.grid)
            turn_s = 360 / rig.stage.speed_deg_s
            # What is seen is the mean of the last turn, and looked at now and then.
            delay_s, delay_std_s = turn_s / 2 + turn_s / LOOKS_A_TURN / 2, turn_s / np.sqrt(12)
            source = "gel times seen in the frames, half a turn late"
    assert light.shown is not None  # there is a plan
    points, when = _places(times, delay_s, light, run)
    doses = factor * doses_over_time(points, patterns, rig, light.shown)
    at, late = (
        np.array([np.interp(t + shift, light.shown.time_s, dose) for t, dose in zip(when, doses.T, strict=True)])
        for shift in (0.0, delay_std_s)
    )
    rate = float(np.median(at / light.lit_at(when)))
    return GelDoses(at, when, rate, delay_s, delay_std_s, float(np.median(late - at)), source)


def _gel_share(run: Path) -> float:
    """Return the density at which a place gels, of I_p, that of finished surfaces; 1 where no rehearsal says."""
    path = file_in(run, REHEARSAL)
    return StopModel.from_json(read_json(path)).gel_share if path.exists() else 1.0


def _places(times: Volume, delay_s: float, light: ShownLight, run: Path) -> tuple[FloatArray, FloatArray]:
    """Return (place, xyz) and when they gelled, sorted by place."""
    when = times.density - delay_s
    within = binary_erosion(np.isfinite(when), iterations=int(np.ceil(_WITHIN_MM / times.grid.voxel_mm)))
    on_s, off_s = light.time_at(1e-9), light.time_at(float(light.lit_s[-1]))
    chosen = np.argwhere(within & (when > on_s) & (when < off_s))
    if len(chosen) < FEWEST:
        raise InputError(
            run, f"{len(chosen)} voxels within the print gelled while there was light", accepted=f"{FEWEST} and more",
            remedy="take a run that was printed through, or a finer --voxel",
        )  # fmt: skip
    some = np.random.default_rng(0).permutation(len(chosen))[:_MOST]
    z, y, x = chosen[np.sort(some)].T
    grid = times.grid
    return np.stack([grid.x_mm[x], grid.y_mm[y], grid.z_mm[z]], axis=1), np.asarray(when[z, y, x], np.float64)


def critical_dose(found: Sequence[GelDoses]) -> tuple[float, float, float | None]:
    """Return the critical dose, its standard uncertainty, and how long after it resin gels, s.

    Radicals outlive the light, so that resin gels when it has already got more: ``dose = critical + rate * lag``, a
    line through runs of different rates; how straight it is on beyond the slowest is not known, which is in the
    uncertainty.  Where rates are alike, the mean dose is returned, and no lag.

    Examples
    --------
    >>> times = np.ones(64)
    >>> runs = [GelDoses(900.0 + 6 * rate * times, times, rate, 0.0, 0.0, 2.0, "") for rate in (10.0, 30.0)]
    >>> [round(value, 3) for value in critical_dose(runs)]
    [900.0, 17.607, 6.0]
    """
    dose, std, rate = np.array(
        [(one.critical_mj_per_cm2, one.critical_std_mj_per_cm2, one.rate_mj_per_cm2_s) for one in found]
    ).T
    columns = [np.ones_like(rate)] + ([rate] if rate.max() > _RATES_DIFFER * rate.min() else [])
    design = np.stack(columns, axis=1) / std[:, None]
    covariance = np.linalg.inv(design.T @ design)
    values = covariance @ design.T @ (dose / std)
    if len(columns) == 1:
        return float(values[0]), float(np.sqrt(covariance[0, 0])), None
    bend = rate.min() * values[1] / np.sqrt(12)
    return float(values[0]), float(np.hypot(np.sqrt(covariance[0, 0]), bend)), float(values[1])


def gelling_findings(found: Sequence[GelDoses], runs: Sequence[Path]) -> Findings:
    """Return what runs say of their resin."""
    critical, std, lag_s = critical_dose(found)
    notes = [
        f"{run.name}: places gelled at doses that differ by {one.spread_mj_per_cm2 / one.critical_mj_per_cm2:.1%} (one "
        "standard deviation, robust)"
        + (f", seen {one.delay_s:.1f} ± {one.delay_std_s:.1f} s late, which is allowed for." if one.delay_s else ".")
        for one, run in zip(found, runs, strict=True)
    ]
    if lag_s is None:
        share = max(one.rate_mj_per_cm2_s for one in found) / critical
        notes.append(
            f"For each second by which resin gels later than light has brought its dose, this is {share:.1%} too much: "
            "give runs at two irradiances or more to have that told."
        )
    else:
        notes.append(f"Resin gels {lag_s:.1f} s later than light has brought its dose, which is allowed for.")
    return Findings(
        "resin", f"dose at which places of {len(found)} run{'s' if len(found) > 1 else ''} gelled; {found[0].source}",
        [Finding("resin", "critical_exposure_mj_per_cm2", critical, std, "of what gelled while there was light")],
        notes, {"gels_later_by_s": lag_s, "gel_doses_mj_per_cm2": [one.critical_mj_per_cm2 for one in found],
                "dose_rates_mj_per_cm2_s": [one.rate_mj_per_cm2_s for one in found]},
    )  # fmt: skip
