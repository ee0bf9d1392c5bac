"""The report's page: what stands where, and in which words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vialight.metrology import Agreement, Comparison, Registration
from vialight.report.colours import colour_limit_mm
from vialight.report.figures import histogram_png, projections_png, views_png
from vialight.report.html import MINUS, NONE, Image, write_page


class Figure(Protocol):
    """A further picture for the report, with the words that go with it."""

    @property
    def title(self) -> str:
        """What it is."""

    @property
    def caption(self) -> str:
        """What a person should look for in it."""

    @property
    def png(self) -> bytes:
        """The picture."""


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from.

    Parameters
    ----------
    inputs
        Role ("print", "reference") to ``{"file": name, "sha256": digest}``.
    settings
        Name to value, as asked for.
    versions
        Part to version.
    created
        When; now, if not told.
    """

    inputs: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    created: datetime = field(default_factory=lambda: datetime.now().astimezone())


def write_report(
    path: str | Path, comparison: Comparison, *, provenance: Provenance | None = None, figures: Sequence[Figure] = ()
) -> None:
    """Write the report as one HTML file that needs nothing but itself.

    No script, no network; pictures are inside.  With the same inputs it is the same file, but for its date.

    Parameters
    ----------
    path
        The file to make; it appears whole, or not at all.
    comparison
        What was measured.
    provenance
        Input hashes, settings, versions.
    figures
        Further pictures, shown in this order after the measurements: those of the optics.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    filters = {"mm": _mm, "percent": _percent, "share": _share, "signed": _signed_mm}
    write_page(path, "report.html", lambda: _content(comparison, provenance or Provenance(), figures), filters)


def _content(comparison: Comparison, provenance: Provenance, figures: Sequence[Figure]) -> dict[str, Any]:
    poses = [("as placed", comparison.as_placed)]
    if comparison.aligned is not None:
        poses.insert(0, ("aligned", comparison.aligned))
    return {
        "comparison": comparison,
        "reported": comparison.reported,
        "pose": poses[0][0],
        "poses": poses,
        "summary": _summary([agreement for _, agreement in poses]),
        "names": {role: entry.get("file", NONE) for role, entry in provenance.inputs.items()},
        "notices": _notices(comparison),
        "extents": _extents(comparison),
        "alignment": _alignment_words(comparison.registration),
        "matrix": [[f"{value + 0.0:.6f}" for value in row] for row in comparison.transform.round(6)],
        "images": _images(comparison),
        "figures": [Image.of(figure.png, figure.title, figure.caption, figure.title) for figure in figures],
        "provenance": provenance,
        "created": provenance.created.strftime("%Y-%m-%d %H:%M %Z").strip(),
    }


def _summary(poses: Sequence[Agreement]) -> list[tuple[str, str, list[str]]]:
    """Return rows: name, explanation, a value for each pose."""
    tables = [pose.to_json() for pose in poses]
    body, point = poses[0].worst
    worst = f"on the {body} at {_vector(point, 2)} mm"

    def row(name: str, why: str, *keys: str) -> tuple[str, str, list[str]]:
        formats = {"mm": _mm, "percent": _percent, "iou": _share}
        cells = [" / ".join(formats[key.rpartition("_")[2]](table[key]) for key in keys) for table in tables]
        return name, why, cells

    return [
        row(
            "RMSE", "root mean square deviation, print to reference / reference to print", "rmse_mm", "reverse_rmse_mm"
        ),
        row(
            "Standard deviation", "about the mean, print to reference / reference to print", "std_mm", "reverse_std_mm"
        ),
        row("Mean", "signed; positive outside the other body", "mean_mm", "reverse_mean_mm"),
        row("95 % within", "of the area, print to reference / reference to print", "p95_mm", "reverse_p95_mm"),
        row("Largest deviation", f"Hausdorff distance, either direction; {worst}", "hausdorff_mm"),
        row("Overlap", "intersection over union of the two bodies", "iou"),
        row("Volume error", "of the reference's volume; positive where the print has more", "volume_error_percent"),
    ]


def _notices(comparison: Comparison) -> list[str]:
    notices = []
    for name, mesh in (("reference", comparison.reference), ("print", comparison.measured)):
        if not mesh.is_closed:
            why = "is inside out" if mesh.is_watertight else "is not watertight"
            notices.append(
                f"The {name} {why}: it has no inside, so distances to it have no sign, and what needs one is left out "
                f"({NONE})."
            )
    return notices


def _extents(comparison: Comparison) -> list[dict[str, Any]]:
    """Return rows of the table of sizes: what, print, reference, difference, in mm."""
    sizes = [mesh.extents_mm for mesh in (comparison.measured, comparison.reference)]
    bounds = [mesh.bounds_mm for mesh in (comparison.measured, comparison.reference)]
    names = ("along x", "along y", "height, along z")
    pairs = {name: (float(sizes[0][k]), float(sizes[1][k])) for k, name in enumerate(names)}
    for k, end in enumerate(("lower", "upper")):
        pairs[f"{end} end, z"] = float(bounds[0][k, 2]), float(bounds[1][k, 2])
    return [
        {"name": name, "print": printed, "reference": meant, "difference": printed - meant}
        for name, (printed, meant) in pairs.items()
    ]


def _alignment_words(registration: Registration | None) -> list[str]:
    if registration is None:
        return ["No alignment was asked for: the print was measured as placed."]
    angle, shift = registration.angle_deg, registration.translation_mm
    axis = registration.rotation_vector_deg / max(angle, 1e-12)
    turned = (
        f"turned by {angle:.3f}° about the direction {_vector(axis, 3)} through the origin"
        if angle >= 5e-4
        else "not turned"
    )
    sentences = [
        f"The print was {turned} and moved by {_vector(shift, 3)} mm ({np.linalg.norm(shift):.3f} mm) to lie closest "
        "to the reference in the mean square; it was not scaled."
    ]
    if registration.open_directions:
        sentences.append(
            "The part's symmetry leaves open: "
            + "; ".join(registration.open_directions)
            + ". Along these the print was left as it lay."
        )
    else:
        sentences.append("No symmetry leaves a direction open.")
    return sentences


def _images(comparison: Comparison) -> dict[str, Image]:
    limit = colour_limit_mm(comparison)
    signed = comparison.reported.forward.is_signed
    sense = "Red stands proud of the reference, blue lies inside it" if signed else "The reference has no inside"
    images = {
        "views": Image.of(
            views_png(comparison, limit), "Deviation of the print's surface",
            f"{sense}; the scale ends at ±{limit:g} mm. Orthographic, all to one scale, not mirrored.",
            "The print's surface from four sides, coloured by its deviation from the reference.",
        ),
        "histogram": Image.of(
            histogram_png(comparison, limit), "Distribution of the deviation",
            "Weighted by area. What lies beyond the ends is counted in the outermost bars.",
            "Histogram of the share of the print's area over its deviation in mm.",
        ),
    }  # fmt: skip
    if comparison.measured.is_closed and comparison.reference.is_closed:
        images["projections"] = Image.of(
            projections_png(comparison), "Sum projections",
            "How many mm of material lie along each line of sight, and where the print has more (red) or less (blue).",
            "Print, reference and their difference, summed along z, y and x.",
        )  # fmt: skip
    return images


def _vector(values: Sequence[float] | np.ndarray[Any, Any], digits: int) -> str:
    return (
        "(" + ", ".join(f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values).replace("-", MINUS) + ")"
    )


def _mm(value: float | None) -> str:
    return NONE if value is None else f"{value:.3f} mm".replace("-", MINUS)


def _signed_mm(value: float | None) -> str:
    return NONE if value is None else f"{value:+.3f} mm".replace("-", MINUS)


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{value:.2f} %".replace("-", MINUS)


def _share(value: float | None) -> str:
    return NONE if value is None else f"{value:.4f}"
