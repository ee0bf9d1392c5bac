"""Tables of a TOML file as frozen dataclasses, with unknown keys refused.

Angles are in degrees in files and in radians inside: the key ``tilt_deg`` is the field ``tilt_rad``.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, TypeVar

from vialight.core.errors import InputError

_Table = TypeVar("_Table")


def from_table(kind: type[_Table], table: object, where: str, *, leaving: frozenset[str] = frozenset()) -> _Table:
    """Make a dataclass of numbers, whole numbers and pairs of numbers, which its defaults tell apart.

    Parameters
    ----------
    kind
        The dataclass; every field has a default.
    table
        As read.
    where
        File and table, for errors.
    leaving
        Fields that the table may not set.

    Raises
    ------
    InputError
        A key is unknown, or a value is not of its kind or impossible.

    Examples
    --------
    >>> from vialight.twin.scattering import Scattering
    >>> from_table(Scattering, {"steepness": 10}, "resin.toml [scattering]").steepness
    10.0
    """
    named = {_key_of(field.name): field for field in fields(kind) if field.name not in leaving}  # type: ignore[arg-type]  # a dataclass
    if not isinstance(table, dict):
        raise InputError(where, f"is {table!r}", accepted=f"a table of {', '.join(named)}")
    for key in table:
        if key not in named:
            raise InputError(where, f"unknown key {key}", accepted=", ".join(named), remedy="correct or remove it")
    values: dict[str, Any] = {
        named[key].name: _like(named[key].default, value, key, where) for key, value in table.items()
    }
    try:
        return kind(**values)
    except InputError as error:
        raise InputError(where, str(error)) from error


def _key_of(name: str) -> str:
    return f"{name.removesuffix('_rad')}_deg" if name.endswith("_rad") else name


def _like(default: object, value: Any, key: str, where: str) -> object:
    unit = math.radians(1) if key.endswith("_deg") else 1.0
    if isinstance(default, tuple):
        is_whole = all(isinstance(one, int) for one in default)
        is_fitting = isinstance(value, list) and len(value) == len(default)
        if is_fitting and all(map(_is_whole if is_whole else _is_number, value)):
            return tuple(value) if is_whole else tuple(unit * float(one) for one in value)
        accepted = f"{len(default)} {'whole' if is_whole else 'finite'} numbers in brackets"
    elif isinstance(default, int):
        if _is_whole(value):
            return value
        accepted = "a whole number"
    else:
        if _is_number(value):
            return unit * float(value)
        accepted = "a finite number"
    raise InputError(where, f"{key} is {value!r}", accepted=accepted, remedy="correct it")


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
