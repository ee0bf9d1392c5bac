"""Aravis' own GigE Vision camera in software, on loopback, which can be killed."""

from __future__ import annotations

import fcntl
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil

from needs import need_command, need_module, skip_without
from vialight.devices import DeviceError
from vialight.devices.cameras.aravis import load_aravis

ADDRESS = "127.0.0.1"
_CONTROL_PORT = 3956
_START_TIMEOUT_S = 20.0


class FakeCamera:
    """A process that is such a camera.

    Parameters
    ----------
    command
        What starts it.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not self._listens():
            assert self._process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def _listens(self) -> bool:
        sockets = psutil.Process(self._process.pid).net_connections(kind="udp")
        return any(one.laddr.port == _CONTROL_PORT for one in sockets)


@contextmanager
def fake_camera(*options: str, program: Sequence[str] = ()) -> Iterator[FakeCamera]:
    """Run a fake camera, Aravis' or a program that is one; its port is the standard's, so that runs take turns."""
    command = program or (need_command("arv-fake-gv-camera-0.8", "aravis-tools"), "-i", ADDRESS, "-s", "V01", *options)
    need_module("gi")
    try:
        load_aravis()
    except DeviceError as error:
        skip_without(str(error))
    network = Path("/proc/self/ns/net").stat().st_ino
    with (Path(tempfile.gettempdir()) / f"vialight-gvcp-{network}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        camera = FakeCamera(command)
        try:
            yield camera
        finally:
            camera.kill()
