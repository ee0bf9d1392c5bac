"""What every result says of its origin."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

from vialight import __version__
from vialight.store.results import sha256_of

_NAMED_VERSIONS = ("numpy", "numba", "scipy", "libigl", "vtk", "zarr", "h5py")


def versions() -> dict[str, str]:
    """Return the versions of vialight, Python and the parts that numbers depend on."""
    return {"vialight": __version__, "python": platform.python_version()} | {
        name: version(name) for name in _NAMED_VERSIONS
    }


def inputs_json(**paths: str | Path) -> dict[str, dict[str, str]]:
    """Return role to name and SHA-256 of each input."""
    return {role: {"file": Path(path).name, "sha256": sha256_of(path)} for role, path in paths.items()}
