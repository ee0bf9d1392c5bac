"""The page of a calibration: what was found, how well, and the pictures by which a person sees that it is right."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from vialight.calibration.findings import Findings
from vialight.report.html import MINUS, NONE, Image, write_page
from vialight.report.page import Figure, Provenance


def write_calibration_page(
    path: str | Path,
    findings: Findings,
    found: Sequence[Mapping[str, Any]],
    *,
    rig: str,
    figures: Sequence[Figure] = (),
    provenance: Provenance | None = None,
) -> None:
    """Write a calibration's page as one HTML file that needs nothing but itself.

    Parameters
    ----------
    path
        The file to make; it appears whole, or not at all.
    findings
        What was found.
    found
        Each value as the JSON has it: table, key, before, value, uncertainty, how.
    rig
        The new rig, TOML.
    figures
        Pictures, in this order.
    provenance
        Inputs and versions.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    provenance = provenance or Provenance()
    write_page(path, "calibration.html", lambda: _content(findings, found, rig, figures, provenance))


def write_check_page(
    path: str | Path, result: Mapping[str, Any], *, figures: Sequence[Figure] = (), provenance: Provenance | None = None
) -> None:
    """Write what a check of a calibration found as one HTML file.

    Parameters
    ----------
    path
        The file to make; it appears whole, or not at all.
    result
        ``run``, ``good``, ``checks`` and ``notes`` as `vialight calibrate check` has them.
    figures
        Pictures, in this order.
    provenance
        Inputs and versions.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    checks = [
        (check["what"], *(value_text(float(f"{check[key]:.4g}")) for key in ("rig", "found", "allowed")), check["unit"],
         check["good"], check["means"])
        for check in result["checks"]
    ]  # fmt: skip
    findings = Findings("check", f"{Path(result['run']).name}, compared with its rig", (), result["notes"])
    content = {"good": result["good"], "checks": checks}
    write_page(path, "check.html", lambda: _content(findings, (), "", figures, provenance or Provenance()) | content)


def value_text(value: Any, uncertainty: float | None = None) -> str:
    """Return a value with two figures of its uncertainty.

    Examples
    --------
    >>> value_text(87.90312, 0.00423), value_text(0.5), value_text("DUDMA")
    ('87.9031 ± 0.0042', '0.5', 'DUDMA')
    """
    if value is None:
        return NONE
    if not isinstance(value, float | int) or isinstance(value, bool):
        return str(value)
    if not uncertainty or not math.isfinite(uncertainty):
        return f"{value:.6g}".replace("-", MINUS)
    digits = max(0, 1 - math.floor(math.log10(uncertainty)))
    return f"{value:.{digits}f} ± {uncertainty:.{digits}f}".replace("-", MINUS)


def _content(
    findings: Findings,
    found: Sequence[Mapping[str, Any]],
    rig: str,
    figures: Sequence[Figure],
    provenance: Provenance,
) -> dict[str, Any]:
    return {
        "name": findings.name,
        "method": findings.method,
        "rows": [
            (
                f"[{row['table']}] {row['key']}",
                row["how"],
                value_text(row["before"]),
                value_text(row["value"], row["uncertainty"]),
            )
            for row in found
        ],
        "notes": findings.notes,
        "tables": findings.tables,
        "images": [Image.of(figure.png, figure.title, figure.caption, figure.title) for figure in figures],
        "rig": rig,
        "provenance": provenance,
        "created": provenance.created.strftime("%Y-%m-%d %H:%M %Z").strip(),
    }
