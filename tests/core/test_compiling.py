"""How wide the vectors are that kernels are compiled for."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

import vialight
from vialight.core.compiling import WIDE

SOURCES = Path(vialight.__file__).parent
SHOWN = """
import vialight.tomography.radon
from numba.core.registry import cpu_target
print(cpu_target.target_context.codegen()._tm_features)
"""


def features(given: str | None) -> str:
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CPU_FEATURES"}
    environment |= {} if given is None else {"NUMBA_CPU_FEATURES": given}
    done = subprocess.run([sys.executable, "-c", SHOWN], capture_output=True, text=True, check=True, env=environment)
    return done.stdout.strip()


def test_vectors_are_wide_on_processors_that_keep_their_clock_with_them() -> None:
    assert features(None).endswith(",-prefer-256-bit") == (get_host_cpu_name() in WIDE)


def test_what_the_user_says_of_the_processor_holds() -> None:
    assert features("+sse2,-avx512f") == "+sse2,-avx512f"


def test_every_module_of_kernels_settles_the_width() -> None:
    """Else the one that is imported first would settle it by numba's default."""
    kernels = [path for path in SOURCES.rglob("*.py") if re.search(r"^from numba import", path.read_text(), re.M)]
    assert len(kernels) > 20
    without = [path for path in kernels if "from vialight.core.compiling import" not in path.read_text()]
    assert without == [SOURCES / "core" / "compiling.py"]
