"""Volumes as OME-Zarr 0.5, which napari shows true to size.

Voxels are float32: the noise of a reconstruction is some 1e-2 of its values, single precision 1e-7 of them.  Shards
hold 16 slices each; they are compressed by blosc-lz4 with bit shuffle, which on noisy densities gains as much as zstd
in half the time.  zarr is imported when a volume is opened.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from vialight.core.arrays import Float32Array, Grid, Volume
from vialight.core.errors import InputError
from vialight.store.folders import staged_file, unwritable
from vialight.store.zarrs import attributes_of, read_stored, stored_image

_SHARD_SLICES = 16
_CHUNK_EDGE = 128
_WANTED = "a volume written by vialight: OME-Zarr 0.5, axes z y x in millimeter"


class VolumeWriter:
    """A volume that is written slice block by slice block and need never be in memory as a whole.

    Blocks may come in any order and of any size: slices wait in memory until their shard of 16 is complete, so that
    nothing is written twice.  Until it is closed, complete, the folder is not an image that `read_volume` takes.

    Parameters
    ----------
    path
        The zarr folder to make; an existing one is refused.
    grid
        Where the voxels lie.
    attributes
        More to be known of the volume, such as ``{"threshold": 100.0}``; plain JSON values, stored with the
        quantity and its unit under the key `vialight`.
    name
        What viewers call the image; the folder's name without suffix if not given.

    Raises
    ------
    InputError
        The path exists or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "volume.zarr"
    >>> with VolumeWriter(path, Grid((4, 3, 3), 0.1)) as writer:
    ...     writer[0:2] = np.zeros((2, 3, 3), np.float32)
    ...     writer[2:4] = np.ones((2, 3, 3), np.float32)
    >>> float(read_volume(path).density.sum())
    18.0
    """

    def __init__(
        self, path: str | Path, grid: Grid, attributes: Mapping[str, Any] | None = None, *, name: str | None = None
    ) -> None:
        import zarr

        self.path = Path(path)
        self.grid = grid
        self._attributes = described(name or self.path.stem, grid, dict(attributes or {}))
        self._waiting: dict[int, tuple[Float32Array, np.ndarray[Any, np.dtype[np.bool_]]]] = {}
        self._unwritten = set(range(-(-grid.shape[0] // _SHARD_SLICES)))
        if self.path.exists():
            raise InputError(self.path, "exists already", accepted="a new name", remedy="move it out of the way")
        try:
            self._group = zarr.create_group(self.path, zarr_format=3)
            self._array = create_array(self._group, grid, _SHARD_SLICES)
        except OSError as error:
            raise not_written(self.path, error) from error

    def __setitem__(self, slices: slice, block: Float32Array) -> None:
        """Write consecutive slices; `block` is (slice, y, x), counts per mm."""
        start, stop, step = slices.indices(self.grid.shape[0])
        if step != 1 or np.shape(block) != (stop - start, *self.grid.shape[1:]):
            raise InputError(
                f"slices {start}:{stop}:{step}", f"the block has the shape {np.shape(block)}",
                accepted=f"(slices, {self.grid.shape[1]}, {self.grid.shape[2]}), consecutive",
            )  # fmt: skip
        while start < stop:
            shard, offset = divmod(start, _SHARD_SLICES)
            end = min(stop, (shard + 1) * _SHARD_SLICES)
            self._add(shard, offset, block[: end - start])
            block, start = block[end - start :], end

    def _add(self, shard: int, offset: int, block: Float32Array) -> None:
        first = shard * _SHARD_SLICES
        depth = min(_SHARD_SLICES, self.grid.shape[0] - first)
        if len(block) < depth:
            if shard not in self._waiting:
                self._waiting[shard] = np.empty((depth, *self.grid.shape[1:]), np.float32), np.zeros(depth, np.bool_)
            slab, is_filled = self._waiting[shard]
            slab[offset : offset + len(block)] = block
            is_filled[offset : offset + len(block)] = True
            if not is_filled.all():
                return
            block = slab
        try:
            self._array[first : first + depth] = block
        except OSError as error:
            raise not_written(self.path, error) from error
        self._waiting.pop(shard, None)
        self._unwritten.discard(shard)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()

    def close(self) -> None:
        """Declare the volume complete; `ValueError` if slices were never written."""
        if self._unwritten:
            first = min(self._unwritten) * _SHARD_SLICES
            raise ValueError(f"{self.path}: not all of slices {first} to {first + _SHARD_SLICES - 1} were written")
        try:
            self._group.attrs.update(self._attributes)
        except OSError as error:
            raise not_written(self.path, error) from error


def write_volume(path: str | Path, volume: Volume, attributes: Mapping[str, Any] | None = None) -> None:
    """Write a volume; it appears when it is complete, and replaces a zarr of that name.

    Parameters
    ----------
    path
        The zarr folder to make.
    volume
        Density and grid.
    attributes
        As for `VolumeWriter`.

    Raises
    ------
    InputError
        The path is something else than a zarr, or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "volume.zarr"
    >>> write_volume(path, Volume(np.ones((2, 3, 3), np.float32), Grid((2, 3, 3), 0.1)), {"threshold": 0.5})
    >>> read_volume(path).grid
    Grid(shape=(2, 3, 3), voxel_mm=0.1, centre_z_mm=0.0)
    """
    path = Path(path)
    if path.exists() and not (path / "zarr.json").is_file():
        raise InputError(path, "exists and is not a zarr", accepted="a new name, or a zarr to replace")
    with (
        staged_file(path, folder=True) as unfinished,
        VolumeWriter(unfinished, volume.grid, attributes, name=path.stem) as writer,
    ):
        writer[:] = volume.density


def read_volume(path: str | Path) -> Volume:
    """Read a volume that vialight wrote.

    Parameters
    ----------
    path
        The zarr folder.

    Returns
    -------
    Volume
        Density in float32 and its grid.

    Raises
    ------
    InputError
        It is missing, is not a volume of vialight, was not finished, or is damaged.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, "there is no such folder", accepted=_WANTED, remedy="check the path")
    if not (path / "zarr.json").is_file():
        raise InputError(path, "is not a zarr of version 3 (it holds no zarr.json)", accepted=_WANTED)
    with damage_told(path):
        if "ome" not in attributes_of(path):
            raise InputError(
                path, "is not an image, or was never finished", accepted=_WANTED, remedy="reconstruct again"
            )
        image = stored_image(path, 3)
        grid = grid_of_image(path, image.attributes, image.shape)
        return Volume(read_stored(image), grid)


