"""Plans as HDF5: patterns, and all that they were computed from.

Patterns are compressed by blosc-lz4, as frames are: a plan is written and read in a fraction of a second where HDF5's
own gzip takes many; programs without blosc take the images that `export_png` writes.  The target is kept in float32:
its levels must come back exactly for a plan to be scored or computed again, and a part's inside compresses to nothing.
h5py and hdf5plugin are imported when a plan is written or read.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.arrays import Grid
from vialight.config import Rig
from vialight.errors import InputError
from vialight.mesh import Mesh
from vialight.plan import Patterns, Plan
from vialight.store.folders import staged_file
from vialight.store.results import to_json
from vialight.store.rigs import rig_to_toml

IMPLEMENTS = "vialight-plan"
SCHEMA = 1
_WANTED = "a plan, as `vialight plan` writes it"
_TARGET_SLICES = 16
_TABLES = ("settings", "metrics", "inputs")


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
        levels, target, reference = file["patterns"], file["target"], file["reference"]
        voxel_mm, centre_z_mm = (float(target.attrs[name]) for name in ("voxel_mm", "centre_z_mm"))
        z, y, x = target.shape
        patterns = Patterns(
            levels[:], np.deg2rad(file["angles_deg"][:]), int(levels.attrs["first_row"]),
            int(levels.attrs["first_column"]), float(levels.attrs["dose_rate_per_level"]),
        )  # fmt: skip
        plan = Plan(
            patterns,
            Mesh(reference["vertices_mm"][:], reference["faces"][:]),
            target[:],
            Grid((z, y, x), voxel_mm, centre_z_mm),
            Rig.model_validate(tomllib.loads(_text(file, "rig")) | {"source": f"{path} /rig"}),
            *(json.loads(_text(file, name)) for name in _TABLES),
        )
        _check(path, plan.patterns, plan.target, plan.grid)
    return plan


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
    kind = _text(file, "implements") if "implements" in file else ""
    if kind != IMPLEMENTS:
        what = f"implements {kind!r}" if kind else "is HDF5, but does not say of what kind"
        raise InputError(path, f"is not a plan: it {what}", accepted=_WANTED, remedy="check the path")
    schema = int(file["schema"][()])
    if schema != SCHEMA:
        raise InputError(
            path, f"is a plan of schema {schema}", accepted=f"schema {SCHEMA}",
            remedy="use the vialight that wrote it, or plan again",
        )  # fmt: skip


def _text(file: Any, name: str) -> str:
    return str(file[name].asstr()[()])


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError, InputError) as error:
        if str(error).startswith(str(path)):
            raise
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(
        path, f"is damaged or cut off ({type(error).__name__}: {error})", accepted=_WANTED,
        remedy="copy it again, or plan again",
    )  # fmt: skip
