"""Counts become line integrals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from vialight.core.errors import InputError
from vialight.tomography.sinogram import attenuation, bin_frames


@given(
    arrays(np.uint16, array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9), elements=st.integers(0, 4095)),
    st.integers(1, 3),
)
def test_binning_keeps_every_count_of_whole_squares(counts: np.ndarray, binning: int) -> None:
    binned = bin_frames(counts, binning)
    rows, columns = (size // binning for size in counts.shape[-2:])
    assert binned.shape == (*counts.shape[:-2], rows, columns)
    assert binned.dtype == np.float32
    assert binned.sum(dtype=np.float64) == counts[..., : rows * binning, : columns * binning].sum()


def test_binning_sums_the_pixels_that_belong_together() -> None:
    binned = bin_frames(np.arange(35).reshape(5, 7), 2)
    np.testing.assert_array_equal(binned, [[0 + 1 + 7 + 8, 2 + 3 + 9 + 10, 4 + 5 + 11 + 12], [72, 80, 88]])


def test_sums_do_not_overflow_the_counts_type() -> None:
    assert bin_frames(np.full((4, 4), 65535, np.uint16), 4)[0, 0] == 16 * 65535


def test_attenuation_is_the_line_integral_behind_the_transmission() -> None:
    rng = np.random.default_rng(0)
    integrals = rng.uniform(0, 3, (3, 4, 5)).astype(np.float32)
    white, dark = rng.uniform(900, 1100, (4, 5)).astype(np.float32), np.full((4, 5), 100, np.float32)
    counts = dark + (white - dark) * np.exp(-integrals)
    np.testing.assert_allclose(attenuation(counts, white, dark), integrals, rtol=0, atol=1e-4)
    np.testing.assert_allclose(attenuation(counts - dark, white - dark, None), integrals, rtol=0, atol=1e-4)


def test_dead_and_black_pixels_stay_finite() -> None:
    white, dark = np.array([[1000, 50, 1000]], np.float32), np.array([[50, 50, 50]], np.float32)
    found = attenuation(np.array([[[1000, 50, 20]]], np.float32), white, dark)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[0, 0], [0, 0, np.log(1e6)], atol=1e-3)


def test_white_frames_without_light_are_refused() -> None:
    stills = np.full((2, 2), 100, np.float32)
    with pytest.raises(InputError, match="/exchange/data_white: is nowhere brighter than /exchange/data_dark"):
        attenuation(stills[None], stills, stills)
