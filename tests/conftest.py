"""Fixtures of the whole suite: the cases shared between projects, and a recording without a file."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

CASES = Path(os.environ.get("VIALIGHT_CASES", Path(__file__).parents[1].parent / "shared" / "cases"))
"""Beside the repository; ``VIALIGHT_CASES`` names another place."""


@pytest.fixture(scope="session")
def shared_cases() -> Path:
    """The folder of the shared cases: part, cylinder, tooth, boat."""
    if not CASES.is_dir():
        pytest.skip(f"the shared cases are not at {CASES}; set VIALIGHT_CASES to where they are")
    return CASES
