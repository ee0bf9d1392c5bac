import os
import stat
import time
from pathlib import Path

import pytest

from vialight.errors import InputError
from vialight.links import ControlServer, LiveLink, find_live_print, send_order


def test_order_is_answered() -> None:
    with ControlServer(lambda order: {"did": order["do"]}) as server:
        link = LiveLink(os.getpid(), "", server.address, server.key)
        assert send_order(link, {"do": "stop"}) == {"did": "stop"}


def test_order_with_a_wrong_key_is_not_obeyed() -> None:
    obeyed = []

    def obey(order: object) -> dict[str, object]:
        obeyed.append(order)
        return {}

    with ControlServer(obey) as server:
        wrong = LiveLink(os.getpid(), "", server.address, "00" * 32)
        with pytest.raises(InputError, match="cannot be reached"):
            send_order(wrong, {"do": "stop"})
        right = LiveLink(os.getpid(), "", server.address, server.key)
        assert send_order(right, {"do": "mode"}) == {}
    assert obeyed == [{"do": "mode"}]


def test_refusal_comes_back_as_an_error() -> None:
    def refuse(order: object) -> dict[str, object]:
        raise InputError("order", "cannot be extended")

    with ControlServer(refuse) as server, pytest.raises(InputError, match="cannot be extended"):
        send_order(LiveLink(os.getpid(), "", server.address, server.key), {"do": "extend"})


def test_print_that_does_not_answer_is_told() -> None:
    def ponder(order: object) -> dict[str, object]:
        time.sleep(0.5)
        return {}

    with ControlServer(ponder) as server, pytest.raises(InputError, match="not answered"):
        send_order(LiveLink(os.getpid(), "", server.address, server.key), {"do": "stop"}, timeout_s=0.1)


def test_running_print_is_found_and_a_dead_one_is_not(tmp_path: Path) -> None:
    assert find_live_print(tmp_path) is None
    link = LiveLink(os.getpid(), "somewhere", "address", "ab")
    link.publish(tmp_path)
    assert find_live_print(tmp_path) == link
    assert stat.S_IMODE((tmp_path / "live.json").stat().st_mode) == 0o600
    LiveLink(2**22 + 1, "", "", "").publish(tmp_path)
    assert find_live_print(tmp_path) is None
    LiveLink.withdraw(tmp_path)
    assert not (tmp_path / "live.json").exists()
