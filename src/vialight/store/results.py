"""Results as JSON, and hashes that say which inputs they belong to."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from vialight.core.errors import InputError
from vialight.store.durable import sync_descriptor, sync_folder
from vialight.store.folders import staged_file
from vialight.system import file_in, open_plain, read_plain

_MOST_BYTES = 16_000_000
"""Of a file of results; the largest of vialight's own have a tenth."""
_DEEPEST = 64
_LARGEST_INTEGER = 2**63


def to_json(results: Mapping[str, Any]) -> str:
    """Return results as JSON text, keys in the order given.

    NumPy numbers and arrays become numbers and lists, paths become strings; what is not a finite number becomes null,
    since JSON has no NaN.

    Parameters
    ----------
    results
        Nested mappings and sequences of numbers, strings, paths, arrays, booleans and None.

    Raises
    ------
    TypeError
        Something else is in there.

    Examples
    --------
    >>> print(to_json({"rmse_mm": np.float64(0.25), "iou": float("nan"), "shape": np.array([2, 3])}))
    {
      "rmse_mm": 0.25,
      "iou": null,
      "shape": [
        2,
        3
      ]
    }
    """
    return json.dumps(_plain(results), indent=2, allow_nan=False, ensure_ascii=False)


def write_json(path: str | Path, results: Mapping[str, Any], *, durable: bool = False) -> None:
    """Write results as `to_json` gives them, with a last newline; the file appears whole, or not at all.

    Parameters
    ----------
    path
        The file to make.
    results
        As for `to_json`.
    durable
        Return when it is on the disk, so that no power cut loses it.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    text = to_json(results) + "\n"
    with staged_file(path) as unfinished, unfinished.open("w", encoding="utf-8") as file:
        file.write(text)
        if durable:
            file.flush()
            sync_descriptor(file.fileno())
    if durable:
        sync_folder(Path(path).resolve().parent)


def read_json(path: str | Path) -> dict[str, Any]:
    """Read results.

    Raises
    ------
    InputError
        The file is missing, is not JSON, or is no object.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "metrics.json"
    >>> write_json(path, {"rmse_mm": 0.25})
    >>> read_json(path)
    {'rmse_mm': 0.25}
    """
    try:
        content = read_plain(path, _MOST_BYTES)
    except OSError as error:
        raise InputError(
            path, f"cannot be read ({error.strerror})", accepted="results in JSON", remedy="check the path"
        ) from error
    return parse_json(content, path)


def parse_json(content: bytes | str, where: object) -> dict[str, Any]:
    """Return the object that a text in JSON states, of plain numbers that programs can compute with.

    Parameters
    ----------
    content
        JSON, in UTF-8.
    where
        Named in errors.

    Raises
    ------
    InputError
        It is not JSON (which has no NaN), is no object, or has numbers or a depth that no result has.

    Examples
    --------
    >>> parse_json('{"rmse_mm": 0.25}', "metrics.json")
    {'rmse_mm': 0.25}
    """
    try:
        raw = (content.encode() if isinstance(content, str) else content).removeprefix(b"\xef\xbb\xbf")
        found = msgspec.json.decode(raw)
        _check_values(found)
    except (ValueError, RecursionError) as error:
        raise InputError(where, f"is not JSON ({error})", accepted="results in JSON", remedy="make it again") from error
    if not isinstance(found, dict):
        raise InputError(where, f"holds a {type(found).__name__}", accepted="an object: names and values")
    return found


def _check_values(found: object) -> None:
    """Refuse what is valid JSON and makes those stumble who read it."""
    level: list[Any] = [found]
    for _ in range(_DEEPEST):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner.extend(value.values())
            elif isinstance(value, list):
                inner.extend(value)
            elif isinstance(value, int) and abs(value) >= _LARGEST_INTEGER:
                raise ValueError("a number is too large")
        if not inner:
            return
        level = inner
    raise ValueError(f"it is more than {_DEEPEST} levels deep")


def sha256_of(path: str | Path) -> str:
    """Hash a file, or a folder with all that is in it: names and contents, in the order of the names.

    Raises
    ------
    InputError
        It is missing or cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "empty"
    >>> path.touch()
    >>> sha256_of(path)[:16]
    'e3b0c44298fc1c14'
    """
    path = Path(path)
    try:
        if not path.is_dir():
            with open_plain(path, sys.maxsize) as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        whole = hashlib.sha256()
        files = {item.relative_to(path).as_posix(): item for item in path.rglob("*") if item.is_file()}
        for name in sorted(files):
            file_in(path, name)
            whole.update(f"{sha256_of(files[name])} {name}\0".encode())
        return whole.hexdigest()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", remedy="check the path") from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
