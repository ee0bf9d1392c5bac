"""The history of a print: about once a second, what was known of it, to scrub back through; and its surfaces.

One NumPy archive a moment, ``history/NNNNNN.npz``, numbered by the newest frame; each appears whole.  Images are kept
as float16 (three digits, which is more than a screen shows) and packed quickly rather than tightly, since the print
runs while they are written.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError
from vialight.store.folders import staged_file
from vialight.store.npy import opened_npz
from vialight.system import file_in, read_plain

_T = TypeVar("_T")

HISTORY = "history"
SURFACES = "surfaces"
_PLANES = ("xy", "xz", "yz")
_QUICK = 1
"""Of zlib's levels: a third of the time of the usual one, and 2 % more bytes."""
_MOST_MOMENT_BYTES = 100_000_000
"""Unpacked; a live volume with edges of 1000 voxels makes a quarter of it."""
_MOST_SURFACE_BYTES = 1_000_000_000
_MOST_HEAD_BYTES = 10_000
_END_OF_HEAD = b"end_header\n"
_NUMBER = re.compile("[0-9]{6,12}")
_LARGEST_HALF = float(np.finfo(np.float16).max)


class _Planes(Protocol):
    @property
    def xy(self) -> NDArray[Any]: ...
    @property
    def xz(self) -> NDArray[Any]: ...
    @property
    def yz(self) -> NDArray[Any]: ...


class _Forecast(Protocol):
    @property
    def stop_s(self) -> float: ...
    @property
    def sigma_s(self) -> float: ...


class _Moment(Protocol):
    @property
    def frames(self) -> int: ...
    @property
    def time_s(self) -> float: ...
    @property
    def voxel_mm(self) -> float: ...
    @property
    def centre_z_mm(self) -> float: ...
    @property
    def density(self) -> _Planes: ...
    @property
    def cured(self) -> _Planes: ...
    @property
    def cured_volume_mm3(self) -> float: ...


class _Measured(Protocol):
    @property
    def lit_s(self) -> float: ...
    @property
    def rmse_mm(self) -> float | None: ...
    @property
    def reverse_rmse_mm(self) -> float | None: ...
    @property
    def iou(self) -> float | None: ...
    @property
    def slices(self) -> _Planes: ...
    @property
    def gel_time_s(self) -> _Planes: ...
    @property
    def forecast(self) -> _Forecast | None: ...


class Planes(NamedTuple):
    """Images along z, y and x: (y, x), (z, x), (z, y); row 0 is the lowest coordinate of the first axis."""

    xy: FloatArray
    xz: FloatArray
    yz: FloatArray


@dataclass(frozen=True)
class HistoryNumbers:
    """The numbers of a moment; NaN where not known."""

    frames: int
    """Frames used by then."""
    time_s: float
    lit_s: float
    """For how long light had been on when the surface was measured."""
    cured_volume_mm3: float
    rmse_mm: float
    reverse_rmse_mm: float
    iou: float
    stop_s: float
    """Predicted end, as lit time."""
    sigma_s: float


@dataclass(frozen=True)
class HistoryMoment:
    """All that is kept of a moment."""

    numbers: HistoryNumbers
    voxel_mm: float
    centre_z_mm: float
    density: Planes
    """Sums of counts per mm along mm."""
    cured: Planes
    """Mm of path above the gelation threshold."""
    slices: Planes | None
    """Density in the middle planes, counts per mm; None before there was a surface."""
    gel_time_s: Planes | None
    """Mean gel time along each axis; NaN where nothing has gelled."""


