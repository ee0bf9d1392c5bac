"""Calibrate the scale by a flat target, dots or a chessboard, that is held in the plane of the axis."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vialight.calibration.findings import Finding, Findings
from vialight.calibration.scale.flat_target import TargetFit, TargetView, bend_of, fit_target
from vialight.calibration.scale.flat_target_places import (
    COLUMN,
    DEPTH,
    DISTORTION,
    INDEX,
    PITCH,
    PIXEL,
    ROW,
    YAW,
    Known,
)
from vialight.calibration.scale.flat_target_points import Kind, centred, find_grid
from vialight.calibration.usable_frames import check_unsaturated
from vialight.calibration.writing import Calibrated, check_out, shown_where_refused
from vialight.core.arrays import TURN_RAD, FloatArray
from vialight.core.config import Camera, Optics, Rig
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.store import FrameFile, open_frames
from vialight.store.rig_files import load_rig

MOST_DISTORTION = 0.1
"""Columns at the sides of the image, beyond which it is warned of: by as much an axis may be off."""
_MOST_VIEWS, _MOST_FRAMES = 25, 50
_TURNED_DEG = 40.0
"""From the view that faces the camera most: farther round, points lie too close to each other."""
_SAME_DEG = 0.5
_LEAST_ROWS, _LEAST_COLUMNS = 1.5, 0.1
"""Standard uncertainty from which on optical row and axis column are left alone."""
_SURE = 3.0


@dataclass(frozen=True)
class FlatTarget:
    """A flat target, and how it is seen.

    Parameters
    ----------
    kind, pitch_mm, pitch_std_mm
        What it is, from point to point, and the standard uncertainty of that; by default a thousandth.
    is_in_vial
        Whether it is held in the resin in the vial; else plainly in air.
    plane_std_mm
        Standard uncertainty of its plane being that of the axis.
    """

    kind: Kind
    pitch_mm: float
    pitch_std_mm: float | None = None
    is_in_vial: bool = False
    plane_std_mm: float = 0.3

    def __post_init__(self) -> None:
        for option, value, least in ((f"--{self.kind}", self.pitch_mm, 1e-6), ("--pitch-std-mm", self.pitch_std, 0.0),
                                     ("--plane-std-mm", self.plane_std_mm, 1e-6)):  # fmt: skip
            if not least <= value < 100:
                raise InputError(option, f"is {value:g}", accepted="a length in mm")

    @property
    def pitch_std(self) -> float:
        """Standard uncertainty of the pitch, mm."""
        return 1e-3 * self.pitch_mm if self.pitch_std_mm is None else self.pitch_std_mm


def calibrate_scale_by_target(
    frames_path: str | Path, rig_path: str | Path, out: str | Path, target: FlatTarget
) -> Calibrated:
    """Find a pixel's size, the optical row and the lens's distortion from pictures of a flat target.

    Parameters
    ----------
    frames_path
        Data Exchange HDF5: the target in one position of the stage or, better, in several within 40 deg of facing the
        camera.
    rig_path, out
        The rig to change, whose pixel is right to a third, and the new one.
    target
        What is seen.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        No such target is seen, it faces away from the camera, or `out` cannot be written.
    """
    from vialight.calibration.scale.flat_target_figure import target_png

    check_out(rig_path, out)
    rig = load_rig(rig_path)
    camera, optics = rig.need_camera(), rig.imaging_optics() if target.is_in_vial else None
    if target.is_in_vial and optics is None:
        raise InputError("--in-vial", 'but geometry is "parallel"', accepted="a rig with a vial")
    with open_frames(frames_path) as frames:
        images = _images(frames, rig)
    first = images[0][1]
    with shown_where_refused(out, lambda: target_png(first, ())):
        check_unsaturated(np.rint(np.stack([image for _, image in images[:20]])), frames_path)
        fit = _fit(images, _known(target, rig, camera, optics, first.shape), target, frames_path)
    shown = dict(images)[fit.views[0].angle_rad]
    figure = Picture(
        "target", "The target, with its points as found",
        f"Each circle must lie on a {'dot' if target.kind == 'dots' else 'corner'}. Lines show, a hundred times as "
        "long, how far points are off where the fit has them: short, and without a pattern.",
        target_png(shown, fit.views[:1], fit.left_over, fit.kept),
    )  # fmt: skip
    return Calibrated(_findings(fit, target, rig), rig_path, frames_path, out, figures=[figure])


def _known(target: FlatTarget, rig: Rig, camera: Camera, optics: Optics | None, image_shape: tuple[int, ...]) -> Known:
    """Return what the rig says, as uncertain as it says it is."""
    stated = rig.uncertainty
    distance_std, index_std = (stated and stated.camera) or {}, (stated and stated.resin) or {}
    known = Known(target.pitch_mm, camera, optics, (image_shape[0], image_shape[1]), target.plane_std_mm)
    changes = {}
    if "distance_mm" in distance_std and camera.distance_mm:
        changes["distance_std"] = distance_std["distance_mm"] / camera.distance_mm
    if "index_imaging" in index_std and optics is not None:
        changes["index_std"] = index_std["index_imaging"] / optics.resin_index
    return Known(**(vars(known) | changes))


def _images(frames: FrameFile, rig: Rig) -> list[tuple[float, FloatArray]]:
    """Return angle and mean image of some positions of the stage, evenly chosen."""
    angles = rig.stage.direction * frames.angles_rad
    step = np.radians(_SAME_DEG)
    position = np.rint(angles % TURN_RAD / step).astype(int) % round(TURN_RAD / step)
    places = np.unique(position)
    chosen = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), 3 * _MOST_VIEWS)).astype(int))]
    images = []
    for place in chosen:
        at = np.flatnonzero(position == place)
        some = at[:: -(-len(at) // _MOST_FRAMES)]
        images.append((float(angles[at[0]] % TURN_RAD), frames.read(some).mean(axis=0, dtype=np.float64)))
    return images


def _fit(images: list[tuple[float, FloatArray]], known: Known, target: FlatTarget, where: Path | str) -> TargetFit:
    across = target.pitch_mm / known.camera.pixel_mm
    step = (across if known.optics is None else across * known.optics.resin_index, across)
    views, refusals = [], []
    for angle, image in images:
        try:
            views.append(TargetView(angle, find_grid(image, target.kind, step, where)))
        except InputError as error:
            refusals.append(error)
    if not views:
        raise refusals[0]
    faces = max(views, key=lambda view: view.width_of_a_step).angle_rad
    turned = {view.angle_rad: (view.angle_rad - faces + np.pi) % TURN_RAD - np.pi for view in views}
    near = [view for view in views if abs(turned[view.angle_rad]) <= np.radians(_TURNED_DEG)]
    near = near[:: -(-len(near) // _MOST_VIEWS)]
    fit = fit_target([TargetView(faces + turned[view.angle_rad], view.points) for view in near], known, where)
    at = {faces + turned[angle]: image for angle, image in images if angle in turned}
    better = [
        TargetView(view.angle_rad, centred(at[view.angle_rad], view.points, step, bend_of(fit, view)))
        for view in fit.views
    ]
    return fit_target(better, known, where, start=fit)


def _findings(fit: TargetFit, target: FlatTarget, rig: Rig) -> Findings:
    value, std, count = fit.values, fit.std, len(fit.views)
    pixel_std = fit.pixel_mm * float(np.hypot(std[PIXEL], target.pitch_std / target.pitch_mm))
    points = "dots" if target.kind == "dots" else "corners"
    how = f"{points} {target.pitch_mm:g} mm apart, which fit to {fit.rms:.3f} pixels"
    values = [Finding("camera", "pixel_mm", fit.pixel_mm, pixel_std, how)]
    notes = []
    if std[ROW] < _LEAST_ROWS:
        how = "beside which the target's rows " + ("bow" if target.is_in_vial else "lean as it turns")
        values.append(Finding("camera", "optical_row", float(value[ROW]), float(std[ROW]), how))
    else:
        notes.append(
            f"optical_row is left alone: what is seen tells it to {std[ROW]:.0f} rows only. "
            + ("Use a target that fills more of the image, or several positions of the stage." if target.is_in_vial
               else "Plainly seen, a target that faces the camera looks the same wherever it is: record it with the "
               "stage turned by 20 deg to either side too.")
        )  # fmt: skip
    if std[COLUMN] < _LEAST_COLUMNS and count > 1:
        values.append(Finding("camera", "axis_column", float(value[COLUMN]), float(std[COLUMN]),
                              "about which the target turns"))  # fmt: skip
    notes += [*_place(fit, target), *_lens(fit, rig)]
    details: dict[str, Any] = {
        "points": int(fit.kept.sum()), "points_left_out": int((~fit.kept).sum()), "rms_pixels": fit.rms,
        "positions": count, "is_in_vial": target.is_in_vial, "pitch_mm": target.pitch_mm,
        "plane_behind_axis_mm": float(value[DEPTH]), "plane_behind_axis_std_mm": float(std[DEPTH]),
        "yaw_deg": float(np.degrees(value[YAW])), "yaw_std_deg": float(np.degrees(std[YAW])),
        "lean_deg": float(np.degrees(value[PITCH])), "lean_std_deg": float(np.degrees(std[PITCH])),
        "distortion_columns": float(value[DISTORTION]), "distortion_std_columns": float(std[DISTORTION]),
    }  # fmt: skip
    through = "through the vial" if target.is_in_vial else "in air"
    where = "one position" if count == 1 else f"{count} positions"
    return Findings(
        "scale", f"a flat target of {points} seen {through} in {where} of the stage", values, notes, details
    )


def _place(fit: TargetFit, target: FlatTarget) -> list[str]:
    """Tell where the target is not in the plane of the axis."""
    value, std, notes = fit.values, fit.std, []
    for place, what in ((YAW, "is turned by {:.1f} deg about the vertical"), (PITCH, "leans by {:.1f} deg")):
        tilt, tilt_std = np.degrees(value[place]), np.degrees(std[place])
        if abs(tilt) > max(1.0, _SURE * tilt_std):
            notes.append(f"The target {what.format(abs(tilt))} out of the plane of the axis; that is allowed for.")
    if std[DEPTH] < target.plane_std_mm / 2:
        if abs(value[DEPTH]) > max(0.1, _SURE * std[DEPTH]):
            side = "behind" if value[DEPTH] > 0 else "in front of"
            notes.append(f"The target lies {abs(value[DEPTH]):.2f} mm {side} the axis; that is allowed for.")
    elif fit.known.camera.distance_mm:
        notes.append(
            f"That the target lies in the plane of the axis to {target.plane_std_mm:g} mm is taken on trust, and is "
            f"{target.plane_std_mm / fit.known.camera.distance_mm:.2%} of pixel_mm: other positions of the stage would "
            "tell."
        )
    return notes


def _lens(fit: TargetFit, rig: Rig) -> list[str]:
    """Tell what the target says of the lens and of the resin."""
    value, std, notes = fit.values, fit.std, []
    distortion, distortion_std = float(value[DISTORTION]), float(std[DISTORTION])
    if abs(distortion) > max(MOST_DISTORTION, 2 * distortion_std):
        way = "outwards" if distortion > 0 else "inwards"
        notes.append(
            f"The lens distorts: at the sides of the image it moves what it shows {way} by {abs(distortion):.2f} ± "
            f"{distortion_std:.2f} columns, more than the {MOST_DISTORTION:g} that matter. vialight does not correct "
            "that: use a better lens, or less of its field."
        )
    elif distortion_std > MOST_DISTORTION:
        notes.append(f"Of the lens's distortion nothing is known: {distortion:.2f} ± {distortion_std:.2f} columns.")
    index = rig.resin.index_imaging
    if fit.known.optics is not None and index and abs(value[INDEX]) > max(_SURE * std[INDEX], 1e-3):
        notes.append(
            f"Columns and rows fit together with an index of {index * np.exp(value[INDEX]):.4f} ± "
            f"{index * std[INDEX]:.4f} of what is in the vial; the rig has {index:g}."
        )
    return notes
