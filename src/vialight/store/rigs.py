"""Rigs as TOML text: what a plan keeps, and what calibration gives back.

Written here: Python reads TOML but does not write it, and a rig needs no more of it than numbers, strings,
lists and tables.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from vialight.config import Rig


def rig_to_toml(rig: Rig) -> str:
    """Return a rig as `vialight.config.load_rig` reads it; what is not set is left out.

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
    return "\n".join(_lines(rig.model_dump(by_alias=True, exclude_none=True), ""))


def _lines(table: Mapping[str, Any], prefix: str) -> list[str]:
    """Write plain values first: after the head of an inner table they would belong to it."""
    lines = [f"{key} = {_value(value)}" for key, value in table.items() if not isinstance(value, Mapping)]
    lines.append("")
    for key, value in table.items():
        if isinstance(value, Mapping):
            lines += [f"[{prefix}{key}]", *_lines(value, f"{prefix}{key}.")]
    return lines


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)
