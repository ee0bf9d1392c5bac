"""Where an optimisation stood, to go on from."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import InputError
from vialight.store.folders import staged_file
from vialight.store.npy import opened_npz

_MOST_BYTES = 1 << 40


class SavedState(NamedTuple):
    """The method, the passes done, and what the method carries on: its model, projections and dose."""

    method: str
    passes: int
    model: NDArray[np.float32]
    projections: NDArray[np.float32]
    dose: NDArray[np.float32]


def write_state(path: str | Path, state: SavedState) -> None:
    """Write a state; it appears whole, or not at all."""
    with staged_file(path) as staging, staging.open("wb") as file:
        np.savez(
            file,
            method=state.method,
            passes=state.passes,
            model=state.model,
            projections=state.projections,
            dose=state.dose,
        )


def read_state(
    path: str | Path, method: str, projections_shape: tuple[int, ...], dose_shape: tuple[int, ...]
) -> SavedState:
    """Read a state that fits a target and a light.

    Raises
    ------
    InputError
        The file is missing or damaged, or belongs to another method, part, grid or count of angles.
    """
    path = Path(path)
    shapes = {
        "projections": projections_shape,
        "dose": dose_shape,
        "model": {"object-space": (2, *dose_shape), "gradient": projections_shape}.get(method, dose_shape),
    }
    try:
        with opened_npz(path, most_bytes=_MOST_BYTES) as held:
            of_method, passes = str(held["method"]), int(held["passes"])
            found = {name: held.shape(name) for name in shapes}
            fits = of_method == method and found == shapes
            arrays = {name: held[name].astype(np.float32, copy=False) for name in shapes} if fits else {}
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(path, "there is no such file", accepted="a state saved by plan --save-state") from error
    except Exception as error:  # zip and numpy fail in as many ways as files are broken
        raise InputError(
            path, f"is damaged, or no state ({type(error).__name__})", remedy="start without it"
        ) from error
    if of_method != method:
        told = f"was saved by the method {of_method[:40]}"
        raise InputError(path, told, accepted=method, remedy=f"resume with --method {of_method[:40]}")
    if not fits:
        told = f"is of projections {found['projections']} and voxels {found['dose']}"
        accepted = f"{projections_shape} and {dose_shape}"
        raise InputError(path, told, accepted=accepted, remedy="resume with the part and settings of that run")
    if passes < 0 or not all(np.isfinite(array).all() for array in arrays.values()):
        raise InputError(path, "holds values that are not finite", remedy="start without it")
    return SavedState(method, passes, arrays["model"], arrays["projections"], arrays["dose"])