def write_history(run: str | Path, moment: _Moment, measured: _Measured | None = None) -> Path:
    """Add a moment to a run's history.

    Parameters
    ----------
    run
        The run's folder; ``history`` in it is made where it is missing.
    moment
        A `vialight.core.messages.Snapshot`, or anything with its images and numbers.
    measured
        The newest `vialight.core.messages.SurfaceSnapshot`, or the like; None before there is one.

    Returns
    -------
    pathlib.Path
        The file made; NumPy reads it with the keys that `docs/run-folder.md` names.

    Raises
    ------
    InputError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from vialight.core.messages import Snapshot, Sums
    >>> image = Sums(*(np.ones((3, 4), np.float32),) * 3)
    >>> snapshot = Snapshot(180, 18.0, 0.0, 0.05, 10.0, 0.1, 0.0, image, image, 2.5, 0.0)
    >>> run = Path(tempfile.mkdtemp())
    >>> write_history(run, snapshot).name
    '000179.npz'
    >>> read_history(run, 179).numbers.cured_volume_mm3
    2.5
    """
    number = max(moment.frames - 1, 0)
    values: dict[str, float] = {name: getattr(moment, name) for name in ("frames", "time_s", "voxel_mm", "centre_z_mm")}
    values["cured_volume_mm3"] = moment.cured_volume_mm3
    images: dict[str, _Planes] = {"density": moment.density, "cured": moment.cured}
    forecast = None if measured is None else measured.forecast
    for name in ("lit_s", "rmse_mm", "reverse_rmse_mm", "iou"):
        values[name] = _known(getattr(measured, name, None))
    for name in ("stop_s", "sigma_s"):
        values[name] = _known(getattr(forecast, name, None))
    if measured is not None:
        images |= {"slice": measured.slices, "gel": measured.gel_time_s}
    folder = Path(run) / HISTORY
    folder.mkdir(exist_ok=True)
    path = folder / f"{number:06d}.npz"
    arrays: dict[str, NDArray[Any]] = {name: np.asarray(value) for name, value in values.items()}
    for kind, planes in images.items():
        arrays |= {f"{kind}_{plane}": _compact(getattr(planes, plane)) for plane in _PLANES}
    with staged_file(path) as unfinished:
        _save(unfinished, arrays)
    return path


def list_history(run: str | Path) -> list[int]:
    """Return the numbers of the moments that a run's history holds, ascending; none where there is no history.

    Examples
    --------
    >>> list_history("no such run")
    []
    """
    return _numbered(run, HISTORY, ".npz")


def _numbered(run: str | Path, name: str, suffix: str) -> list[int]:
    """Return the numbers of the files in a folder of a run whose names are those that this program gives."""
    try:
        names = [path.name for path in file_in(run, name).iterdir()]
    except (OSError, InputError):  # none there, or one that leads elsewhere
        return []
    stems = (one.removesuffix(suffix) for one in names if one.endswith(suffix))
    return sorted(int(stem) for stem in stems if _NUMBER.fullmatch(stem) and f"{int(stem):06d}" == stem)


def read_history(run: str | Path, number: int) -> HistoryMoment:
    """Read one moment.

    Raises
    ------
    InputError
        There is no such moment, or its file is damaged.
    """

    def read(held: Mapping[str, NDArray[Any]]) -> HistoryMoment:
        planes = {kind: _planes(held, kind) for kind in ("density", "cured", "slice", "gel")}
        density, cured = planes["density"], planes["cured"]
        voxel_mm, centre_z_mm = float(held["voxel_mm"]), float(held["centre_z_mm"])
        if density is None or cured is None:
            raise KeyError("density_xy")
        if not (0 < voxel_mm < np.inf and np.isfinite(centre_z_mm)):
            raise ValueError(f"voxels of {voxel_mm} mm about {centre_z_mm} mm")
        return HistoryMoment(_numbers(held), voxel_mm, centre_z_mm, density, cured, planes["slice"], planes["gel"])

    return _load(run, number, read)


def read_history_numbers(run: str | Path, number: int) -> HistoryNumbers:
    """Read the numbers of one moment alone, in about a millisecond.

    Raises
    ------
    InputError
        There is no such moment, or its file is damaged.
    """
    return _load(run, number, _numbers)


def _numbers(held: Mapping[str, NDArray[Any]]) -> HistoryNumbers:
    names = ("time_s", "lit_s", "cured_volume_mm3", "rmse_mm", "reverse_rmse_mm", "iou", "stop_s", "sigma_s")
    return HistoryNumbers(int(held["frames"]), *(float(held[name]) for name in names))


def _planes(held: Mapping[str, NDArray[Any]], kind: str) -> Planes | None:
    if f"{kind}_xy" not in held:
        return None
    planes = Planes(*(held[f"{kind}_{plane}"].astype(np.float64) for plane in _PLANES))
    if any(plane.ndim != 2 or not plane.size for plane in planes):
        raise ValueError(f"{kind} has images of {' and '.join(str(plane.shape) for plane in planes)}")
    return planes


class StoredSurface(NamedTuple):
    """A surface of a print as it was measured then."""

    vertices_mm: NDArray[np.float32]
    """(vertex, xyz)."""
    faces: NDArray[np.int32]
    """(face, corner)."""
    deviation_mm: NDArray[np.float32]
    """(vertex,); empty where there was no reference."""


