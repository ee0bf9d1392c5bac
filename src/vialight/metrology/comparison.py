"""Everything that is measured on a print against its reference, gathered."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError, VialightWarning
from vialight.core.mesh import Mesh
from vialight.metrology.cylinders import Cylinder, measure_cylinders
from vialight.metrology.distance import Deviation, Samples, deviation, sample_surface, warn_unsigned
from vialight.metrology.overlap import intersection_over_union
from vialight.metrology.registration import Registration, register

_OTHER_UNIT = 5.0
"""How many times as large a print has to be as its reference, or as small, for a unit to be doubted."""

REQUIRED_SHARE = 0.999
"""Of the area, in each direction, that has to lie within the tolerance."""


@dataclass(frozen=True)
class Agreement:
    """How two surfaces agree, in one pose of the print.

    Parameters
    ----------
    forward
        The print's surface measured to the reference: positive where the print stands proud.
    reverse
        The reference's surface measured to the print: negative where it lies inside the print, so where the print
        stands proud; large and positive where a part of the reference was not printed at all.
    max_dimension_mm
        The longest side of the reference's bounding box.
    iou
        Intersection over union of the two bodies, 0 to 1; None unless both are closed.
    volume_error_percent
        Of the reference's volume, positive where the print has more; None unless both are closed.
    """

    forward: Deviation
    reverse: Deviation
    max_dimension_mm: float
    iou: float | None
    volume_error_percent: float | None

    @property
    def hausdorff_mm(self) -> float:
        """The largest distance in either direction."""
        return max(self.forward.max_mm, self.reverse.max_mm)

    @property
    def worst(self) -> tuple[Literal["print", "reference"], FloatArray]:
        """The surface, and the (3,) point on it, that lies farthest from the other."""
        if self.reverse.max_mm > self.forward.max_mm:
            return "reference", self.reverse.worst_point_mm
        return "print", self.forward.worst_point_mm

    def to_json(self) -> dict[str, Any]:
        """Return the statistics under the names of ``metrics.json``."""
        values: dict[str, Any] = {}
        for prefix, part in (("", self.forward), ("reverse_", self.reverse)):
            values[f"{prefix}rmse_mm"] = part.rmse_mm
            values[f"{prefix}mean_mm"] = part.mean_mm
            values[f"{prefix}std_mm"] = part.std_mm
            values[f"{prefix}p95_mm"] = part.p95_mm
        std = self.forward.std_mm
        return values | {
            "hausdorff_mm": self.hausdorff_mm,
            "hausdorff_on": self.worst[0],
            "hausdorff_at_mm": self.worst[1].tolist(),
            "rmse_percent": 100 * self.forward.rmse_mm / self.max_dimension_mm,
            "std_percent": None if std is None else 100 * std / self.max_dimension_mm,
            "iou": self.iou,
            "volume_error_percent": self.volume_error_percent,
        }


@dataclass(frozen=True)
class Tolerance:
    """Whether a print keeps a tolerance.

    The whole surface is meant to lie within the tolerance of the other (a profile tolerance, ISO 1101), in both
    directions: print to reference sees what is too much, reference to print sees what is missing.  A single largest
    value would judge the noise of one vertex, and a 95th percentile would pass a print that lacks a pin; so all but
    0.1 % of the area has to be within, and the largest deviation is reported beside.

    Parameters
    ----------
    tolerance_mm
        Largest deviation allowed, either way.
    share_within, reverse_share_within
        Of the print's area to the reference, and of the reference's area to the print, 0 to 1.
    max_deviation_mm
        In either direction.
    """

    tolerance_mm: float
    share_within: float
    reverse_share_within: float
    max_deviation_mm: float

    @property
    def passed(self) -> bool:
        """Whether at least 99.9 % of the area is within, in both directions."""
        return min(self.share_within, self.reverse_share_within) >= REQUIRED_SHARE


@dataclass(frozen=True)
class Comparison:
    """A print measured against its reference.

    Parameters
    ----------
    measured
        The print in the pose that is reported: aligned, where that was asked for.
    reference
        What was meant.
    deviation_mm
        (n,) distance of each of `measured`'s vertices to the reference; signed where the reference is closed.
    as_placed, aligned
        Statistics of both poses; `aligned` is None where no alignment was asked for.
    registration
        How the print was moved; None where no alignment was asked for.
    cylinders
        Diameters at the reference's cylindrical faces, in the reported pose.
    tolerance
        The verdict in the reported pose; None where no tolerance was given.
    """

    measured: Mesh = field(repr=False)
    reference: Mesh = field(repr=False)
    deviation_mm: FloatArray = field(repr=False)
    as_placed: Agreement
    aligned: Agreement | None
    registration: Registration | None
    cylinders: tuple[Cylinder, ...]
    tolerance: Tolerance | None
    placed_bounds_mm: FloatArray = field(repr=False)

    @property
    def reported(self) -> Agreement:
        """The statistics of the pose that is reported."""
        return self.aligned or self.as_placed

    @property
    def transform(self) -> FloatArray:
        """(4, 4) motion from the print as placed to the reported pose, mm."""
        return np.eye(4) if self.registration is None else self.registration.matrix

    def to_json(self) -> dict[str, Any]:
        """Return what ``metrics.json`` holds: plain numbers, with units in the names; None where there is none.

        ``iou`` and ``volume_error_percent`` at the top are those of the reported pose, ``transform`` is row by row.
        """
        reported = self.reported
        return {
            "as_placed": self.as_placed.to_json(),
            "aligned": self.aligned.to_json() if self.aligned else None,
            "max_dimension_mm": reported.max_dimension_mm,
            "iou": reported.iou,
            "volume_error_percent": reported.volume_error_percent,
            "transform": self.transform.tolist(),
            "alignment": self._alignment_json(),
            "print": _body_json(self.measured) | {"bounds_as_placed_mm": self.placed_bounds_mm.tolist()},
            "reference": _body_json(self.reference),
            "cylinders": [asdict(cylinder) for cylinder in self.cylinders],
            "tolerance": asdict(self.tolerance) | {"passed": self.tolerance.passed} if self.tolerance else None,
        }

    def _alignment_json(self) -> dict[str, Any]:
        if self.registration is None:
            return {"kind": "none"}
        return {
            "kind": "rigid",
            "angle_deg": self.registration.angle_deg,
            "rotation_vector_deg": self.registration.rotation_vector_deg.tolist(),
            "translation_mm": self.registration.translation_mm.tolist(),
            "open_directions": list(self.registration.open_directions),
        }


def compare(
    measured: Mesh, reference: Mesh, *, align: Literal["rigid", "none"] = "rigid", tolerance_mm: float | None = None
) -> Comparison:
    """Measure a print against what was meant.

    Parameters
    ----------
    measured
        The print, object frame.
    reference
        The mesh that was meant, object frame.
    align
        "rigid": also after the best rigid motion without scaling, and report that pose; "none": as placed only.
    tolerance_mm
        Largest deviation allowed, either way; None for no verdict.

    Returns
    -------
    Comparison
        Statistics as placed and aligned, diameters, the verdict, and the deviation of every vertex.

    Raises
    ------
    InputError
        `align` or `tolerance_mm` is not one of what is accepted.

    Warns
    -----
    VialightWarning
        A mesh is not closed, so that what needs an inside is None; see `distance.signed_distance` for why this is not
        an error.  Or the meshes differ so much in size that they may be in different units.

    Examples
    --------
    >>> part = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> shifted = Mesh(part.vertices_mm + [0.5, 0, 0], part.faces)
    >>> comparison = compare(shifted, part, tolerance_mm=0.1)
    >>> round(comparison.as_placed.hausdorff_mm, 3), round(comparison.aligned.hausdorff_mm, 6)
    (0.5, 0.0)
    >>> round(float(comparison.registration.translation_mm[0]), 6), comparison.tolerance.passed
    (-0.5, True)
    """
    if align not in ("rigid", "none"):
        raise InputError("--align", f"is {align!r}", accepted="rigid, none")
    if tolerance_mm is not None and not 0 < tolerance_mm < np.inf:
        raise InputError("--tolerance", f"is {tolerance_mm}", accepted="a positive length in mm")
    for name, mesh in (("the reference", reference), ("the print", measured)):
        if not mesh.is_closed:
            warn_unsigned(name, mesh)
    larger = np.ptp(reference.vertices_mm, axis=0).max() / np.ptp(measured.vertices_mm, axis=0).max()
    if not 1 / _OTHER_UNIT < larger < _OTHER_UNIT:
        warnings.warn(
            f"the reference is {larger:.3g} times as large as the print: are both in mm?", VialightWarning, stacklevel=2
        )

    as_placed, per_vertex = _agreement(measured, reference)
    registration, aligned, moved = None, None, measured
    if align == "rigid":
        registration = register(measured, reference)
        moved = measured.moved(registration.matrix)
        aligned, per_vertex = _agreement(moved, reference)
    reported = aligned or as_placed
    return Comparison(
        measured=moved,
        reference=reference,
        deviation_mm=per_vertex,
        as_placed=as_placed,
        aligned=aligned,
        registration=registration,
        cylinders=measure_cylinders(moved, reference),
        tolerance=None if tolerance_mm is None else _verdict(reported, tolerance_mm),
        placed_bounds_mm=measured.bounds_mm,
    )


def _agreement(measured: Mesh, reference: Mesh) -> tuple[Agreement, FloatArray]:
    """Return the statistics of one pose, and the distance of each vertex of the print."""
    samples: Samples = sample_surface(measured)
    forward = deviation(samples, reference)
    both_closed = measured.is_closed and reference.is_closed
    agreement = Agreement(
        forward=forward,
        reverse=deviation(sample_surface(reference), measured),
        max_dimension_mm=float(reference.extents_mm.max()),
        iou=intersection_over_union(measured, reference) if both_closed else None,
        volume_error_percent=100 * (measured.volume_mm3 / reference.volume_mm3 - 1) if both_closed else None,
    )
    return agreement, forward.distance_mm[: len(measured.vertices_mm)]


def _verdict(agreement: Agreement, tolerance_mm: float) -> Tolerance:
    return Tolerance(
        tolerance_mm=tolerance_mm,
        share_within=agreement.forward.share_within(tolerance_mm),
        reverse_share_within=agreement.reverse.share_within(tolerance_mm),
        max_deviation_mm=agreement.hausdorff_mm,
    )


def _body_json(mesh: Mesh) -> dict[str, Any]:
    extents = mesh.extents_mm
    return {
        "bounds_mm": mesh.bounds_mm.tolist(),
        "extents_mm": extents.tolist(),
        "height_mm": float(extents[2]),
        "area_mm2": mesh.area_mm2,
        "volume_mm3": mesh.volume_mm3 if mesh.is_closed else None,
        "closed": mesh.is_closed,
        "faces": len(mesh.faces),
    }
