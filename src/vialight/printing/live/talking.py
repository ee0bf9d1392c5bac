"""What the processes of the live measurement and the one that started them say to each other: a few words."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from vialight.core.errors import VialightError

READY, FINISH, DONE = b"ready", b"finish", b"done"
FAULT = b"fault: "
"""And after it, what is wrong."""


@contextlib.contextmanager
def faults_told_to(orders: Connection[Any, Any]) -> Iterator[None]:
    """Tell what ends a process by its error's own line; what is no error of vialight's ends it as ever.

    Where nobody is left to talk to, the process that prints is gone: that ends this one in silence.
    """
    try:
        yield
    except (EOFError, ConnectionError):
        pass
    except VialightError as error:
        with contextlib.suppress(OSError):
            orders.send_bytes(FAULT + str(error).encode())
