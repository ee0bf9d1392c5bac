"""Rigs from TOML files: checked when read, with unknown keys refused, and faults told in one line."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from vialight.config.rig import Rig
from vialight.errors import InputError


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
        return tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror})", accepted=accepted, remedy=remedy) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(name, f"is not TOML ({error})", accepted=accepted, remedy="see docs/reference.md") from error


def _checked(table: Mapping[str, Any], where: str) -> Rig:
    try:
        return Rig.model_validate({**table, "source": where})
    except ValidationError as error:
        raise _explain(where, error) from error


def _explain(path: str, error: ValidationError) -> InputError:
    fault = error.errors()[0]
    *tables, key = [str(part) for part in fault["loc"]] or ["rig"]
    where = f"{path} [{'.'.join(tables)}]" if tables else path
    known = _keys(_table_at(tables))
    if fault["type"] == "extra_forbidden":
        return InputError(where, f"unknown key {key}", accepted=known, remedy="correct or remove it")
    if fault["type"] == "missing":
        return InputError(where, f"key {key} is missing", accepted=known, remedy="add it")
    if fault["type"] == "model_type":
        return InputError(
            where, f"{key} is {fault['input']!r}", accepted=f"a table of {_keys(_table_at([*tables, key]))}"
        )
    if fault["type"] == "value_error":  # found by a validator of a whole table, in its own words
        return InputError(f"{where} [{key}]", fault["msg"].removeprefix("Value error, "), remedy="correct one of them")
    return InputError(
        where, f"{key} is {fault['input']!r}", accepted=fault["msg"].removeprefix("Input should be "),
        remedy="correct it",
    )  # fmt: skip


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
