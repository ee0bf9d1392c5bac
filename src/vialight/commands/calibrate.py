"""Calibrate: each command finds values of the rig and writes a new one, with a page that shows whether it is right."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

from vialight.calibration.axis import command as axis
from vialight.calibration.check import command as check
from vialight.calibration.latency import command as latency
from vialight.calibration.projector import command as projector
from vialight.calibration.resin import command as resin
from vialight.calibration.scale import command as scale
from vialight.calibration.scale import flat_target_command as flat_target
from vialight.calibration.threshold import command as threshold
from vialight.calibration.vial import command as vial
from vialight.calibration.writing import Calibrated, check_out, refused_picture
from vialight.store import staged_folder, write_json
from vialight.store.rig_files import load_rig

P = ParamSpec("P")


def write_calibrated(calibrated: Calibrated) -> dict[str, Any]:
    """Write the new rig, its page and its JSON, all or none.

    Returns
    -------
    dict
        What the ``.json`` holds.

    Raises
    ------
    InputError
        The new rig is the one that is read, or cannot be written, or would not be valid.
    """
    from vialight.report import Provenance, write_calibration_page

    check_out(calibrated.rig_path, calibrated.out)
    out = Path(calibrated.out)
    text, result = calibrated.rig_text(), calibrated.to_json()
    with staged_folder(out.parent) as folder:
        (folder / out.name).write_text(text, encoding="utf-8")
        load_rig(folder / out.name)
        write_json(folder / f"{out.stem}.json", result)
        write_calibration_page(
            folder / f"{out.stem}.html",
            calibrated.findings,
            result["found"],
            figures=calibrated.figures,
            provenance=Provenance(inputs=result["inputs"], versions=result["versions"]),
            rig=text,
        )
    refused_picture(out).unlink(missing_ok=True)  # of an earlier attempt
    return result


def _written(calibration: Callable[P, Calibrated]) -> Callable[P, dict[str, Any]]:
    """Return a command that writes what a calibration has found, and returns what the ``.json`` holds."""

    @wraps(calibration)
    def command(*args: P.args, **kwargs: P.kwargs) -> dict[str, Any]:
        return write_calibrated(calibration(*args, **kwargs))

    return command


calibrate_axis = _written(axis.calibrate_axis)
calibrate_latency = _written(latency.calibrate_latency)
calibrate_projector = _written(projector.calibrate_projector)
calibrate_resin = _written(resin.calibrate_resin)
calibrate_scale = _written(scale.calibrate_scale)
calibrate_scale_by_target = _written(flat_target.calibrate_scale_by_target)
calibrate_threshold = _written(threshold.calibrate_threshold)
calibrate_vial = _written(vial.calibrate_vial)


def check_calibration(
    run: str | Path, rig_path: str | Path | None = None, *, turn: int | None = None, out: str | Path | None = None
) -> dict[str, Any]:
    """Compare what a run's frames say with what its rig says, and write a page of it.

    Parameters
    ----------
    run, rig_path, turn, out
        See `vialight.calibration.check.command.check_calibration`.

    Returns
    -------
    dict
        What the ``.json`` beside the page holds.

    Raises
    ------
    InputError
        The frames cannot be used, or the page or `out` cannot be written.
    """
    from vialight.report import Provenance, write_check_page

    checked = check.check_calibration(run, rig_path, turn=turn, out=out)
    page, result = checked.page, checked.result
    with staged_folder(page.parent) as folder:
        write_json(folder / f"{page.stem}.json", result)
        provenance = Provenance(inputs=result["inputs"], versions=result["versions"])
        write_check_page(folder / page.name, result, figures=checked.figures, provenance=provenance)
    if checked.kept is not None:
        write_calibrated(checked.kept)
    return result
