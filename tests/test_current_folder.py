"""The current folder, which may be one that was given, does not choose what code runs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_numba_takes_no_compiled_code_from_where_the_current_folder_says(tmp_path: Path) -> None:
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {tmp_path}\n")
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    code = "import vialight, numba; print(repr(numba.config.CACHE_DIR))"
    told = subprocess.check_output([sys.executable, "-c", code], text=True, cwd=tmp_path, env=environment)
    assert told.strip() == "''"


def test_the_users_own_place_for_compiled_code_is_kept(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    code = "import vialight, numba; print(numba.config.CACHE_DIR)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True, env=environment).strip() == str(tmp_path)
