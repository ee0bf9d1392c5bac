"""Orders to a running print, and how it is found: believed only as far as the system confirms it."""

from __future__ import annotations

import errno
import json
import os
import pickle
import shutil
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from vialight.core.codec import encode
from vialight.core.errors import InputError
from vialight.core.messages import PrintStatus
from vialight.devices.panel import LightPanel
from vialight.printing.live_link import LiveLink, UnknownStateError, find_live_print
from vialight.printing.order_channel import ControlServer, send_order
from vialight.system import shared_folder
from vialight.system.mailboxes import Mailbox


@pytest.fixture
def folder() -> Iterator[Path]:
    made = shared_folder()
    LightPanel(made, is_new=True)
    yield made
    shutil.rmtree(made)


def link_to(server: ControlServer, folder: Path) -> LiveLink:
    return LiveLink.of_this_process(folder, server.key, server.port)


def test_order_is_answered(folder: Path) -> None:
    with ControlServer(folder, lambda order: {"did": order["do"]}) as server:
        assert send_order(link_to(server, folder), {"do": "mode", "mode": "auto"}) == {"did": "mode"}


def test_order_with_a_wrong_key_is_not_obeyed(folder: Path) -> None:
    obeyed: list[Any] = []

    def obey(order: Any) -> dict[str, object]:
        obeyed.append(dict(order))
        return {}

    with ControlServer(folder, obey) as server:
        wrong = LiveLink.of_this_process(folder, "00" * 32, server.port)
        with pytest.raises(InputError, match="cannot be reached"):
            send_order(wrong, {"do": "mode"})
        assert send_order(link_to(server, folder), {"do": "mode"}) == {}
    assert obeyed == [{"do": "mode"}]


def test_refusal_comes_back_as_an_error(folder: Path) -> None:
    def refuse(order: object) -> dict[str, object]:
        raise InputError("order", "cannot be extended")

    with ControlServer(folder, refuse) as server, pytest.raises(InputError, match="cannot be extended"):
        send_order(link_to(server, folder), {"do": "extend"})


def test_print_that_does_not_answer_is_told(folder: Path) -> None:
    def ponder(order: object) -> dict[str, object]:
        time.sleep(0.5)
        return {}

    with ControlServer(folder, ponder) as server, pytest.raises(InputError, match="not answered"):
        send_order(link_to(server, folder), {"do": "mode"}, timeout_s=0.1)


def test_stop_presses_the_switch_and_says_dark_when_the_light_is_seen_to_be_gone(folder: Path) -> None:
    """Also where the print's own process hangs and answers nothing."""
    panel = LightPanel(folder)

    def projector() -> None:
        while not panel.is_stopped:
            time.sleep(0.001)
        time.sleep(0.1)
        panel.tell_ended()

    threading.Thread(target=projector, daemon=True).start()
    begin = time.monotonic()
    answer = send_order(LiveLink.of_this_process(folder, "00"), {"do": "stop", "by": "a test"})
    assert answer == {"is_dark": True, "is_over": True}
    assert 0.1 <= time.monotonic() - begin < 0.5


def test_stop_that_is_not_seen_to_work_says_so_and_never_that_it_has(folder: Path) -> None:
    with pytest.raises(InputError, match=r"has not been seen to go off.*use the switch on the machine"):
        send_order(LiveLink.of_this_process(folder, "00"), {"do": "stop"})
    assert LightPanel(folder).is_stopped


def test_connections_that_say_nothing_do_not_keep_an_order_out(folder: Path) -> None:
    with ControlServer(folder, lambda order: {"did": 1}) as server:
        silent = [socket.socket(socket.AF_UNIX) for _ in range(12)]
        for one in silent:
            one.connect(str(folder / "control"))
        assert send_order(link_to(server, folder), {"do": "mode"}) == {"did": 1}
        for one in silent:
            one.close()


@pytest.mark.parametrize(
    "content",
    [b"\xff\xff\xff\xff", b"\x04\x00\x00\x00[1,]", b"\x02\x00\x00\x00[]", b"\x00\x20\x00\x00" + b"[" * 8192, b"\x01"],
)
def test_what_is_no_order_does_no_harm(folder: Path, content: bytes) -> None:
    with ControlServer(folder, lambda order: {"did": 1}) as server:
        with socket.socket(socket.AF_UNIX) as one:
            one.connect(str(folder / "control"))
            one.sendall(content)
        assert send_order(link_to(server, folder), {"do": "mode"}) == {"did": 1}


