"""Where an optimisation stood, to go on from."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vialight.errors import InputError
from vialight.store.folders import staged_file


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
    try:
        with np.load(path, allow_pickle=False) as held:
            state = SavedState(
                str(held["method"]), int(held["passes"]), held["model"], held["projections"], held["dose"]
            )
    except FileNotFoundError as error:
        raise InputError(path, "there is no such file", accepted="a state saved by plan --save-state") from error
    except Exception as error:  # zip and numpy fail in as many ways as files are broken
        raise InputError(
            path, f"is damaged, or no state ({type(error).__name__})", remedy="start without it"
        ) from error
    if state.method != method:
        raise InputError(
            path,
            f"was saved by the method {state.method}",
            accepted=method,
            remedy=f"resume with --method {state.method}",
        )
    if state.projections.shape != projections_shape or state.dose.shape != dose_shape:
        raise InputError(
            path, f"is of projections {state.projections.shape} and voxels {state.dose.shape}",
            accepted=f"{projections_shape} and {dose_shape}", remedy="resume with the part and settings of that run",
        )  # fmt: skip
    return state
