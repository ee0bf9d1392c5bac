"""Files that anyone may have made to do harm, and a process apart in which they are read under watch."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from typing import NamedTuple

LONGEST_S = 5.0
MOST_BYTES = 1_000_000_000

_WATCHED = """
import json, resource, sys, time
from pathlib import Path
{setup}
def peak():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
before, began = peak(), time.monotonic()
try:
    {call}
    told = None
except InputError as error:
    told = str(error)
print(json.dumps([told, time.monotonic() - began, peak() - before]))
"""


class Refusal(NamedTuple):
    """What was told, in what time, and memory taken for it."""

    told: str
    took_s: float
    took_bytes: int


def refused(call: str, *arguments: object, setup: str = "") -> str:
    """Run a call in a process apart and return its `InputError`, which came in one line, in time and in bounds.

    Parameters
    ----------
    call
        An expression of Python in which ``argument(0)``, ``argument(1)`` are `arguments` as paths.
    arguments
        Paths.
    setup
        Imports beside those of `vialight.store`, `vialight.config` and `vialight.mesh`.
    """
    imports = (
        "from vialight.errors import InputError; from vialight.store import *; from vialight.config import *; "
        "from vialight.mesh import load_mesh; import h5py, zarr, trimesh, lxml.etree"
    )
    take = "argument = lambda k: Path(sys.argv[1 + k])"
    code = _WATCHED.format(setup="\n".join([imports, take, textwrap.dedent(setup)]), call=call)
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    refusal = Refusal(*json.loads(done.stdout))
    assert refusal.told is not None, "it was read"
    assert "\n" not in refusal.told
    assert len(refusal.told) < 2000
    assert refusal.took_s < LONGEST_S
    assert refusal.took_bytes < MOST_BYTES
    return refusal.told
