"""What every calibration gives: values of the rig, with their uncertainties and how they were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Finding:
    """A value of the rig that was found.

    Parameters
    ----------
    table, key
        Where it stands in the rig; an inner table as in ``"stage.run_out"``.
    value
        What it is; None where the rig is not to state it any more.
    uncertainty
        Standard uncertainty, in the value's own unit; None where none can be stated.
    how
        In words, for a person.
    """

    table: str
    key: str
    value: Any
    uncertainty: float | None = None
    how: str = ""


@dataclass(frozen=True)
class Findings:
    """All that a calibration found.

    Parameters
    ----------
    name
        Of the calibration: ``[calibration.NAME]`` in the rig.
    method
        In a sentence, for the rig.
    values
        What the new rig gets.
    notes
        What a person should know: what was left alone and why, what looks odd.
    details
        Further numbers for the JSON, units in their names.
    tables
        Of the page: title, heads of the columns, rows.
    """

    name: str
    method: str
    values: Sequence[Finding]
    notes: Sequence[str] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]] = ()
