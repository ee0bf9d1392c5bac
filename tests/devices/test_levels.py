"""Levels that are sent: their light is that which is planned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from vialight.core.config import ProjectorSettings
from vialight.core.errors import InputError
from vialight.devices.projectors.levels import light_of_levels, read_flat_field, sent_levels

ALL = np.arange(256, dtype=np.uint8)[None]
GAMMA = tuple((float(level), 3.0 * (level / 255) ** 2.2) for level in range(0, 256, 15))


def test_without_a_table_levels_are_sent_as_they_are() -> None:
    assert (sent_levels(ALL, light_of_levels(None)) == ALL).all()
    assert (sent_levels(ALL, light_of_levels(None), np.ones(ALL.shape, np.float32)) == ALL).all()


def test_light_of_the_level_sent_is_the_nearest_there_is_to_the_planned_share() -> None:
    light = light_of_levels(GAMMA)
    sent = sent_levels(ALL, light)[0]
    for level in range(1, 256):
        assert abs(light[sent[level]] - level / 255) == np.abs(light - level / 255).min()
    assert (np.diff(sent.astype(int)) >= 0).all()
    assert sent[0] == 0
    assert sent[255] == 255


@given(st.lists(st.floats(0.01, 10.0), min_size=1, max_size=8))
def test_sent_levels_rise_with_the_planned_ones_whatever_was_measured(steps: list[float]) -> None:
    levels = np.linspace(0, 255, len(steps) + 1)
    light = np.concatenate([[0.0], np.cumsum(steps)])
    sent = sent_levels(ALL, light_of_levels(tuple(zip(levels.tolist(), light.tolist(), strict=True))))[0]
    assert (np.diff(sent.astype(int)) >= 0).all()


def test_flat_field_dims_light_and_not_levels() -> None:
    light = light_of_levels(GAMMA)
    mask = np.full((1, 256), 0.5, np.float32)
    sent = sent_levels(ALL, light, mask)[0]
    step = np.diff(light).max()
    assert np.abs(light[sent] - 0.5 * ALL[0] / 255)[1:].max() <= step / 2


def test_flat_field_is_read_as_shares_of_white(tmp_path: Path) -> None:
    Image.fromarray(np.array([[0, 51, 255]], np.uint8)).save(tmp_path / "flat.png")
    assert read_flat_field(tmp_path / "flat.png", (1, 3)).tolist() == [[0.0, np.float32(0.2), 1.0]]
    with pytest.raises(InputError, match=r"of 3 x 1 pixels; accepted: a grey PNG of 4 x 2"):
        read_flat_field(tmp_path / "flat.png", (2, 4))
    with pytest.raises(InputError, match="cannot be read"):
        read_flat_field(tmp_path / "none.png", (2, 4))


@pytest.mark.parametrize("table", [(), ((0.0, 0.0), (128.0, 2.0)), ((0.0, 0.0), (128.0, 2.0), (255.0, 1.0))])
def test_linearisation_that_does_not_rise_over_all_levels_is_refused(table: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValueError, match="levels rising from 0 to 255"):
        ProjectorSettings(linearisation=table)
