"""Tables of numbers that people type: CSV with a head."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError
from vialight.system import read_plain

_MOST_BYTES = 4_000_000
"""People do not type more."""


def read_table(path: str | Path, columns: Sequence[str]) -> dict[str, FloatArray]:
    """Read columns of a CSV file by the names in its first line; others are passed over.

    Parameters
    ----------
    path
        The file.
    columns
        Names that must be there.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, or something is no number.
    """
    try:
        text = read_plain(path, _MOST_BYTES).decode("utf-8-sig")
        reader = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True)
        rows = list(reader)
        heads = [head.strip() for head in reader.fieldnames or ()]
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", accepted="CSV", remedy="check the path") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"is not CSV ({error})", accepted=f"columns {', '.join(columns)}") from error
    if missing := [name for name in columns if name not in heads]:
        raise InputError(
            path, f"has no column {missing[0]}, but {', '.join(heads) or 'none'}",
            accepted=f"columns {', '.join(columns)}", remedy="name them in the first line",
        )  # fmt: skip
    return {name: np.array([_number(path, line, name, row) for line, row in enumerate(rows, 2)]) for name in columns}


def _number(path: str | Path, line: int, name: str, row: dict[str, str]) -> float:
    text = row[name]
    try:
        return float(text)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path} line {line}", f"{name} is {text!r}", accepted="a number") from error
