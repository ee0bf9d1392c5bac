"""What vialight raises when it cannot go on, and why, in one line."""

from __future__ import annotations


class VialightError(Exception):
    """Base of every error that vialight raises on purpose."""


class InputError(VialightError):
    """An input cannot be used: a file, a setting, or data that does not support an answer.

    Parameters
    ----------
    where
        The file, table or argument that is at fault, as the user named it.
    what
        What is wrong there, with the offending value.
    accepted
        What would have been accepted.
    remedy
        What to do about it.

    Examples
    --------
    >>> print(InputError("rig.toml [vial]", "outer_radius_mm is -3.0", accepted="a positive length", remedy="fix it"))
    rig.toml [vial]: outer_radius_mm is -3.0; accepted: a positive length; fix it
    """

    def __init__(self, where: object, what: str, *, accepted: str = "", remedy: str = "") -> None:
        parts = [f"{where}: {what}", f"accepted: {accepted}" if accepted else "", remedy]
        super().__init__("; ".join(" ".join(part.split()) for part in parts if part))


class VialightWarning(UserWarning):
    """Something a person should know about a result that is still given."""
