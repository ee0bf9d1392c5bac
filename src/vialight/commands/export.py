"""Patterns for printers that show images or play video."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vialight.store import export_mp4, export_png, read_plan


def export_plan(plan_path: str | Path, out: str | Path, *, turns: float = 1.0) -> dict[str, Any]:
    """Write a plan's patterns as video, where `out` ends in ``.mp4``, else as a folder of PNG images.

    Parameters
    ----------
    plan_path
        The plan.
    out
        Video or folder.
    turns
        Of the video.

    Returns
    -------
    dict
        ``file`` or ``folder``, and the count of ``images``.

    Raises
    ------
    InputError
        The plan cannot be read, or `out` cannot be written.
    """
    plan, out = read_plan(plan_path), Path(out)
    if out.suffix.lower() == ".mp4":
        return {"file": str(out), "images": export_mp4(plan, out, turns=turns)}
    export_png(plan, out)
    return {"folder": str(out), "images": len(plan.patterns.levels)}
