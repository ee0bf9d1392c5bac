"""A screen that the tests of projectors share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from devices.xvfb import Xvfb, running_xvfb


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Xvfb]:
    """An X server with a white desktop, for the tests of a module."""
    with pytest.MonkeyPatch.context() as patch, running_xvfb(tmp_path_factory.mktemp("xvfb"), patch) as running:
        running.light_the_desktop()
        yield running
