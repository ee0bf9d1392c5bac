from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from vialight.web import PageProcess, PageSettings
from web.clients import Client
from web.pretend_print import Pretence, PretendPrint


@pytest.fixture(scope="session", autouse=True)
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the tests' tokens out of the user's."""
    before = os.environ.get("XDG_STATE_HOME")
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))
    yield
    if before is None:
        del os.environ["XDG_STATE_HOME"]
    else:
        os.environ["XDG_STATE_HOME"] = before


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of runs."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def printing(runs: Path) -> Iterator[PretendPrint]:
    """A print that runs while the module's tests do, and is still far too thin when the last of them looks at it."""
    with PretendPrint(runs / "ring", Pretence(grows_for_s=900)) as made:
        yield made


@pytest.fixture(scope="module")
def client(runs: Path, printing: PretendPrint) -> Iterator[Client]:
    """A client of a server that shows the folder of runs."""
    with PageProcess(runs, PageSettings(port=0)) as page:
        yield Client(page.link)


@pytest.fixture(scope="module")
def run_path(client: Client) -> str:
    """The address of the print that runs."""
    return f"/api/runs/{client.ask('/api/runs').json[0]['key']}"
