"""Rehearsals that are kept: the same plan, printer and resin need to be rehearsed once.

They lie in the user's cache folder (``$XDG_CACHE_HOME/vialight/rehearsals``, ``~/.cache`` where that is not set), named
by a hash of all that a rehearsal depends on, the code that computes it included.  Whatever differs is another name, so
that nothing kept is ever taken for something else; a file that cannot be read is made again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from vialight.control.rehearsed_model import stop_model_for
from vialight.control.stop_model import StopModel
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.plan import Plan
from vialight.store import read_json, rig_to_toml, write_json
from vialight.store.provenance import versions
from vialight.twin import ResinModel

_MODEL = ("twin", "control")
"""Of the package: what a rehearsal is computed by."""
_MOST = 100
"""Files that are kept; each has some 200 kB."""


def kept_stop_model(
    plan: Plan, rig: Rig, resin: ResinModel, *, voxel_mm: float = 0.2,
    progress: Callable[[int, int], None] | None = None,
) -> StopModel:  # fmt: skip
    """Return what `stop_model_for` returns, computed if it is not kept.

    Parameters
    ----------
    plan, rig, resin, voxel_mm, progress
        See `vialight.control.rehearsed_model.stop_model_for`.
    """
    path = _folder() / f"{rehearsal_key(plan, rig, resin, voxel_mm)}.json"
    with contextlib.suppress(InputError):
        return StopModel.from_json(read_json(path))
    model = stop_model_for(plan, rig, resin, voxel_mm=voxel_mm, progress=progress)
    with contextlib.suppress(InputError, OSError):  # a print needs no cache
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, model.to_json())
        for old in sorted(path.parent.glob("*.json"), key=lambda file: file.stat().st_mtime)[:-_MOST]:
            old.unlink()
    return model


def rehearsal_key(plan: Plan, rig: Rig, resin: ResinModel, voxel_mm: float) -> str:
    """Return the hash of all that a rehearsal depends on."""
    patterns, part = plan.patterns, plan.reference
    whole = hashlib.sha256()
    for array in (patterns.levels, patterns.angles_rad, part.vertices_mm, part.faces):
        whole.update(f"{array.shape} {array.dtype}\0".encode())
        whole.update(array.tobytes())
    words = (
        patterns.first_row, patterns.first_column, patterns.dose_rate_per_level, rig_to_toml(rig), resin, voxel_mm,
        versions(),
    )  # fmt: skip
    whole.update("\0".join(map(repr, words)).encode())
    for name in _MODEL:
        for source in _sources(files("vialight") / name):
            whole.update(source.read_bytes())
    return whole.hexdigest()


def _sources(place: Traversable) -> Iterator[Traversable]:
    if place.is_file():
        yield place
        return
    for entry in sorted(place.iterdir(), key=lambda item: item.name):
        if entry.name.endswith(".py"):
            yield entry


def _folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "vialight" / "rehearsals"