@contextmanager
def damage_told(path: Path) -> Iterator[None]:
    """Tell a zarr that cannot be read as damaged."""
    try:
        yield
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        RuntimeError,
        AttributeError,
        ArithmeticError,
    ) as error:
        raise InputError(
            path, f"is damaged ({type(error).__name__}: {error})", accepted=_WANTED, remedy="copy or make it again"
        ) from error


def create_array(group: Any, grid: Grid, shard_slices: int, moments: int | None = None) -> Any:
    """Make the array of an image.

    Parameters
    ----------
    group
        Open for writing.
    grid
        Of a volume.
    shard_slices
        Slices in a file.
    moments
        Volumes there is room for, along a first axis t; None for a single volume, without one.
    """
    from zarr.codecs import BloscCodec

    depth = min(_SHARD_SLICES, grid.shape[0])
    rows, columns = (_even_chunk(count) for count in grid.shape[1:])
    shard = tuple(
        edge * -(-min(most, count) // edge)
        for edge, most, count in zip((depth, rows, columns), (shard_slices, *grid.shape[1:]), grid.shape, strict=True)
    )
    over_time = () if moments is None else (1,)
    return group.create_array(
        "0",
        shape=grid.shape if moments is None else (moments, *grid.shape),
        dtype=np.float32,
        chunks=(*over_time, depth, rows, columns),
        shards=(*over_time, *shard),
        compressors=BloscCodec(typesize=4, cname="lz4", clevel=5, shuffle="bitshuffle"),
        dimension_names=tuple("zyx" if moments is None else "tzyx"),
        # A shard of zeros is written too, so that one that is missing was lost.
        config={"write_empty_chunks": True},
    )


def _even_chunk(count: int) -> int:
    """Divide `count` into equal chunks near the usual edge, so that little of the last one is padding."""
    return -(-count // -(-count // _CHUNK_EDGE))


def described(
    name: str, grid: Grid, attributes: dict[str, Any], over_time_s: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Return the attributes of an image; of one over time, begin and step are given."""
    axes = [{"name": axis, "type": "space", "unit": "millimeter"} for axis in "zyx"]
    scale, translation = [grid.voxel_mm] * 3, list(grid.origin_mm)
    if over_time_s is not None:
        axes.insert(0, {"name": "t", "type": "time", "unit": "second"})
        scale, translation = [over_time_s[1], *scale], [over_time_s[0], *translation]
    transforms = [{"type": "scale", "scale": scale}, {"type": "translation", "translation": translation}]
    multiscale = {"name": name, "axes": axes, "datasets": [{"path": "0", "coordinateTransformations": transforms}]}
    own = {"quantity": "scattering density", "unit": "counts per mm", "centre_z_mm": grid.centre_z_mm}
    return {"ome": {"version": "0.5", "multiscales": [multiscale]}, "vialight": own | attributes}


def grid_of_image(path: Path, attributes: dict[str, Any], shape: tuple[int, ...], *, over_time: bool = False) -> Grid:
    """Return the grid of an image; one that vialight does not have is refused."""
    (multiscale,) = attributes["ome"]["multiscales"]
    axes = [(axis["name"], axis.get("unit")) for axis in multiscale["axes"]]
    if axes != [("t", "second")] * over_time + [(axis, "millimeter") for axis in "zyx"]:
        raise InputError(path, f"has the axes {axes}", accepted=_WANTED)
    scale, translation = multiscale["datasets"][0]["coordinateTransformations"]
    voxel_mm, *others = scale["scale"][-3:]
    if not 0 < voxel_mm < np.inf or not min(shape[-3:]):
        raise InputError(path, f"has {shape[-3:]} voxels of {voxel_mm} mm", accepted=_WANTED)
    origin = np.array(translation["translation"][-3:], dtype=np.float64)
    # The translation holds the centre's height up to rounding; our own key holds it exactly.
    z, y, x = shape[-3:]
    derived = float(origin[0] - Grid((z, y, x), voxel_mm).origin_mm[0])
    centre_z_mm = float(attributes.get("vialight", {}).get("centre_z_mm", derived))
    grid = Grid((z, y, x), voxel_mm, centre_z_mm)
    if others != [voxel_mm, voxel_mm] or not np.allclose(origin, grid.origin_mm, rtol=0, atol=1e-6 * voxel_mm):
        raise InputError(
            path, f"has voxels of {scale['scale']} mm from {origin.tolist()} mm",
            accepted="cubic voxels, centred on the rotation axis in y and x",
        )  # fmt: skip
    return grid


def not_written(path: Path, error: OSError) -> Exception:
    """Return what to raise where a volume cannot be written."""
    # A full disk is told by whoever stages the output: only there is it known what became of it.
    return error if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) else unwritable(path, error)
