"""A rig that is written is the rig that is read."""

from __future__ import annotations

import tomllib
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from vialight.config import Rig
from vialight.store import rig_to_toml

lengths = st.floats(1e-6, 1e6)
tables = st.fixed_dictionaries(
    {},
    optional={
        "geometry": st.sampled_from(["vial", "parallel"]),
        "vial": st.fixed_dictionaries({"outer_radius_mm": lengths}, optional={"wall_index": st.floats(1, 3)}),
        "resin": st.fixed_dictionaries(
            {"name": st.text(max_size=20)},
            optional={"threshold_conditions": st.fixed_dictionaries({"gain_db": st.floats(-9, 9)})},
        ),
        "camera": st.fixed_dictionaries(
            {"pixel_mm": lengths, "axis_column": st.floats(-1e3, 1e3), "optical_row": st.just(100.0)},
            optional={"distance_mm": lengths | st.just(float("inf"))},
        ),
    },
)


@given(tables)
def test_what_is_written_is_read(table: dict[str, Any]) -> None:
    rig = Rig.model_validate(table)
    assert Rig.model_validate(tomllib.loads(rig_to_toml(rig))) == rig
