"""How far the projector reaches, against refraction and counting."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.optics.refraction import virtual_to_camera
from vialight.planning.target import printable_room

VIAL = {"outer_radius_mm": 12.4, "wall_mm": 1.1, "wall_index": 1.472}
PROJECTOR = {
    "distance_mm": 119.8, "pixel_mm": 0.065, "columns": 1024, "rows": 768, "axis_column": 511.5, "azimuth_deg": -90.0,
}  # fmt: skip


def rig(vial: dict[str, Any] | None = VIAL, index: float | None = 1.49, **projector: Any) -> Rig:
    table: dict[str, Any] = {"resin": {"index_writing": index}, "projector": PROJECTOR | projector}
    return Rig.model_validate(table | ({"vial": vial} if vial else {"geometry": "parallel"}))


def test_refraction_limits_the_radius_where_the_image_is_wide() -> None:
    room = printable_room(rig())
    assert room.radius_mm == pytest.approx(12.4 / 1.49, rel=3e-3)
    assert room.radius_mm < 12.4 / 1.49


def test_glass_limits_the_radius_where_it_is_thick() -> None:
    assert printable_room(rig(VIAL | {"wall_mm": 6.0})).radius_mm == pytest.approx(6.4, rel=3e-3)


def test_columns_limit_the_radius_on_the_side_where_there_are_fewer() -> None:
    room = printable_room(rig(axis_column=100.0))
    optics = rig().writing_optics()
    assert optics is not None
    assert float(virtual_to_camera(room.radius_mm, 0.0, optics)[0]) == pytest.approx(100 * 0.065)


def test_height_is_that_of_the_rows_less_what_perspective_takes() -> None:
    room = printable_room(rig())
    assert room.top_mm == pytest.approx(-room.bottom_mm)
    assert 0.9 * 768 * 0.065 < room.height_mm < 767 * 0.065


def test_index_matched_telecentric_room_is_the_image_itself() -> None:
    room = printable_room(rig(None, axis_column=500.0, optical_row=100.0))
    np.testing.assert_allclose([room.radius_mm, room.bottom_mm, room.top_mm], [32.5, -667 * 0.065, 6.5])


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (rig(index=None), "[resin] has no index_writing"),
        (rig(axis_column=-3.0), "axis_column -3 leaves no columns on one side"),
        (rig(axis_column=1023.0), "accepted: between 0 and columns - 1 = 1023"),
        (rig(rows=1), "its 1 rows about optical_row 0 leave no height"),
        (Rig.model_validate({"vial": VIAL, "resin": {"index_writing": 1.49}}), "no table [projector]"),
    ],
)
def test_a_rig_that_cannot_print_is_refused(broken: Rig, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        printable_room(broken)
