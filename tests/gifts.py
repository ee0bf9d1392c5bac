"""A folder from someone else, which runs code where Python takes modules from it."""

from __future__ import annotations

from pathlib import Path


def trapped(folder: Path) -> Path:
    """Put modules by the names of Python's own into a folder; return the file that is there once one was run."""
    marker = folder / "was-run"
    for name in ("json", "pickle"):
        (folder / f"{name}.py").write_text(f"open({str(marker)!r}, 'a').write('{name} ')\n")
    return marker
