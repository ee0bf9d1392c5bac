"""Fixtures of the whole suite: the cases shared between projects, and a recording without a file."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

CASES = Path(os.environ.get("VIALIGHT_CASES", Path(__file__).parents[1].parent / "shared" / "cases"))
"""Beside the repository; ``VIALIGHT_CASES`` names another place."""

collect_ignore_glob = ["conftest.py", "*/conftest.py"]
"""Fixtures are found without; looked through for doctests too, each would be the module `conftest` again."""


@pytest.fixture(scope="session")
def shared_cases() -> Path:
    """The folder of the shared cases: part, cylinder, tooth, boat."""
    if not CASES.is_dir():
        pytest.skip(f"the shared cases are not at {CASES}; set VIALIGHT_CASES to where they are")
    return CASES


@pytest.fixture(scope="session", autouse=True)
def _cache_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep what is kept for the user, such as rehearsals, out of the user's own cache folder."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
