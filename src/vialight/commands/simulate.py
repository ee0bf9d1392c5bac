"""Print a plan on the twin: a run's files without a printer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from vialight.core.arrays import Volume
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Plan
from vialight.store import FrameWriter, read_plan, rig_to_toml, staged_folder, write_json, write_stl, write_volume
from vialight.store.provenance import inputs_json, versions
from vialight.twin import (
    FaultsFile,
    Twin,
    TwinSettings,
    check_that_it_gels,
    dose_a_turn_mj_per_cm2,
    find_rig,
    grid_round,
    load_faults,
    load_resin,
    play,
)

DARK_FRAMES = 8
"""Frames of the empty vial that a recording begins with, as in the shared cases."""
LONGEST_TURNS = 60.0
"""Of a print that ends by itself."""
PROFILE_PIXEL_MM = 0.05
"""Of the washed part's height map, as in the shared cases."""


def simulate_print(
    plan_path: str | Path,
    rig_path: str | Path,
    resin: str | Path,
    out: str | Path,
    *,
    turns: float | None = None,
    dose_mj_per_cm2: float | None = None,
    voxel_mm: float = 0.1,
    settings: TwinSettings | None = None,
    faults: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Print a plan on the twin, and record it.

    Parameters
    ----------
    plan_path
        The plan, HDF5.
    rig_path
        The printer as it is: TOML, or the name of a preset.
    resin
        What is in its vial: the name of a preset, or TOML.
    out
        Folder for ``frames.h5``, ``truth.stl``, ``gel_time.zarr``, ``heights.npy``, ``reference.stl``, ``rig.toml`` and
        ``run.json``.
    turns, dose_mj_per_cm2
        When the light goes off: after turns, or a dose in the part; by default when what will gel, with
        the dark cure, is as large as the part.
    voxel_mm
        Of the resin.
    settings
        Of the twin.
    faults
        What is wrong with the printer, and with the ``rig.toml`` that is written: TOML; takes the place of the
        settings' faults.
    progress
        Called with seconds done and to do.

    Returns
    -------
    dict
        What ``run.json`` holds.

    Raises
    ------
    InputError
        Plan, rig, resin or faults cannot be used, the resin cannot gel, or `out` cannot be written.
    """
    started = time.monotonic()
    if turns is not None and dose_mj_per_cm2 is not None:
        raise InputError("--turns", "is given with --dose", accepted="one of them", remedy="leave one out")
    for name, value in (("--turns", turns), ("--dose", dose_mj_per_cm2), ("--voxel", voxel_mm)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(name, f"is {value}", accepted="a positive number", remedy="correct it")
    plan, model = read_plan(plan_path), load_resin(resin)
    rig = model.in_vial_of(find_rig(rig_path))
    wrong = FaultsFile() if faults is None else load_faults(faults)
    settings = settings or TwinSettings()
    if faults is not None:
        settings = replace(settings, faults=wrong.faults)
    believed = wrong.rig_as_believed(rig)
    twin = Twin(rig, model, grid_round(plan.reference, voxel_mm, reach_mm=_reach_mm(rig)), settings)
    a_turn = dose_a_turn_mj_per_cm2(plan.patterns, twin)
    planned = turns if dose_mj_per_cm2 is None else dose_mj_per_cm2 / a_turn
    check_that_it_gels(plan.patterns, twin, planned or np.inf)
    with staged_folder(out) as folder:
        printed = _record(folder / "frames.h5", twin, plan, planned, progress)
        truth = twin.surface()
        write_stl(folder / "truth.stl", truth)
        gel_time_s = np.ascontiguousarray(np.moveaxis(twin.gel_time_s, -1, 0))
        write_volume(folder / "gel_time.zarr", Volume(gel_time_s, twin.grid), {"quantity": "gel time", "unit": "s"})
        write_stl(folder / "reference.stl", plan.reference)
        recorded = believed.model_copy(update={"camera": believed.need_camera().binned(settings.binning)})
        (folder / "rig.toml").write_text(rig_to_toml(recorded), encoding="utf-8")
        np.save(folder / "heights.npy", twin.height_map(pixel_mm=PROFILE_PIXEL_MM))
        result = {
            "inputs": inputs_json(plan=plan_path, **({} if faults is None else {"faults": faults})),
            "rig": rig.model_dump(mode="json", by_alias=True, exclude_none=True),
            "resin": {"chemistry": asdict(model.chemistry), "scattering": asdict(model.scattering)},
            "settings": asdict(settings) | {"voxel_mm": voxel_mm},
            "believed": wrong.believed or {},
            "printed": printed | {"dose_a_turn_mj_per_cm2": a_turn},
            "truth": _truth_json(twin, truth, plan),
            "versions": versions(),
            "elapsed_s": round(time.monotonic() - started, 3),
        }
        write_json(folder / "run.json", result)
    return result


def _truth_json(twin: Twin, truth: Mesh, plan: Plan) -> dict[str, Any]:
    gelled = np.isfinite(twin.gel_time_s)
    return {
        "file": "truth.stl",
        "volume_mm3": truth.volume_mm3,
        "reference_volume_mm3": plan.reference.volume_mm3,
        "heights": {"file": "heights.npy", "pixel_mm": PROFILE_PIXEL_MM},
        "first_gelled_s": float(twin.gel_time_s[gelled].min()),
        "last_gelled_s": float(twin.gel_time_s[gelled].max()),
        "largest_dose_mj_per_cm2": float(twin.dose_mj_per_cm2.max()),
        "critical_dose_mj_per_cm2": twin.resin.chemistry.critical_dose_mj_per_cm2(twin.resin.absorption_per_mm),
    }


def _reach_mm(rig: Rig) -> float:
    optics = rig.writing_optics()
    return np.inf if optics is None else float(optics.field_radius_mm)


def _record(
    path: Path, twin: Twin, plan: Plan, turns: float | None, progress: Callable[[int, int], None] | None
) -> dict[str, float | int]:
    """Print and write frames; return how long the light was on and how many frames there are."""
    part_mm3 = plan.reference.volume_mm3
    darks = [twin.frame(of_the_empty_vial=True) for _ in range(DARK_FRAMES)]
    settings = {"exposure_s": twin.settings.exposure_s, "binning": twin.settings.binning}
    lit_s, ticks, dropped = 0.0, 0, 0
    turn_s = 360 / twin.rig.stage.speed_deg_s
    with FrameWriter(
        path, twin.image_shape, dark=np.stack([dark.counts for dark in darks if dark]), settings=settings
    ) as writer:
        for moment in play(
            twin, plan.patterns, turns=turns or LONGEST_TURNS,
            is_done=lambda now: turns is None and now.volume_to_gel_mm3 >= part_mm3,
        ):  # fmt: skip
            ticks += 1
            lit_s = twin.time_s if moment.is_lit else lit_s
            if moment.frame is None:
                dropped += 1
            else:
                writer.append(moment.frame.counts, moment.frame.angle_rad, moment.frame.time_s)
            if progress:
                total = (turns + 1) * turn_s if turns else max(lit_s + turn_s, twin.time_s)
                progress(int(twin.time_s), int(total))
    return {"turns_lit": lit_s / turn_s, "lit_s": lit_s, "frames": ticks - dropped, "frames_dropped": dropped}
