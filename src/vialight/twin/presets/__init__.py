"""Resins and printers that come with vialight, as TOML."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from vialight.core.config import Resin, Rig
from vialight.core.errors import InputError
from vialight.store.rig_files import load_rig, read_toml
from vialight.twin.chemistry import Chemistry
from vialight.twin.scattering import Scattering
from vialight.twin.tables import from_table


@dataclass(frozen=True)
class ResinModel:
    """All that the twin knows of a resin.

    Parameters
    ----------
    optical
        Indices and absorption, as a rig states them.
    chemistry, scattering
        How it cures and how that looks.
    """

    optical: Resin
    chemistry: Chemistry
    scattering: Scattering

    def in_vial_of(self, rig: Rig) -> Rig:
        """Return the rig with this resin in its vial; thresholds, which belong to the camera, stay the rig's."""
        kept = {"threshold": rig.resin.threshold, "threshold_conditions": rig.resin.threshold_conditions}
        return rig.model_copy(update={"resin": self.optical.model_copy(update=kept)})

    @property
    def absorption_per_mm(self) -> float:
        """Napierian absorption at the writing wavelength."""
        assert self.optical.absorption_per_mm is not None  # load_resin has seen to it
        return self.optical.absorption_per_mm

    @property
    def gel_density(self) -> float:
        """Scattering density at the gel point, counts of an unbinned pixel per mm."""
        return float(self.scattering.density(np.array([self.chemistry.gel_conversion], np.float32))[0])


def resin_names() -> list[str]:
    """Return the resins that come with vialight.

    Examples
    --------
    >>> resin_names()
    ['BPAGDA', 'DUDMA']
    """
    return _names("resins")


def rig_names() -> list[str]:
    """Return the printers that come with vialight.

    Examples
    --------
    >>> rig_names()
    ['orth2022-145', 'orth2022-190']
    """
    return _names("rigs")


def load_resin(name: str | Path) -> ResinModel:
    """Read a resin: one of `resin_names`, or a TOML file of the same tables.

    Raises
    ------
    InputError
        There is no such resin, or the file holds unknown, missing or impossible values.

    Examples
    --------
    >>> load_resin("DUDMA").optical.index_writing
    1.49
    """
    table, where = _read(name, "resins", resin_names())
    unknown = sorted(set(table) - {"resin", "chemistry", "scattering"})
    if unknown:
        raise InputError(where, f"unknown key {unknown[0]}", accepted="[resin], [chemistry], [scattering]")
    try:
        optical = Resin.model_validate(table.get("resin", {}))
    except ValidationError as error:
        fault = error.errors()[0]
        raise InputError(
            f"{where} [resin]", f"{fault['loc'][0]} is {fault['input']!r}", accepted=fault["msg"], remedy="correct it"
        ) from error
    for key in ("index_imaging", "index_writing", "absorption_per_mm"):
        if getattr(optical, key) is None:
            raise InputError(f"{where} [resin]", f"key {key} is missing", remedy="add it")
    return ResinModel(
        optical,
        from_table(Chemistry, table.get("chemistry", {}), f"{where} [chemistry]"),
        from_table(Scattering, table.get("scattering", {}), f"{where} [scattering]"),
    )


def find_rig(name: str | Path) -> Rig:
    """Read a rig: a TOML file, or one of `rig_names`.

    Raises
    ------
    InputError
        There is no such rig, or the file cannot be used.

    Examples
    --------
    >>> find_rig("orth2022-145").need_camera().pixel_mm
    0.1125
    """
    return load_rig(rig_file(name))


def rig_file(name: str | Path) -> Path:
    """Return the file of a rig: the one of this name, or else that of a preset.

    Examples
    --------
    >>> rig_file("orth2022-145").name, rig_file("mine.toml").name
    ('orth2022-145.toml', 'mine.toml')
    """
    preset = files(__name__) / "rigs" / f"{name}.toml"
    return Path(name) if Path(name).exists() or not preset.is_file() else Path(str(preset))


def _names(kind: str) -> list[str]:
    return sorted(Path(entry.name).stem for entry in (files(__name__) / kind).iterdir() if entry.name.endswith(".toml"))


def _read(name: str | Path, kind: str, known: list[str]) -> tuple[dict[str, Any], str]:
    preset = files(__name__) / kind / f"{name}.toml"
    source: Traversable | Path = preset if preset.is_file() else Path(name)
    accepted = f"{', '.join(known)}, or a TOML file"
    return read_toml(source, accepted=accepted, remedy="check the name", name=name), str(name)
