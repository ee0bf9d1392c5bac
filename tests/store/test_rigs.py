"""A rig that is written is the rig that is read."""

from __future__ import annotations

import tomllib
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from vialight.core.config import Rig
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
            optional={
                "distance_mm": lengths | st.just(float("inf")),
                "driver": st.sampled_from(["aravis", "harvesters"]),
                "settings": st.fixed_dictionaries(
                    {},
                    optional={
                        "device": st.text(max_size=20),
                        "exposure_s": lengths,
                        "region": st.tuples(*[st.integers(0, 4096)] * 2, *[st.integers(1, 4096)] * 2),
                    },
                ),
            },
        ),
        "projector": st.fixed_dictionaries(
            dict.fromkeys(["distance_mm", "pixel_mm"], lengths)
            | {
                "columns": st.just(1024),
                "rows": st.just(768),
                "axis_column": st.just(511.5),
                "azimuth_deg": st.just(-90),
            },
            optional={
                "settings": st.fixed_dictionaries(
                    {"monitor": st.integers(0, 3) | st.text(max_size=9)},
                    optional={"linearisation": st.just(((0.0, 0.0), (9.5, 0.1), (255.0, 3.0)))},
                )
            },
        ),
        "stage": st.fixed_dictionaries(
            {"run_out": st.fixed_dictionaries({"radius_mm": lengths, "phase_deg": st.just(9.0)})}
        ),
        "uncertainty": st.fixed_dictionaries(
            {"camera": st.dictionaries(st.sampled_from(["axis_column", "pixel_mm"]), lengths)}
        ),
        "calibration": st.dictionaries(
            st.sampled_from(["axis", "threshold"]), st.fixed_dictionaries({"date": st.just("2026-11-25")})
        ),
    },
)


@given(tables)
def test_what_is_written_is_read(table: dict[str, Any]) -> None:
    rig = Rig.model_validate(table)
    assert Rig.model_validate(tomllib.loads(rig_to_toml(rig))) == rig
