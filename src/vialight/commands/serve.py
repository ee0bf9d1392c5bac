"""Serve the operator's page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from vialight.web import PageSettings, network_warning, serve


def serve_runs(
    root: str | Path,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    names: tuple[str, ...] = (),
    announce: Callable[[str], None],
    warn: Callable[[str], None],
) -> None:
    """Serve the page of a run, or of a folder of runs, until Ctrl-C.

    Parameters
    ----------
    root
        A run's folder (running or finished), or a folder of them.
    host, port, names
        See `vialight.web.PageSettings`.
    announce
        Called with the link to open.
    warn
        Called at once with what to know where others than this machine can reach the page.

    Raises
    ------
    InputError
        There is no such folder, or the address cannot be listened on.
    """
    settings = PageSettings(host, port, names)
    warning = network_warning(settings)
    if warning is not None:
        warn(warning)
    serve(root, settings, announce=announce)