def list_surfaces(run: str | Path) -> list[int]:
    """Return the numbers of the surfaces that a run holds, ascending; none where there are none.

    Examples
    --------
    >>> list_surfaces("no such run")
    []
    """
    return _numbered(run, SURFACES, ".ply")


def read_surface(run: str | Path, number: int) -> StoredSurface:
    """Read ``surfaces/NNNNNN.ply`` as `vialight.store.write_ply` wrote it, with its scalar ``deviation_mm``.

    Raises
    ------
    InputError
        There is no such surface, or its file is damaged or another program's.

    Examples
    --------
    >>> import tempfile
    >>> from vialight.core.mesh import Mesh
    >>> from vialight.store import write_ply
    >>> run = Path(tempfile.mkdtemp())
    >>> (run / "surfaces").mkdir()
    >>> triangle = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 1, 2]])
    >>> write_ply(run / "surfaces" / "000199.ply", triangle, {"deviation_mm": [0.5, 0.0, -0.5]})
    >>> read_surface(run, 199).deviation_mm.tolist()
    [0.5, 0.0, -0.5]
    """
    path = file_in(run, SURFACES, f"{number:06d}.ply")
    try:
        content = read_plain(path, _MOST_SURFACE_BYTES)
    except FileNotFoundError as error:
        raise InputError(path, "there is no such surface", accepted="a number that `list_surfaces` gives") from error
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", remedy="check the file") from error
    try:
        return _parse_ply(content)
    except (ValueError, KeyError, IndexError) as error:
        raise InputError(path, f"is damaged, or not written by vialight ({error})") from error


def _parse_ply(content: bytes) -> StoredSurface:
    end = content.find(_END_OF_HEAD, 0, _MOST_HEAD_BYTES)
    if end < 0:
        raise ValueError("no head of a PLY")
    lines = [line.split() for line in content[:end].decode("ascii").splitlines()]
    body = memoryview(content)[end + len(_END_OF_HEAD) :]
    if ["format", "binary_little_endian", "1.0"] not in lines:
        raise ValueError("no binary PLY")
    counts = {line[1]: int(line[2]) for line in lines if line[:1] == ["element"]}
    kinds = {"float": "<f4", "uchar": "u1"}
    columns = [(line[2], kinds[line[1]]) for line in lines if line[:1] == ["property"] and line[1] != "list"]
    if min(counts.values()) < 0:
        raise ValueError(f"counts of {counts}")
    vertices = np.frombuffer(body, np.dtype(columns), counts["vertex"])
    triangle = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    faces = np.frombuffer(body, triangle, counts["face"], vertices.nbytes)
    points, corners = np.stack([vertices[axis] for axis in "xyz"], axis=1), faces["corners"].copy()
    if not ((faces["count"] == 3).all() and ((corners >= 0) & (corners < len(points))).all()):
        raise ValueError("faces that are no triangles of its vertices")
    if not np.isfinite(points).all():
        raise ValueError("vertices that are nowhere")
    is_measured = "deviation_mm" in (vertices.dtype.names or ())
    deviation = vertices["deviation_mm"].copy() if is_measured else np.empty(0, np.float32)
    return StoredSurface(points, corners, deviation)


def _load(run: str | Path, number: int, read: Callable[[Mapping[str, NDArray[Any]]], _T]) -> _T:
    path = file_in(run, HISTORY, f"{number:06d}.npz")
    try:
        with opened_npz(path, most_bytes=_MOST_MOMENT_BYTES) as held:
            return read(held)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(path, "there is no such moment", accepted="a number that `list_history` gives") from error
    except Exception as error:  # zip and numpy fail in as many ways as files are broken
        raise InputError(path, f"is damaged, or no moment of a print ({type(error).__name__}: {error})") from error


def _known(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _compact(values: NDArray[Any]) -> NDArray[np.float16 | np.float32]:
    """Halve what halves can hold; a camera of 16 bits may sum to more."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    return values.astype(np.float16 if largest <= _LARGEST_HALF else np.float32)


def _save(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    # Not `numpy.savez_compressed`, whose level cannot be chosen; what it reads is the same.
    with zipfile.ZipFile(path, "x", zipfile.ZIP_DEFLATED, compresslevel=_QUICK) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
