"""What a test needs and does not find: it is skipped, but not under CI, which is to have everything."""

from __future__ import annotations

import importlib.util
import os
import shutil
from typing import NoReturn

import pytest


def skip_without(what: str) -> NoReturn:
    """Skip the test, or fail under CI."""
    if os.environ.get("CI"):
        pytest.fail(what)
    pytest.skip(what)


def need_command(name: str, package: str) -> str:
    """Return the path of a command of the system."""
    path = shutil.which(name)
    return path or skip_without(f"{name} is not installed: apt-get install {package}, or make system")


def need_module(name: str) -> None:
    """Ask for a driver's library."""
    if importlib.util.find_spec(name) is None:
        skip_without(f"{name} is not installed: make devices")
