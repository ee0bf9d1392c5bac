"""Where and when a print began to fail: matter where none was meant, and none where it was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import label

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, Grid, IntArray

_TOUCHING = np.ones((3, 3, 3), np.int8)
_STALLED_SHARE = 0.1
"""Of the usual gain in a turn: what gains less has stopped."""
_BEGUN_SHARE = 0.2
"""Of I_p: what never had more has never gained."""
_LOST_SHARE = 0.9
"""Of I_p: what had gelled and then has less is lost."""
_SEEN_LATE_TURNS = 1.55
"""Density is the mean of a turn, and gain is over another: where growth ends at once, the gain is down to a tenth this
much later (2 - sqrt(0.2), as it falls with the square of what is left)."""
_FULLY_LIT_SHARE = 0.9


@dataclass(frozen=True)
class Failure:
    """Something that went wrong, when it was first so.

    Parameters
    ----------
    what
        In words.
    time_s
        Of the recording.
    at_mm
        (x, y, z) its middle then.
    size_mm3
        What it came to.
    """

    what: str
    time_s: float
    at_mm: tuple[float, float, float]
    size_mm3: float


class InsideHistory(NamedTuple):
    """Density over time of little cubes inside the part."""

    cells: IntArray
    """(cube, zyx) whole numbers: neighbours differ by one."""
    middles_mm: FloatArray
    """(cube, xyz)."""
    edge_mm: float
    density: Float32Array
    """(look, cube) mean over the cube, counts per mm, of the turn before."""
    time_s: FloatArray
    """(look,)."""
    lit_s: FloatArray
    """(look,) for how long light had been on."""
    looks_a_turn: int


def outside_failures(
    gel_time_s: Float32Array, grid: Grid, is_outside: BoolArray, least_mm3: float, most: int = 10
) -> list[Failure]:
    """Return what gelled where nothing should.

    Parameters
    ----------
    gel_time_s
        (z, y, x) when each voxel gelled; NaN where not.
    grid
        Its voxels.
    is_outside
        (z, y, x) beyond the tolerance.
    least_mm3
        Connected pieces that are smaller do not count.
    most
        Pieces told, the first ones.

    Examples
    --------
    >>> times = np.full((4, 4, 4), np.nan, np.float32)
    >>> times[0, 0, :3] = [5, 7, 9]
    >>> (found,) = outside_failures(times, Grid((4, 4, 4), 1.0), np.ones((4, 4, 4), bool), 2.0)
    >>> found.time_s, found.at_mm, found.size_mm3
    (7.0, (-1.0, -1.5, -1.5), 3.0)
    """
    count = max(1, int(np.ceil(least_mm3 / grid.voxel_mm**3 - 1e-9)))
    pieces, _ = label(np.isfinite(gel_time_s) & is_outside, _TOUCHING)
    sizes = np.bincount(pieces.ravel())
    found = []
    for number in np.flatnonzero(sizes >= count)[1 if sizes[0] >= count else 0 :]:
        piece = np.where(pieces == number, gel_time_s, np.float32(np.nan))
        time_s, first = _first_moment(piece, count)
        z, y, x = (float(axis[index].mean()) for axis, index in zip(
            (grid.z_mm, grid.y_mm, grid.x_mm), np.nonzero(first), strict=True))  # fmt: skip
        found.append(
            Failure("gelled outside the tolerance", time_s, (x, y, z), float(sizes[number]) * grid.voxel_mm**3)
        )
    return sorted(found, key=lambda one: one.time_s)[:most]


def _first_moment(gel_time_s: Float32Array, count: int) -> tuple[float, BoolArray]:
    """Return when a connected piece of so many voxels was first there, and that piece."""
    times = np.unique(gel_time_s[np.isfinite(gel_time_s)])
    low, high = 0, len(times) - 1
    while low < high:
        middle = (low + high) // 2
        if _largest(gel_time_s <= times[middle]).sum() >= count:
            high = middle
        else:
            low = middle + 1
    return float(times[low]), _largest(gel_time_s <= times[low])


def _largest(mask: BoolArray) -> BoolArray:
    pieces, _ = label(mask, _TOUCHING)
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    return np.asarray(pieces == sizes.argmax())


def stalled_failures(inside: InsideHistory, threshold: float, least_mm3: float, most: int = 10) -> list[Failure]:
    """Return regions inside that stopped gaining while there was light, never began to, or were lost.

    What gains less in a turn than a tenth of what gelled matter gained in its best turn has stopped; by how much later
    this is seen is known.

    Parameters
    ----------
    inside
        What was seen inside the part.
    threshold
        I_p.
    least_mm3
        Connected regions that are smaller do not count.
    most
        Regions told, the first ones.
    """
    density, turn = inside.density, inside.looks_a_turn
    if len(density) <= turn + 1:
        return []
    gain = density[turn:] - density[:-turn]
    lit_gain = inside.lit_s[turn:] - inside.lit_s[:-turn]
    turn_s = float(np.median(inside.time_s[turn:] - inside.time_s[:-turn]))
    is_lit = lit_gain >= _FULLY_LIT_SHARE * turn_s
    has_gelled = (density >= threshold).sum(axis=0) > turn
    onset = np.full(density.shape[1], -1)
    kind = np.zeros(density.shape[1], np.int8)
    lost = has_gelled & (density[-1] < _LOST_SHARE * threshold)
    kind[lost] = 3
    onset[lost] = len(density) - 1 - np.argmax(density[::-1, lost] >= threshold, axis=0)
    if is_lit.any() and has_gelled.any():
        usual = float(np.median(gain[:, has_gelled].max(axis=0)))
        last = int(np.flatnonzero(is_lit)[-1])
        # Since when it has not gained any more, as long as there was light.
        gained = (gain[: last + 1] >= _STALLED_SHARE * usual) & is_lit[: last + 1, None]
        since = last + 1 - np.argmax(gained[::-1], axis=0)
        since[~gained.any(axis=0)] = 0
        half_gelled = (density >= threshold).mean(axis=1) >= np.mean(has_gelled) / 2
        open_still = ~has_gelled & (density[last + turn] < threshold)
        stalled = open_still & (since <= last)
        kind[stalled], onset[stalled] = 1, np.maximum(since + turn - round(_SEEN_LATE_TURNS * turn), 0)[stalled]
        never = stalled & (density[: last + turn + 1].max(axis=0) < _BEGUN_SHARE * threshold)
        kind[never], onset[never] = 2, int(np.argmax(half_gelled))
    names = {1: "stopped gaining", 2: "never gained", 3: "gelled and was lost"}
    found = [one for number, name in names.items() for one in _regions(inside, kind == number, onset, name, least_mm3)]
    return sorted(found, key=lambda one: one.time_s)[:most]


def _regions(inside: InsideHistory, chosen: BoolArray, onset: IntArray, name: str, least_mm3: float) -> list[Failure]:
    """Put neighbours together, and tell those that are large enough."""
    if not chosen.any():
        return []
    cells = inside.cells - inside.cells.min(axis=0)
    room = np.zeros(cells.max(axis=0) + 1, np.bool_)
    room[tuple(cells[chosen].T)] = True
    pieces, _ = label(room, _TOUCHING)
    piece = np.where(chosen, pieces[tuple(cells.T)], 0)
    found = []
    cube_mm3 = inside.edge_mm**3
    count = max(1, int(np.ceil(least_mm3 / cube_mm3 - 1e-9)))
    for number in range(1, int(piece.max()) + 1):
        members = np.flatnonzero(piece == number)
        if len(members) < count:
            continue
        members = members[np.argsort(onset[members], kind="stable")]
        x, y, z = inside.middles_mm[members[:count]].mean(axis=0)
        time_s = float(inside.time_s[onset[members[count - 1]]])
        found.append(Failure(name, time_s, (float(x), float(y), float(z)), len(members) * cube_mm3))
    return found
