"""How another process of the same user finds a running print: a private file in the run's folder."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

_NAME = "live.json"


@dataclass(frozen=True)
class LiveLink:
    """Where a running print can be reached.

    Parameters
    ----------
    pid
        Of the process that prints.
    mailboxes
        Folder of the mailboxes ``status`` (`PrintStatus`), ``camera`` (`CameraImage`), ``snapshot`` (`Snapshot`) and
        ``surface`` (`SurfaceSnapshot`); each appears when there is something in it.
    control
        Address for `send_order`.
    key
        Secret for `send_order`, hexadecimal.
    """

    pid: int
    mailboxes: str
    control: str
    key: str

    def publish(self, run: Path) -> None:
        """Write the file that only this user may read."""
        path = run / _NAME
        path.unlink(missing_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            json.dump(asdict(self), file)

    @staticmethod
    def withdraw(run: Path) -> None:
        """Remove the file: the print is over."""
        (run / _NAME).unlink(missing_ok=True)


def find_live_print(run: str | Path) -> LiveLink | None:
    """Return how to reach the print of a run; None where none is running."""
    try:
        link = LiveLink(**json.loads((Path(run) / _NAME).read_text(encoding="utf-8")))
        os.kill(link.pid, 0)
    except (OSError, ValueError, TypeError):
        return None
    return link
