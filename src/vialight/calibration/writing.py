"""What every calibration leaves to be written: the new rig with its JSON; and a picture of what was refused."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from vialight.calibration.findings import Findings
from vialight.core.drawing import Picture
from vialight.core.errors import InputError
from vialight.store import sha256_of, staged_file, with_values
from vialight.store.provenance import inputs_json, versions
from vialight.store.rig_files import read_toml


@dataclass(frozen=True)
class Calibrated:
    """What a calibration has found, and where it is to be written.

    Parameters
    ----------
    findings
        What was found.
    rig_path
        The rig that it changes; comments and all that was not found stay as they are.
    data_path
        What it was found from; its hash goes into ``[calibration.NAME]``.
    out
        The new rig, TOML; ``.html`` and ``.json`` of the same name come beside it.
    figures
        For the page.
    inputs
        Role to path of further inputs.
    """

    findings: Findings
    rig_path: str | Path
    data_path: str | Path
    out: str | Path
    figures: Sequence[Picture] = ()
    inputs: Mapping[str, str | Path] | None = None

    def rig_text(self) -> str:
        """Return the new rig, TOML."""
        text = Path(self.rig_path).read_text(encoding="utf-8")
        return with_values(text, _changes(self.findings, self.data_path))

    def to_json(self) -> dict[str, Any]:
        """Return what the ``.json`` beside the new rig holds."""
        findings = self.findings
        before = read_toml(Path(self.rig_path), accepted="a rig in TOML", remedy="check the path")
        return {
            "calibration": findings.name,
            "method": findings.method,
            "found": [
                {
                    "table": found.table,
                    "key": found.key,
                    "before": _at(before, found.table, found.key),
                    "value": found.value,
                    "uncertainty": found.uncertainty,
                    "how": found.how,
                }
                for found in findings.values
                if (found.value, _at(before, found.table, found.key)) != (None, None)
            ],
            "tables": [
                {"title": title, "heads": list(heads), "rows": [list(row) for row in rows]}
                for title, heads, rows in findings.tables
            ],
            "notes": list(findings.notes),
            "details": dict(findings.details),
            "inputs": inputs_json(data=self.data_path, rig=self.rig_path, **(self.inputs or {})),
            "versions": versions(),
        }


def check_out(rig_path: str | Path, out: str | Path) -> None:
    """Refuse, before any work, to write the new rig over the one that it is made from.

    Raises
    ------
    InputError
        Both are the same file, or `out` does not end in ``.toml``.
    """
    rig_path, out = Path(rig_path), Path(out)
    if out.suffix != ".toml":
        raise InputError("--out", f"is {out}", accepted="the name of a rig, NEW.toml", remedy="let it end in .toml")
    if rig_path.exists() and out.exists() and rig_path.samefile(out):
        raise InputError(
            "--out", f"is {out}, the rig that is read", accepted="another name",
            remedy="compare the two, then replace the old one yourself",
        )  # fmt: skip


@contextmanager
def shown_where_refused(out: str | Path, picture: Callable[[], bytes]) -> Iterator[None]:
    """Let a refusal leave a picture of what was seen, ``NEW_RIG.refused.png``, and name it.

    Parameters
    ----------
    out
        The rig that would have been written.
    picture
        Draws it, as PNG; asked only where something is refused.
    """
    try:
        yield
    except InputError as error:
        path = refused_picture(out)
        with staged_file(path) as staging:
            staging.write_bytes(picture())
        error.args = (f"{error}; see {path}",)
        raise


def refused_picture(out: str | Path) -> Path:
    """Return where the picture of what was refused goes."""
    return Path(out).with_suffix(".refused.png")


def _changes(findings: Findings, data_path: str | Path) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    for found in findings.values:
        _put(changes, found.table, found.key, rounded(found.value, found.uncertainty))
        if found.uncertainty is not None:
            table, *inner = found.table.split(".")
            _put(changes, f"uncertainty.{table}", ".".join([*inner, found.key]), float(f"{found.uncertainty:.3g}"))
    changes.setdefault("calibration", {})[findings.name] = {
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "file": Path(data_path).name,
        "sha256": sha256_of(data_path),
        "method": findings.method,
    }
    return changes


def rounded(value: Any, uncertainty: float | None) -> Any:
    """Return a value without the digits that a hundredth of its uncertainty leaves open.

    Examples
    --------
    >>> rounded(87.903123456, 0.0042), rounded(87.903123456, None)
    (87.90312, 87.903123456)
    """
    if not isinstance(value, float) or not uncertainty:
        return value
    return round(value, 2 - math.floor(math.log10(uncertainty)))


def _put(changes: dict[str, Any], table: str, key: str, value: Any) -> None:
    for name in table.split("."):
        changes = changes.setdefault(name, {})
    changes[key] = value


def _at(table: Mapping[str, Any], path: str, key: str) -> Any:
    for name in path.split("."):
        table = table.get(name, {})
    return table.get(key)
