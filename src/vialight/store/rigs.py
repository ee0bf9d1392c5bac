"""Rigs as TOML text: what a plan keeps, and what calibration gives back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.container import Container
from tomlkit.items import AbstractTable

from vialight.core.config import Rig


def rig_to_toml(rig: Rig) -> str:
    """Return a rig as `vialight.store.rig_files.load_rig` reads it; what is not set is left out.

    Examples
    --------
    >>> print(rig_to_toml(Rig.model_validate({"stage": {"speed_deg_s": 20.0}, "resin": {"name": "DUDMA"}})))
    schema = 1
    geometry = "vial"
    <BLANKLINE>
    [resin]
    name = "DUDMA"
    <BLANKLINE>
    [stage]
    speed_deg_s = 20.0
    direction = 1
    <BLANKLINE>
    """
    return tomlkit.dumps(rig.model_dump(by_alias=True, exclude_none=True))


def with_values(text: str, changes: Mapping[str, Any]) -> str:
    r"""Return TOML with some values changed or added; all else, comments included, stays as it is.

    Parameters
    ----------
    text
        TOML.
    changes
        Nested tables with the new values; None removes a key.

    Examples
    --------
    >>> print(with_values("[camera]\naxis_column = 87.5  # at first\n", {"camera": {"axis_column": 87.9}}))
    [camera]
    axis_column = 87.9  # at first
    <BLANKLINE>
    """
    document = tomlkit.parse(text)
    _change(document, changes, inside=False)
    return tomlkit.dumps(document)


def _change(table: Container | AbstractTable, changes: Mapping[str, Any], *, inside: bool) -> None:
    for key, value in changes.items():
        if value is None:
            table.pop(key, None)
        elif not isinstance(value, Mapping):
            table[key] = value
        else:
            is_new = not isinstance(table.get(key), Container | AbstractTable)
            if is_new:
                table[key] = tomlkit.table()
            _change(table[key], value, inside=not is_new)
            if is_new and inside:
                table[key].add(tomlkit.nl())  # another table may follow
