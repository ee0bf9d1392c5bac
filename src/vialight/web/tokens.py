"""A secret for each run, kept where only its owner reads it: pages stay let in when the server is started again."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
from pathlib import Path

_BYTES = 32


def token_for(root: Path) -> str:
    """Return the token of a run's folder (or folder of runs), made at random when it is first asked for.

    It lies outside the folder, which people copy and share; where that cannot be written, each server has its own.

    Examples
    --------
    >>> len(token_for(Path("no such run"))) >= 43
    True
    """
    name = hashlib.sha256(os.fsencode(Path(root).resolve())).hexdigest()[:32]
    path = _state_folder() / name
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        kept = _read(path)
        if kept is not None:
            return kept
        fresh = secrets.token_urlsafe(_BYTES)
        path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(fresh)
        return fresh
    return secrets.token_urlsafe(_BYTES)


def _read(path: Path) -> str | None:
    """Return a token that nobody else can have read or put there."""
    try:
        about = path.lstat()
        if path.is_symlink() or about.st_uid != os.getuid() or about.st_mode & 0o077:
            return None
        text = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return None
    return text if len(text) >= _BYTES else None


def _state_folder() -> Path:
    base = os.environ.get("XDG_STATE_HOME")
    return (
        (Path(base) if base and Path(base).is_absolute() else Path.home() / ".local" / "state") / "vialight" / "pages"
    )
