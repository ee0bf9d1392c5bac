"""How another process of the same user finds a running print: a private file in the run's folder.

A folder may come from anywhere, so that nothing in the file is believed that the system does not confirm: the process
must be the very one that wrote it, of this user and this start of the machine, and what it names must be a private
folder that vialight has made for that process.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from vialight.core.errors import InputError
from vialight.system import ProcessIdentity, identity_of, is_same_process, is_shared_folder

_NAME = "live.json"
_LARGEST_BYTES = 4096
_NOT_THERE = {errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG}


class UnknownStateError(InputError):
    """Whether a print runs cannot be told."""


@dataclass(frozen=True)
class LiveLink:
    """Where a running print can be reached.

    Parameters
    ----------
    process
        That prints.
    mailboxes
        The print's shared folder: the mailboxes ``status`` (`PrintStatus`), ``camera`` (`CameraImage`), ``snapshot``
        (`Snapshot`) and ``surface`` (`SurfaceSnapshot`), each of which appears when there is something in it; the
        `LightPanel`; the socket for orders.
    key
        Secret for `send_order`, hexadecimal; empty where no orders are taken.
    port
        Of this machine, where the system has no sockets in folders.
    """

    process: ProcessIdentity
    mailboxes: Path
    key: str = ""
    port: int = 0

    @classmethod
    def of_this_process(cls, mailboxes: Path, key: str = "", port: int = 0) -> LiveLink:
        """Return the link to what this process does."""
        identity = identity_of()
        assert identity is not None
        return cls(identity, mailboxes, key, port)

    @property
    def pid(self) -> int:
        """Of the process that prints."""
        return self.process.pid

    def publish(self, run: Path) -> None:
        """Write the file that only this user may read."""
        path = run / _NAME
        path.unlink(missing_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            json.dump(asdict(self) | {"process": self.process._asdict(), "mailboxes": str(self.mailboxes)}, file)

    @staticmethod
    def withdraw(run: Path) -> None:
        """Remove the file: the print is over."""
        (run / _NAME).unlink(missing_ok=True)


def find_live_print(run: str | Path) -> LiveLink | None:
    """Return how to reach the print of a run; None where none is running.

    Raises
    ------
    UnknownStateError
        It cannot be told: there is a file, and the system does not let it be read.
    """
    try:
        content = _read(Path(run) / _NAME)
    except OSError as error:
        if error.errno in _NOT_THERE:
            return None
        raise UnknownStateError(
            run,
            f"cannot tell whether it is printing ({error.strerror})",
            remedy="use the switch on the machine; try again",
        ) from error
    try:
        link = _checked(json.loads(content))
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    is_live = is_same_process(link.process) and is_shared_folder(link.mailboxes, link.pid)
    return link if is_live and link.process.user == _this_user() else None


def _read(path: Path) -> bytes:
    """Return the content of a small regular file; of anything else, nothing, and without waiting for it."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    descriptor = os.open(path, flags)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            return b""
        return os.read(descriptor, _LARGEST_BYTES)
    finally:
        os.close(descriptor)


def _checked(table: Any) -> LiveLink:
    process, mailboxes, key, port = (table[name] for name in ("process", "mailboxes", "key", "port"))
    identity = ProcessIdentity(**process)
    texts = (identity.started, identity.boot, identity.user, mailboxes, key)
    numbers = (identity.pid, port)
    if not (all(type(text) is str for text in texts) and all(type(number) is int for number in numbers)):
        raise TypeError
    bytes.fromhex(key)
    return LiveLink(identity, Path(mailboxes), key, port)


def _this_user() -> str:
    identity = identity_of()
    return "" if identity is None else identity.user
