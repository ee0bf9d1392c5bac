"""Curing: radicals made by light, oxygen that takes them, monomer that they convert, voxel by voxel.

    dR/dt = s phi mu E / W  -  k_O O R  -  k_d R        radicals
    dO/dt = D laplace(O)    -  k_O O R                  oxygen
    dc/dt = k_p R (1 - c)                               conversion

E is the irradiance in the resin, mu E what it takes out of it per volume, W the energy of a mole of photons.
Termination is of first order: in the networks of dimethacrylates radicals are trapped rather than meet, and only then
does conversion depend on dose and not on how fast it came, which Jacobs' working curve takes for granted.  As long as
there is oxygen, it takes nearly every radical; it flows in from where no light falls, which is why thin features gel
after thick ones.  Radicals outlive the light by 1/k_d, which is the dark cure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, Grid
from vialight.core.compiling import FAST_MATH
from vialight.core.errors import InputError

GAS_CONSTANT_J_PER_MOL_K = 8.314462618
PHOTON_ENERGY_J_PER_MOL = 6.62607015e-34 * 299792458.0 * 6.02214076e23 / 460e-9
"""Of light of 460 nm, h c N_A / lambda: 260 kJ/mol."""

_ABSORBED_W_PER_M3 = 1e4
"""mW/cm^2 per mm is this many W/m^3."""


@dataclass(frozen=True)
class Chemistry:
    """Constants of a resin; every default is assumed, of the order found in the sources that ``docs/twin.md`` names.

    Parameters
    ----------
    oxygen_mol_per_m3
        O_0, dissolved in resin that stood in air.
    oxygen_diffusion_mm2_per_s
        D, of oxygen in the resin.
    oxygen_rate_m3_per_mol_s
        k_O, oxygen taking a radical.
    quantum_yield
        phi, radicals per absorbed photon.
    propagation_m3_per_mol_s
        k_p, a radical adding a double bond.
    radical_decay_per_s
        k_d, radicals being trapped; 1/k_d is how long they outlive the light.
    gel_conversion
        Conversion at which the resin is a solid.
    sensitivity
        s, of the lot: how much faster than nominal it makes radicals.
    temperature_k, reference_temperature_k, activation_energy_j_per_mol
        Scale the sensitivity by ``exp(E_a / R (1/T_0 - 1/T))``.
    linear_shrinkage
        By which share lengths shrink at full conversion.

    Raises
    ------
    InputError
        A constant is negative, not finite, or a share above 1.

    Examples
    --------
    >>> round(Chemistry().critical_dose_mj_per_cm2(0.08))
    962
    """

    oxygen_mol_per_m3: float = 1.0
    oxygen_diffusion_mm2_per_s: float = 3e-5
    oxygen_rate_m3_per_mol_s: float = 5e5
    quantum_yield: float = 0.5
    propagation_m3_per_mol_s: float = 0.04
    radical_decay_per_s: float = 0.15
    gel_conversion: float = 0.12
    sensitivity: float = 1.0
    temperature_k: float = 295.15
    reference_temperature_k: float = 295.15
    activation_energy_j_per_mol: float = 20e3
    linear_shrinkage: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            share = name in ("gel_conversion", "linear_shrinkage")
            may_be_zero = name in (
                "oxygen_mol_per_m3", "oxygen_diffusion_mm2_per_s", "activation_energy_j_per_mol", "linear_shrinkage"
            )  # fmt: skip
            if not (np.isfinite(value) and (value > 0 or (may_be_zero and value == 0)) and not (share and value >= 1)):
                accepted = ("0 or more" if may_be_zero else "more than 0") + (", less than 1" if share else "")
                raise InputError("chemistry", f"{name} is {value}", accepted=accepted, remedy="correct it")

    def radicals_per_mj(self, absorption_per_mm: float) -> float:
        """Return the radicals, mol/m^3, that each mJ/cm^2 of dose makes."""
        warmth = self.activation_energy_j_per_mol / GAS_CONSTANT_J_PER_MOL_K
        speed = self.sensitivity * np.exp(warmth * (1 / self.reference_temperature_k - 1 / self.temperature_k))
        absorbed = absorption_per_mm * _ABSORBED_W_PER_M3
        return float(speed * self.quantum_yield * absorbed / PHOTON_ENERGY_J_PER_MOL)

    def critical_dose_mj_per_cm2(self, absorption_per_mm: float) -> float:
        """Return the dose, in the resin, after which it gels when no oxygen flows in.

        All oxygen must be taken first, then ``k_p`` times the radicals' time must reach ``-ln(1 - c_gel)``; infinite
        for a resin that absorbs nothing.
        """
        needed = self.oxygen_mol_per_m3 - np.log1p(-self.gel_conversion) * (
            self.radical_decay_per_s / self.propagation_m3_per_mol_s
        )
        made = self.radicals_per_mj(absorption_per_mm)
        return float(needed / made) if made > 0 else float("inf")


@dataclass(frozen=True)
class Cure:
    """How far a volume has cured.

    Parameters
    ----------
    oxygen, radicals
        (y, x, z) float32, mol/m^3.
    conversion
        (y, x, z) float32, share of the double bonds that have reacted.
    """

    oxygen: Float32Array
    radicals: Float32Array
    conversion: Float32Array


def fresh(grid: Grid, chemistry: Chemistry) -> Cure:
    """Return resin that no light has reached."""
    shape = (grid.shape[1], grid.shape[2], grid.shape[0])
    oxygen = np.full(shape, chemistry.oxygen_mol_per_m3, np.float32)
    return Cure(oxygen, np.zeros(shape, np.float32), np.zeros(shape, np.float32))


def cure(
    state: Cure,
    dose_mj_per_cm2: Float32Array,
    duration_s: float,
    chemistry: Chemistry,
    absorption_per_mm: float,
    voxel_mm: float,
) -> Cure:
    """Let light act for a while.

    Radicals and oxygen react in one backward Euler step, which takes and leaves as many of both whatever its length;
    oxygen diffuses in explicit steps, as many as stability asks for.  Nothing diffuses through the grid's faces.

    Parameters
    ----------
    state
        Before.
    dose_mj_per_cm2
        (y, x, z) float32, light received meanwhile; 0 in the dark.
    duration_s
        How long; the change of the light and 1/k_d should be slower.
    chemistry
        The resin's constants.
    absorption_per_mm
        mu at 460 nm.
    voxel_mm
        Edge of a voxel.

    Returns
    -------
    Cure
        After.

    Examples
    --------
    >>> resin = Chemistry()
    >>> state = fresh(Grid((1, 1, 1), 0.1), resin)
    >>> for _ in range(80):
    ...     state = cure(state, np.full((1, 1, 1), 12.0, np.float32), 5.0, resin, 0.08, 0.1)
    >>> state.conversion.round(2).ravel()  # after 960 mJ/cm^2; the last radicals have still to act
    array([0.11], dtype=float32)
    """
    oxygen = diffused(state.oxygen, chemistry.oxygen_diffusion_mm2_per_s * duration_s / voxel_mm**2)
    radicals, conversion = np.empty_like(oxygen), np.empty_like(oxygen)
    _react(
        oxygen.reshape(-1), state.radicals.reshape(-1), state.conversion.reshape(-1), dose_mj_per_cm2.reshape(-1),
        chemistry.radicals_per_mj(absorption_per_mm), duration_s * chemistry.radical_decay_per_s,
        duration_s * chemistry.oxygen_rate_m3_per_mol_s, duration_s * chemistry.propagation_m3_per_mol_s,
        radicals.reshape(-1), conversion.reshape(-1),
    )  # fmt: skip
    return Cure(oxygen, radicals, conversion)


def diffused(field: Float32Array, steps_squared: float) -> Float32Array:
    """Return a copy of a field after diffusion by ``D t / voxel^2``, in as many explicit steps as are stable."""
    field = field.copy()
    count = int(np.ceil(8 * steps_squared))  # stable up to 1/6; at 1/8 a chequered field also dies out
    for _ in range(count):
        after = np.empty_like(field)
        _diffuse(field, steps_squared / count, after)
        field = after
    return field


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _diffuse(field: Float32Array, share: float, after: Float32Array) -> None:
    rows, columns, depth = field.shape
    w = np.float32(share)
    for iy in prange(rows):
        before_y, after_y = max(iy - 1, 0), min(iy + 1, rows - 1)
        for ix in range(columns):
            before_x, after_x = max(ix - 1, 0), min(ix + 1, columns - 1)
            for iz in range(depth):
                here = field[iy, ix, iz]
                around = (
                    field[before_y, ix, iz] + field[after_y, ix, iz] + field[iy, before_x, iz] + field[iy, after_x, iz]
                )
                around += field[iy, ix, max(iz - 1, 0)] + field[iy, ix, min(iz + 1, depth - 1)]
                after[iy, ix, iz] = here + w * (around - np.float32(6) * here)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _react(
    oxygen: Float32Array, radicals: Float32Array, conversion: Float32Array, dose: Float32Array,
    made_per_dose: float, decay: float, taken: float, converted: float,
    radicals_after: Float32Array, conversion_after: Float32Array,
) -> None:  # fmt: skip
    """Step ``R + decay R + taken O' R = made`` with ``O' = O / (1 + taken R)``: a quadratic in R."""
    one, two, four = np.float32(1), np.float32(2), np.float32(4)
    a, b, per_dose, rate = np.float32(1 + decay), np.float32(taken), np.float32(made_per_dose), np.float32(converted)
    for i in prange(len(oxygen)):
        made = radicals[i] + per_dose * dose[i]
        p = a + b * (oxygen[i] - made)
        root = np.sqrt(p * p + four * a * b * made)
        # The form of the root that subtracts nothing.
        r = two * made / (p + root) if p > 0 else (root - p) / (two * a * b)
        oxygen[i] = oxygen[i] / (one + b * r)
        radicals_after[i] = r
        conversion_after[i] = one - (one - conversion[i]) * np.exp(-rate * r)
