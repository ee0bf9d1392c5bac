"""Rigs from TOML files: checked when read, with unknown keys refused, and faults told in one line."""

from __future__ import annotations

import re
import reprlib
import tomllib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from vialight.core.config.rig import Rig
from vialight.core.errors import InputError
from vialight.system import read_plain

_MOST_BYTES = 256_000
"""Of a file in TOML; rigs have a few thousand."""
_DEEPEST = 32
_LONGEST_KEY = 80
"""That is shown whole."""
_LARGEST_INTEGER = 2**63
_TOKEN = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}|'
    r"'''.*?'{3,5}|"
    r'"""|'
    r"'''|"
    r'"(?:[^"\\\n]|\\.)*"|'
    r"'[^'\n]*'|#[^\n]*|[\w+-]+|[ \t]+|.",
    re.DOTALL,
)
"""Of TOML: strings and comments, in which brackets and dots mean nothing, words, spaces, single characters.

A string of many lines may end with two quotes of its own before the three that close it.
"""
_OPENED = frozenset({'"""', "'''", '"', "'"})
"""Tokens of strings that nothing closes; to go on behind them would search the rest of the text for each."""
_ENDS_OF_KEYS = "=,[]{}\n#"


def load_rig(path: str | Path) -> Rig:
    """Read and check a rig file.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or holds unknown, missing or impossible values.
    """
    table = read_toml(Path(path), accepted="a rig in TOML", remedy="check the path")
    if "source" in table:
        raise InputError(path, "unknown key source", remedy="remove it")
    return _checked(table, str(path))


def changed_rig(rig: Rig, changes: Mapping[str, Any], where: str) -> Rig:
    """Return a rig with other values, checked as if read from a file.

    Parameters
    ----------
    rig
        What is not changed.
    changes
        Tables of a rig file with the keys that differ.
    where
        Named in errors.

    Raises
    ------
    InputError
        A key is unknown, or a value impossible.

    Examples
    --------
    >>> changed_rig(Rig(), {"stage": {"speed_deg_s": 24.0}}, "faults.toml").stage.speed_deg_s
    24.0
    """
    table = rig.model_dump(by_alias=True, exclude_none=True)
    for key, value in changes.items():
        both = isinstance(value, Mapping) and isinstance(table.get(key), Mapping)
        table[key] = table[key] | value if both else value
    return _checked(table, where)


def read_toml(source: Path | Traversable, *, accepted: str, remedy: str, name: object = None) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    source
        The file.
    accepted, remedy
        What was expected, and what to do where it is not there; for errors.
    name
        What the user calls the file; by default its path.

    Raises
    ------
    InputError
        The file is missing or is not TOML.
    """
    name = source if name is None else name
    try:
        content = read_plain(source, _MOST_BYTES) if isinstance(source, Path) else source.read_bytes()
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror})", accepted=accepted, remedy=remedy) from error
    return parse_toml(content, name, accepted=accepted)


def parse_toml(content: bytes | str, where: object, *, accepted: str = "TOML") -> dict[str, Any]:
    """Return the table that a text in TOML states.

    Parameters
    ----------
    content
        TOML, in UTF-8, with a mark of the byte order before it or without.
    where, accepted
        Named in errors: what it is, and what was expected.

    Raises
    ------
    InputError
        It is not TOML, or has numbers or a depth that no rig has.

    Examples
    --------
    >>> parse_toml("stage.speed_deg_s = 20.0", "rig.toml")
    {'stage': {'speed_deg_s': 20.0}}
    """
    try:
        text = content if isinstance(content, str) else content.decode("utf-8-sig")
        _check_depth(text)
        table = tomllib.loads(text)
        _check_integers(table)
    except (ValueError, RecursionError) as error:  # tomllib's own errors, and those of UTF-8, are values' errors
        raise InputError(where, f"is not TOML ({error})", accepted=accepted, remedy="see docs/reference.md") from error
    return table


def _check_depth(text: str) -> None:
    """Refuse what `tomllib` takes hours or all memory for: its effort grows with the square of a dotted key's parts."""
    if len(text) > _MOST_BYTES:
        raise ValueError(f"it has {len(text)} characters")
    brackets = parts = 0
    for token in _TOKEN.finditer(text):
        if token[0] in _OPENED:
            raise ValueError("a string has no end")
        first = token[0][0]
        if first in "[{":
            brackets += 1
        elif first in "]}":
            brackets -= 1
        parts = parts + 1 if first == "." else 0 if first in _ENDS_OF_KEYS else parts
        if brackets > _DEEPEST or parts > _DEEPEST:
            raise ValueError(f"it is more than {_DEEPEST} levels deep")


def _check_integers(table: dict[str, Any]) -> None:
    waiting: list[Any] = [table]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            waiting.extend(value.values())
        elif isinstance(value, list):
            waiting.extend(value)
        elif isinstance(value, int) and abs(value) >= _LARGEST_INTEGER:
            raise ValueError("a number is too large")


def _checked(table: Mapping[str, Any], where: str) -> Rig:
    try:
        return Rig.model_validate({**table, "source": where})
    except ValidationError as error:
        raise _explain(where, error) from error


def _explain(path: str, error: ValidationError) -> InputError:
    fault = error.errors()[0]
    *tables, key = [str(part)[:_LONGEST_KEY] for part in fault["loc"]] or ["rig"]
    where = f"{path} [{'.'.join(tables)}]" if tables else path
    known = _keys(_table_at(tables))
    if fault["type"] == "extra_forbidden":
        return InputError(where, f"unknown key {key}", accepted=known, remedy="correct or remove it")
    if fault["type"] == "missing":
        return InputError(where, f"key {key} is missing", accepted=known, remedy="add it")
    if fault["type"] == "model_type":
        return InputError(
            where, f"{key} is {_shortened(fault['input'])}", accepted=f"a table of {_keys(_table_at([*tables, key]))}"
        )
    if fault["type"] == "value_error":  # found by a validator of a whole table, in its own words
        return InputError(f"{where} [{key}]", fault["msg"].removeprefix("Value error, "), remedy="correct one of them")
    return InputError(
        where, f"{key} is {_shortened(fault['input'])}", accepted=fault["msg"].removeprefix("Input should be "),
        remedy="correct it",
    )  # fmt: skip


def _shortened(value: object) -> str:
    """Show a value in one line, whatever its size."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 80
    return short.repr(value)


def _table_at(path: list[str]) -> type[BaseModel] | None:
    """Return the table at a path of keys; None where values have no table of their own."""
    table: type[BaseModel] | None = Rig
    for key in path:
        field = None if table is None else table.model_fields.get(key)
        if field is not None:
            table = _table_in(field.annotation)
        # Else it is the name of one of several alike, as in [calibration.axis], or a place in a list.
    return table


def _table_in(annotation: object) -> type[BaseModel] | None:
    """Return the table that an annotation such as ``Vial | None`` or ``dict[str, Calibration]`` allows."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_table_in, getattr(annotation, "__args__", ()))), None)


def _keys(table: type[BaseModel] | None) -> str:
    fields = {} if table is None else table.model_fields
    return ", ".join(field.alias or name for name, field in fields.items() if name != "source")