def test_running_print_is_found_and_a_dead_one_is_not(tmp_path: Path, folder: Path) -> None:
    assert find_live_print(tmp_path) is None
    link = LiveLink.of_this_process(folder, "ab")
    link.publish(tmp_path)
    assert find_live_print(tmp_path) == link
    assert stat.S_IMODE((tmp_path / "live.json").stat().st_mode) == 0o600
    LiveLink.withdraw(tmp_path)
    assert not (tmp_path / "live.json").exists()


def changed(table: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return table | {"process": table["process"] | changes.pop("process", {})} | changes


@pytest.mark.parametrize(
    "change",
    [
        lambda table: changed(table, process={"pid": 0}),
        lambda table: changed(table, process={"pid": -1}),
        lambda table: changed(table, process={"pid": True}),
        lambda table: changed(table, process={"pid": 10**400}),
        lambda table: changed(table, process={"started": "1"}),
        lambda table: changed(table, process={"boot": "another start of the machine"}),
        lambda table: changed(table, process={"user": "somebody else"}),
        lambda table: changed(table, mailboxes="/tmp"),
        lambda table: changed(table, mailboxes=table["mailboxes"] + "/../" + Path(table["mailboxes"]).name),
        lambda table: changed(table, mailboxes=3),
        lambda table: changed(table, key="no hexadecimal"),
        lambda table: {"pid": 0, "mailboxes": "here", "control": "/tmp/listener", "key": ""},
        lambda table: [table],
        lambda table: None,
    ],
)
def test_link_that_the_system_does_not_confirm_is_not_believed(
    tmp_path: Path, folder: Path, change: Callable[[Any], Any]
) -> None:
    """A folder that was copied, or given, names a process number that lives and mailboxes of its own."""
    LiveLink.of_this_process(folder, "ab").publish(tmp_path)
    path = tmp_path / "live.json"
    table = json.loads(path.read_text())
    path.write_text(json.dumps(change(table)))
    assert find_live_print(tmp_path) is None


def test_link_of_another_process_that_lives_is_not_believed_with_this_ones_folder(tmp_path: Path, folder: Path) -> None:
    LiveLink.of_this_process(folder, "ab").publish(tmp_path)
    path = tmp_path / "live.json"
    table = json.loads(path.read_text())
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(30)"])
    try:
        path.write_text(json.dumps(changed(table, process={"pid": other.pid})))
        assert find_live_print(tmp_path) is None
    finally:
        other.kill()
        other.wait()


def test_folder_that_others_may_write_to_is_not_believed(tmp_path: Path, folder: Path) -> None:
    LiveLink.of_this_process(folder).publish(tmp_path)
    folder.chmod(0o777)
    assert find_live_print(tmp_path) is None


def test_pipe_or_link_in_place_of_the_file_neither_blocks_nor_leads_out(tmp_path: Path, folder: Path) -> None:
    LiveLink.of_this_process(folder).publish(tmp_path)
    elsewhere = tmp_path / "elsewhere.json"
    (tmp_path / "live.json").rename(elsewhere)
    (tmp_path / "live.json").symlink_to(elsewhere)
    assert find_live_print(tmp_path) is None
    (tmp_path / "live.json").unlink()
    os.mkfifo(tmp_path / "live.json")
    assert find_live_print(tmp_path) is None


def test_out_of_descriptors_is_not_taken_for_no_print(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    LiveLink.of_this_process(folder).publish(tmp_path)

    def none_left(*_: object, **__: object) -> int:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(os, "open", none_left)
    with pytest.raises(UnknownStateError, match="cannot tell whether it is printing"):
        find_live_print(tmp_path)


def test_pickle_in_place_of_a_message_is_refused_and_runs_nothing(folder: Path, tmp_path: Path) -> None:
    class Bomb:
        """What runs code when it is unpickled."""

        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "it ran",)

    content = pickle.dumps(Bomb())
    with Mailbox(folder / "status", bytes, 10_000) as writer:
        writer.put(content)
    written = (folder / "status").read_bytes()
    packed = encode(content)
    (folder / "status").write_bytes(written.replace(packed, content.ljust(len(packed), b"\0")))
    with pytest.raises(InputError, match="is no PrintStatus"):
        Mailbox(folder / "status", PrintStatus).newest()
    assert not (tmp_path / "it ran").exists()
