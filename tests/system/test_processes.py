"""A process is known again, and told from a later one of the same number."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gifts import trapped
from vialight.system import deaf_to_interrupts, identity_of, is_same_process, state_of, wait_for


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    yield process
    process.kill()
    process.wait()


def test_process_that_has_ended_is_not_the_same_any_more(sleeper: subprocess.Popen[bytes]) -> None:
    known = identity_of(sleeper.pid)
    assert known is not None
    assert is_same_process(known)
    sleeper.kill()
    sleeper.wait()
    assert not is_same_process(known)


def test_process_of_the_same_number_that_started_at_another_time_is_another(sleeper: subprocess.Popen[bytes]) -> None:
    known = identity_of(sleeper.pid)
    assert known is not None
    for other in (known._replace(started="1"), known._replace(boot="another"), known._replace(user="somebody")):
        assert not is_same_process(other)


@pytest.mark.parametrize("pid", [0, -1, -(2**63), 2**31 - 1, 2**70])
def test_numbers_that_no_process_has_are_nobody(pid: int) -> None:
    assert identity_of(pid) is None


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="the system cannot stop a process")
def test_stopped_process_is_seen_as_stopped_and_as_running_when_it_goes_on(sleeper: subprocess.Popen[bytes]) -> None:
    os.kill(sleeper.pid, signal.SIGSTOP)
    assert wait_for(lambda: state_of(sleeper.pid) == "stopped", timeout_s=5) is None
    os.kill(sleeper.pid, signal.SIGCONT)
    assert wait_for(lambda: state_of(sleeper.pid) == "runs", timeout_s=5) is None


def test_killed_process_is_gone_before_its_parent_has_looked(sleeper: subprocess.Popen[bytes]) -> None:
    sleeper.kill()
    assert wait_for(lambda: state_of(sleeper.pid) == "gone", timeout_s=5) is None


def test_process_that_is_started_imports_nothing_from_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    marker = trapped(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    process = multiprocessing.get_context("spawn").Process(target=abs, args=(1,))
    with deaf_to_interrupts():
        process.start()
    process.join(60)
    assert not marker.exists()
    assert process.exitcode == 0
    assert "PYTHONSAFEPATH" not in os.environ  # what else is started is not ours to change
