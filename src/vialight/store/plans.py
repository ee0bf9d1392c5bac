"""Plans as HDF5: patterns, and all that they were computed from.

Patterns are compressed by blosc-lz4, as frames are: a plan is written and read in a fraction of a second where HDF5's
own gzip takes many; programs without blosc take the images that `export_png` writes.  The target is kept in float32:
its levels must come back exactly for a plan to be scored or computed again, and a part's inside compresses to nothing.
h5py and hdf5plugin are imported when a plan is written or read.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns, Plan
from vialight.store.folders import staged_file
from vialight.store.hdf5 import attribute, dataset_in, object_in
from vialight.store.results import parse_json, to_json
from vialight.store.rig_files import parse_toml
from vialight.store.rigs import rig_to_toml
from vialight.system import check_plain, need_memory

IMPLEMENTS = "vialight-plan"
SCHEMA = 1
_WANTED = "a plan, as `vialight plan` writes it"
_TARGET_SLICES = 16
_TABLES = ("settings", "metrics", "inputs")
_ARRAYS = {
    "patterns": ("u", 3),
    "angles_deg": ("iuf", 1),
    "target": ("f", 3),
    "reference/vertices_mm": ("iuf", 2),
    "reference/faces": ("iu", 2),
}
"""Kinds of number and count of axes of what is read whole."""
_COPIES = 1.5
"""Of its arrays that reading a plan needs, some for a while only."""
_MOST_PACKED = 260
"""Times that blosc packs what is all the same."""
_MOST_TEXT_BYTES = 1_000_000


def write_plan(path: str | Path, plan: Plan) -> None:
    """Write a plan; it appears whole, or not at all.

    Parameters
    ----------
    path
        The file to make: ``/patterns`` (angle, row, column), ``/angles_deg``, ``/target`` (z, y, x), ``/reference``
        with ``vertices_mm`` and ``faces``, ``/rig`` in TOML, ``/settings``, ``/metrics``, ``/inputs`` in JSON.
    plan
        What is not a finite number in its settings and metrics becomes null.

    Raises
    ------
    InputError
        The file cannot be written, or the plan's arrays do not fit each other.

    Examples
    --------
    >>> import tempfile
    >>> part = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> patterns = Patterns(np.full((4, 2, 3), 7, np.uint8), np.arange(4) * np.pi / 2, 10, 20, 0.002)
    >>> plan = Plan(patterns, part, np.zeros((2, 4, 4), np.float32), Grid((2, 4, 4), 0.1), Rig(), {"method": "osmo"})
    >>> path = Path(tempfile.mkdtemp()) / "plan.h5"
    >>> write_plan(path, plan)
    >>> read_plan(path).settings, read_plan(path).patterns.levels.shape
    ({'method': 'osmo'}, (4, 2, 3))
    """
    import h5py
    import hdf5plugin

    patterns, grid = plan.patterns, plan.grid
    _check(path, patterns, plan.target, grid)
    _, rows, columns = patterns.levels.shape
    blosc = hdf5plugin.Blosc(cname="lz4", clevel=5, shuffle=hdf5plugin.Blosc.SHUFFLE)
    packed = {"fletcher32": True, **blosc}  # with a checksum: what is damaged must not be printed
    with staged_file(path) as unfinished, h5py.File(unfinished, "x") as file:
        file["implements"], file["schema"] = IMPLEMENTS, SCHEMA
        levels = file.create_dataset("patterns", data=patterns.levels, chunks=(1, rows, columns), **packed)
        levels.attrs.update(
            axes="angle:row:column", first_row=patterns.first_row, first_column=patterns.first_column,
            dose_rate_per_level=patterns.dose_rate_per_level,
        )  # fmt: skip
        file["angles_deg"] = np.rad2deg(patterns.angles_rad)
        file["angles_deg"].attrs["units"] = "deg"
        chunks = (min(_TARGET_SLICES, grid.shape[0]), *grid.shape[1:])
        target = file.create_dataset("target", data=plan.target, chunks=chunks, **packed)
        target.attrs.update(axes="z:y:x", voxel_mm=grid.voxel_mm, centre_z_mm=grid.centre_z_mm)
        reference = file.create_group("reference")
        reference.create_dataset("vertices_mm", data=plan.reference.vertices_mm, chunks=True, **packed)
        reference.create_dataset("faces", data=plan.reference.faces, chunks=True, **packed)
        file["rig"] = rig_to_toml(plan.rig)
        for name in _TABLES:
            file[name] = to_json(getattr(plan, name))


def read_plan(path: str | Path) -> Plan:
    """Read a plan as it was written; its angles to the last bit or the one before, for files hold degrees.

    Raises
    ------
    InputError
        The file is missing, is no plan, is of a newer schema, or is damaged.
    """
    path = Path(path)
    with _open(path) as file, _explained(path):
        _check_kind(path, file)
        arrays = {name: _array(path, file, name, *kind) for name, kind in _ARRAYS.items()}
        needed_bytes = _COPIES * sum(array.size * array.dtype.itemsize for array in arrays.values())
        need_memory(needed_bytes, path, "this plan", "plan with fewer --angles or a coarser --voxel")
        levels, target = arrays["patterns"], arrays["target"]
        voxel_mm, centre_z_mm, rate = (
            float(attribute(path, of, name))
            for of, name in ((target, "voxel_mm"), (target, "centre_z_mm"), (levels, "dose_rate_per_level"))
        )
        if not (0 < voxel_mm < np.inf and np.isfinite(centre_z_mm) and 0 < rate < np.inf):
            raise ValueError(f"voxels of {voxel_mm} mm about {centre_z_mm} mm, {rate} a level")
        first_row, first_column = (int(attribute(path, levels, name)) for name in ("first_row", "first_column"))
        z, y, x = target.shape
        plan = Plan(
            Patterns(levels[:], np.deg2rad(arrays["angles_deg"][:]), first_row, first_column, rate),
            Mesh(arrays["reference/vertices_mm"][:], arrays["reference/faces"][:]),
            target[:],
            Grid((z, y, x), voxel_mm, centre_z_mm),
            Rig.model_validate(parse_toml(_text(path, file, "rig"), "/rig") | {"source": f"{path} /rig"}),
            *(parse_json(_text(path, file, name), f"/{name}") for name in _TABLES),
        )
        _check(path, plan.patterns, plan.target, plan.grid)
    return plan


def _array(path: Path, file: Any, name: str, kinds: str, axes: int) -> Any:
    """Return a dataset of a plan, which states no more than is there and has as many axes as it should."""
    found = dataset_in(path, file, name, most_packed=_MOST_PACKED)
    if found is None:
        raise KeyError(name)
    if found.dtype.kind not in kinds or found.ndim != axes:
        raise ValueError(f"/{name} is {found.dtype} of shape {found.shape}")
    return found


def _check(path: str | Path, patterns: Patterns, target: NDArray[Any], grid: Grid) -> None:
    levels, angles = patterns.levels, patterns.angles_rad
    if levels.ndim != 3 or not levels.size or levels.dtype != np.uint8:
        raise InputError(
            f"{path} /patterns", f"is {levels.dtype} of shape {levels.shape}", accepted="uint8 (angle, row, column)"
        )
    if angles.shape != levels.shape[:1] or not np.isfinite(angles).all():
        raise InputError(
            f"{path} /angles_deg", f"{angles.size} angles for {len(levels)} patterns, or not finite",
            accepted="a finite angle for each",
        )  # fmt: skip
    if target.shape != grid.shape or target.dtype != np.float32 or not target.size:
        raise InputError(
            f"{path} /target", f"is {target.dtype} of shape {target.shape}", accepted=f"float32 of shape {grid.shape}"
        )


def _open(path: Path) -> Any:
    import h5py
    import hdf5plugin  # noqa: F401  importing it registers its filters

    try:
        check_plain(path)
        return h5py.File(path, "r")
    except FileNotFoundError as error:
        raise InputError(path, "there is no such file", accepted=_WANTED, remedy="check the path") from error
    except IsADirectoryError as error:
        raise InputError(path, "is a folder", accepted=_WANTED, remedy="name the file in it") from error
    except OSError as error:
        if "signature not found" in str(error):
            raise InputError(path, "is not HDF5", accepted=_WANTED, remedy="check the path") from error
        raise _damaged(path, error) from error


def _check_kind(path: Path, file: Any) -> None:
    kind = _text(path, file, "implements") if object_in(path, file, "implements") is not None else ""
    if kind != IMPLEMENTS:
        what = f"implements {kind!r}" if kind else "is HDF5, but does not say of what kind"
        raise InputError(path, f"is not a plan: it {what}", accepted=_WANTED, remedy="check the path")
    stated = dataset_in(path, file, "schema")
    schema = 0 if stated is None or stated.shape != () else int(stated[()])
    if schema != SCHEMA:
        raise InputError(
            path, f"is a plan of schema {schema}", accepted=f"schema {SCHEMA}",
            remedy="use the vialight that wrote it, or plan again",
        )  # fmt: skip


def _text(path: Path, file: Any, name: str) -> str:
    found = dataset_in(path, file, name)
    if found is None or found.shape != () or found.dtype.itemsize > _MOST_TEXT_BYTES:
        raise ValueError(f"/{name} is no text")
    return str(found.asstr()[()])


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError, OverflowError, InputError) as error:
        if str(error).startswith(str(path)):
            raise
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(
        path, f"is damaged or cut off ({type(error).__name__}: {error})", accepted=_WANTED,
        remedy="copy it again, or plan again",
    )  # fmt: skip
