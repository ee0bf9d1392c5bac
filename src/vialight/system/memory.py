"""How much memory is free, asked before it is taken."""

from __future__ import annotations

import psutil

from vialight.core.errors import InputError

_LEFT_BYTES = 200_000_000
"""That stay for everything else."""
SMALL_BYTES = 50_000_000
"""For which it is not worth asking."""


def need_memory(needed_bytes: float, where: object, what: str, remedy: str) -> None:
    """Refuse to take more memory than there is.

    Parameters
    ----------
    needed_bytes
        What is about to be taken.
    where, what, remedy
        Of the error: what asks for it, what it is for, what to do.

    Raises
    ------
    InputError
        There is not so much.

    Examples
    --------
    >>> need_memory(1000, "frames.h5", "a block of frames", "read fewer")
    >>> need_memory(1e18, "frames.h5", "a block of frames", "read fewer")
    Traceback (most recent call last):
        ...
    vialight.core.errors.InputError: ...
    """
    if needed_bytes <= SMALL_BYTES:
        return
    free_bytes = psutil.virtual_memory().available
    if needed_bytes > free_bytes - _LEFT_BYTES:
        raise InputError(
            where,
            f"{what} needs {needed_bytes / 1e9:.3g} GB of memory, and {free_bytes / 1e9:.3g} GB are free",
            accepted="what fits into memory",
            remedy=remedy,
        )
