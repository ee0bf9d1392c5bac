"""The chemistry against balances, closed solutions and the field's own working curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vialight.core.arrays import Grid
from vialight.core.errors import InputError
from vialight.twin.chemistry import Chemistry, Cure, cure, diffused, fresh
from vialight.twin.scattering import Scattering

RESIN = Chemistry()
MU = 0.08


def lit(
    dose_mj_per_cm2: np.ndarray, seconds: float, resin: Chemistry = RESIN, *, step_s: float = 1.0, dark_s: float = 60.0,
    voxel_mm: float = 0.1,
) -> Cure:  # fmt: skip
    """Cure (z, y, x) doses that come evenly over a time, then wait in the dark."""
    dose = np.ascontiguousarray(np.moveaxis(np.asarray(dose_mj_per_cm2, np.float32), 0, 2))
    state = fresh(Grid(dose_mj_per_cm2.shape, voxel_mm), resin)
    steps = round(seconds / step_s)
    for _ in range(steps):
        state = cure(state, dose / np.float32(steps), step_s, resin, MU, voxel_mm)
    for _ in range(round(dark_s / step_s)):
        state = cure(state, np.zeros_like(dose), step_s, resin, MU, voxel_mm)
    return state


def test_resin_gels_at_its_critical_dose() -> None:
    critical = RESIN.critical_dose_mj_per_cm2(MU)
    doses = critical * np.array([0.995, 1.005]).reshape(2, 1, 1)
    conversion = lit(doses, 300.0, replace(RESIN, oxygen_diffusion_mm2_per_s=0.0)).conversion.ravel()
    assert conversion[0] < RESIN.gel_conversion < conversion[1]


def test_depth_of_cure_is_logarithmic_in_dose() -> None:
    """Jacobs: C_d = D_p ln(E / E_c), with D_p = 1 / mu."""
    voxel, still = 0.1, replace(RESIN, oxygen_diffusion_mm2_per_s=0.0)
    depth = (np.arange(150) + 0.5) * voxel
    doses = RESIN.critical_dose_mj_per_cm2(MU) * np.array([1.3, 1.6, 2.0, 2.5])
    found = []
    for dose in doses:
        conversion = lit(dose * np.exp(-MU * depth).reshape(-1, 1, 1), 100.0, still).conversion[0, 0]
        found.append(np.interp(-still.gel_conversion, -conversion, depth))
    slope, intercept = np.polyfit(np.log(doses), found, 1)
    assert slope == pytest.approx(1 / MU, rel=2e-3)
    assert np.exp(-intercept / slope) == pytest.approx(RESIN.critical_dose_mj_per_cm2(MU), rel=2e-3)


def test_conversion_depends_on_dose_and_not_on_its_rate() -> None:
    still, dose = replace(RESIN, oxygen_diffusion_mm2_per_s=0.0), np.full((1, 1, 1), 1200.0)
    slow, fast = (lit(dose, seconds, still).conversion.item() for seconds in (600.0, 60.0))
    assert slow == pytest.approx(fast, rel=1e-3)


def test_every_radical_takes_an_oxygen_or_is_trapped() -> None:
    """Before oxygen is gone, what is made is what oxygen has lost."""
    dose = 0.5 * RESIN.oxygen_mol_per_m3 / RESIN.radicals_per_mj(MU)
    state = lit(np.full((1, 1, 1), dose), 100.0)
    assert state.oxygen.item() == pytest.approx(0.5 * RESIN.oxygen_mol_per_m3, rel=1e-4)
    assert state.conversion.item() < 1e-4


def test_curing_goes_on_in_the_dark_for_as_long_as_radicals_live() -> None:
    dose = np.full((1, 1, 1), 1200.0)
    at_off, later, long_after = (lit(dose, 100.0, step_s=0.25, dark_s=dark) for dark in (0.0, 5.0, 50.0))
    gain = -np.log1p(-long_after.conversion) + np.log1p(-at_off.conversion)
    expected = RESIN.propagation_m3_per_mol_s * at_off.radicals / RESIN.radical_decay_per_s
    np.testing.assert_allclose(gain, expected, rtol=1e-3)
    assert later.radicals.item() == pytest.approx(
        at_off.radicals.item() * np.exp(-5.0 * RESIN.radical_decay_per_s), rel=0.03
    )


def test_oxygen_spreads_as_gauss_says_and_none_is_lost() -> None:
    voxel, time, diffusivity = 0.1, 200.0, 1e-3
    x = (np.arange(81) - 40) * voxel
    start = np.exp(-(x**2) / (2 * 0.4**2))
    field = (start[:, None, None] * start[None, :, None] * start[None, None, :]).astype(np.float32)
    after = diffused(field, diffusivity * time / voxel**2)
    assert after.sum(dtype=float) == pytest.approx(field.sum(dtype=float), rel=1e-5)
    variance = 0.4**2 + 2 * diffusivity * time
    expected = (0.4**2 / variance) ** 1.5 * np.exp(-(x**2) / (2 * variance))
    np.testing.assert_allclose(after[40, 40], expected, atol=4e-3 * expected.max())


def test_shorter_steps_change_little() -> None:
    dose = np.full((1, 1, 41), 1150.0)
    dose[:, :, 20:] = 300.0
    coarse, fine = (lit(dose, 300.0, step_s=step) for step in (2.0, 0.5))
    np.testing.assert_allclose(coarse.conversion, fine.conversion, atol=5e-4)


ASSUMED = [
    "oxygen_mol_per_m3", "oxygen_diffusion_mm2_per_s", "oxygen_rate_m3_per_mol_s", "quantum_yield",
    "propagation_m3_per_mol_s", "radical_decay_per_s", "gel_conversion", "activation_energy_j_per_mol", "sensitivity",
]  # fmt: skip


@pytest.mark.parametrize("factor", [0.5, 1.5])
@pytest.mark.parametrize("name", ASSUMED)
def test_thick_features_gel_before_thin_ones_of_the_same_dose(name: str, factor: float) -> None:
    """Walls 3, 0.35 and 0.15 mm thick get the same dose; oxygen from between them is all that tells them apart."""
    resin = replace(RESIN, **{name: getattr(RESIN, name) * factor})
    widths, voxel = (3.0, 0.35, 0.15), 0.05
    x = (np.arange(101) - 50) * voxel
    rate = 1.6 * resin.critical_dose_mj_per_cm2(MU) / 300
    dose = np.stack([np.where(np.abs(x) < width / 2, rate, 0.1 * rate) for width in widths]).astype(np.float32)
    gelled = []
    for wall in dose:
        state, seconds = fresh(Grid((1, 1, len(x)), voxel), resin), 0
        while state.conversion.max() < resin.gel_conversion:
            assert seconds < 1200
            state = cure(state, wall[None, :, None], 1.0, resin, MU, voxel)
            seconds += 1
        gelled.append(seconds)
    assert gelled[0] <= gelled[1] <= gelled[2]
    assert gelled[0] < gelled[2]


def test_a_warmer_or_livelier_resin_needs_less_dose() -> None:
    doses = [
        replace(RESIN, **change).critical_dose_mj_per_cm2(MU)
        for change in ({}, {"temperature_k": 305.15}, {"sensitivity": 1.2})
    ]
    assert doses[0] / doses[1] == pytest.approx(1.306, abs=1e-3)
    assert doses[0] / doses[2] == pytest.approx(1.2)


def test_resin_that_absorbs_nothing_never_gels() -> None:
    assert RESIN.critical_dose_mj_per_cm2(0.0) == float("inf")


@pytest.mark.parametrize(
    ("name", "value"), [("quantum_yield", 0.0), ("gel_conversion", 1.0), ("oxygen_mol_per_m3", -1.0)]
)
def test_impossible_constants_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        Chemistry(**{name: value})
    with pytest.raises(InputError, match="steepness"):
        Scattering(steepness=-1.0)


def test_scattering_is_steep_and_its_middle_is_its_own() -> None:
    scattering = Scattering(counts_per_mm=200.0, middle_conversion=0.16)
    low, middle, high = scattering.density(np.array([0.12, 0.16, 0.22], np.float32))
    assert low < 10
    assert middle == pytest.approx(100.0, rel=1e-5)
    assert high > 190
