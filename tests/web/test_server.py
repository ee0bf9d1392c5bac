"""What the server tells of a print, and what it does with orders."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.client import ClientConnection

from vialight.core.errors import InputError
from vialight.store import list_history, list_surfaces, read_history
from vialight.web import PageProcess, PageSettings
from vialight.web.encoding import unpack
from web.clients import Client
from web.pretend_print import VOLUME_GRID, Pretence, PretendPrint, PretendProcess

pytestmark = pytest.mark.alone

STOP_WITHIN_S = 0.5
"""From the press to a black projector."""


def wait_for(condition: Callable[[], Any], timeout_s: float = 15.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < deadline, "it has not come"
        time.sleep(0.02)
    return found


def take(socket: ClientConnection, kind: str, *, answers: bool = True) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the next message of a kind, as header and arrays; others are answered as a page does."""
    while True:
        content = socket.recv(timeout=15)
        header, arrays = (json.loads(content), {}) if isinstance(content, str) else unpack(content)
        if answers and header["kind"] != "answer":
            socket.send(json.dumps({"got": header["kind"]}))
        if header["kind"] == kind:
            return header, arrays


def until(socket: ClientConnection, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Return the first status that a condition is true of."""
    deadline = time.monotonic() + 15
    while not condition(status := take(socket, "status")[0]):
        assert time.monotonic() < deadline, status
    return status


def _until_silence(socket: ClientConnection) -> Iterator[str]:
    """Yield the kinds of what still comes, unanswered, until nothing does for a second."""
    with contextlib.suppress(TimeoutError):
        while True:
            content = socket.recv(timeout=1.0)
            assert isinstance(content, bytes)
            yield unpack(content)[0]["kind"]


def key_of(run_path: str) -> str:
    return run_path.rsplit("/", 1)[1]


@pytest.fixture
def stoppable(tmp_path: Path) -> Iterator[tuple[PretendPrint, Client, str]]:
    """A print of one test's own, its client, and its address."""
    with PretendPrint(tmp_path / "ring") as made, PageProcess(made.run, PageSettings(port=0)) as page:
        client = Client(page.link)
        yield made, client, f"/api/runs/{client.ask('/api/runs').json[0]['key']}"


def test_a_status_says_what_the_print_says_and_how_old_that_is(client: Client, run_path: str) -> None:
    with client.socket(f"/ws/{key_of(run_path)}/state") as socket:
        told = until(socket, lambda told: told["live"] and told["status"] is not None)
    assert told["status"]["devices"]["led"] == "not answering since 2 s"
    assert 0 <= told["ages_s"]["status"] < 1


def test_pictures_come_as_they_were_measured(client: Client, run_path: str, printing: PretendPrint) -> None:
    with client.socket(f"/ws/{key_of(run_path)}/images") as socket:
        header, arrays = take(socket, "snapshot")
        reference, sums = take(socket, "reference")
    size = printing.pretence.size
    assert arrays["density_xy"].shape == (size, size)
    assert arrays["cured_yz"].shape == (size * 5 // 8, size)
    assert header["voxel_mm"] == pytest.approx(17.2 / size)
    of = reference["arrays"]["reference_xy"]
    shown = of["low"] + (sums["reference_xy"].astype(float) - 1) / 254 * (of["high"] - of["low"])
    assert np.abs(shown - printing._sums[0]).max() < of["high"] / 254 + 0.35  # a ring of fewer faces is compared


def test_the_surface_comes_with_its_deviation(client: Client, run_path: str, printing: PretendPrint) -> None:
    with client.socket(f"/ws/{key_of(run_path)}/surface") as socket:
        header, arrays = take(socket, "surface")
    points = np.array(header["low_mm"]) + arrays["vertices"] / 65535 * np.array(header["extent_mm"])
    assert np.array_equal(arrays["faces"], printing.reference.faces)
    assert np.abs(points).max() < 7
    deviation = arrays["deviation"] * header["deviation_unit_mm"]
    assert np.sqrt(np.mean(deviation**2)) == pytest.approx(header["rmse_mm"], rel=1e-3)


def test_camera_and_pattern_come_with_their_places(client: Client, run_path: str) -> None:
    with client.socket(f"/ws/{key_of(run_path)}/images") as socket:
        camera, pictures = take(socket, "camera")
        pattern, images = take(socket, "pattern")
    assert (camera["rows"], camera["columns"]) == (300, 480)
    assert pictures["counts"].shape == (300, 480)
    assert (pattern["first_row"], pattern["first_column"]) == (60, 80)
    assert images["levels"].shape == (120, 160)
    overlay = client.ask(run_path).json["camera"]
    left, right = overlay["edge_columns"]
    assert (left + right) / 2 == pytest.approx(overlay["axis_column"])
    # The glass's rim lies nearly a radius from the axis, seen a little wider from 145 mm.
    assert (right - left) / 2 * overlay["pixel_mm"] == pytest.approx(12.7, abs=0.6)


def test_a_slow_page_is_skipped_ahead_and_never_queued_for(client: Client, run_path: str) -> None:
    with client.socket(f"/ws/{key_of(run_path)}/images") as socket:
        first, _ = take(socket, "snapshot", answers=False)
        still_coming = list(_until_silence(socket))
        assert len(still_coming) == len(set(still_coming) - {"snapshot"})
        socket.send('{"got": "snapshot"}')
        second, _ = take(socket, "snapshot", answers=False)
    assert second["frames"] - first["frames"] >= 8


def test_history_is_told_in_numbers_and_pictures(client: Client, run_path: str, printing: PretendPrint) -> None:
    wait_for(lambda: len(list_surfaces(printing.run)) >= 2)
    told = client.ask(f"{run_path}/curves/0").json
    assert [row[0] for row in told["rows"]] == list_history(printing.run)[: len(told["rows"])]
    number = told["rows"][1][0]
    header, arrays = unpack(client.ask(f"{run_path}/moments/{number}").body)
    kept = read_history(printing.run, number)
    assert header["rmse_mm"] == pytest.approx(kept.numbers.rmse_mm)
    assert (arrays["gel_xy"] == 0).sum() == np.isnan(kept.gel_time_s.xy).sum()  # type: ignore[union-attr]
    surface, shape = unpack(client.ask(f"{run_path}/surfaces/{told['surfaces'][0]}").body)
    assert len(shape["vertices"]) == len(printing.reference.vertices_mm)
    assert surface["deviation_unit_mm"] > 0
    later = client.ask(f"{run_path}/curves/1").json
    assert later["rows"][0] == told["rows"][1]


def test_slices_are_those_nearest_to_where_they_are_wanted(client: Client, run_path: str) -> None:
    header, arrays = unpack(client.ask(f"{run_path}/slices/600/250/0").body)
    at = header["at_mm"]
    low, high = VOLUME_GRID.x_mm[[0, -1]]
    wanted = {"x": low + 0.6 * (high - low), "y": low + 0.25 * (high - low), "z": VOLUME_GRID.z_mm[0]}
    assert at == pytest.approx(wanted, abs=0.51 * VOLUME_GRID.voxel_mm)
    for plane, rows, columns, fixed in (
        ("xy", 10 * VOLUME_GRID.y_mm, VOLUME_GRID.x_mm, 100 * at["z"]),
        ("xz", 100 * VOLUME_GRID.z_mm, VOLUME_GRID.x_mm, 10 * at["y"]),
        ("yz", 100 * VOLUME_GRID.z_mm, 10 * VOLUME_GRID.y_mm, at["x"]),
    ):
        of = header["arrays"][f"slice_{plane}"]
        shown = of["low"] + (arrays[f"slice_{plane}"].astype(float) - 1) / 254 * (of["high"] - of["low"])
        meant = 2000 + rows[:, None] + columns[None, :] + fixed
        assert np.abs(shown - meant).max() <= (of["high"] - of["low"]) / 254, plane


def test_slices_beyond_the_volume_are_its_outermost(client: Client, run_path: str) -> None:
    header, _ = unpack(client.ask(f"{run_path}/slices/500/500/99999").body)
    assert header["at_mm"]["z"] == pytest.approx(VOLUME_GRID.z_mm[-1])


@pytest.mark.parametrize("place", ["-1/0/0", "nan/0/0", "0/0", "0/0/..%2f..%2f"])
def test_a_slice_at_no_place_is_refused(client: Client, run_path: str, place: str) -> None:
    assert client.ask(f"{run_path}/slices/{place}").status == 404


def test_the_reference_comes_as_a_ghost_and_as_projections(client: Client, run_path: str) -> None:
    assert len(unpack(client.ask(f"{run_path}/reference").body)[1]["vertices"]) > 1000
    assert unpack(client.ask(f"{run_path}/reference-sums").body)[1]["reference_xz"].shape == (75, 120)


def test_stop_by_a_plain_request_needs_no_body(stoppable: tuple[PretendPrint, Client, str]) -> None:
    printing, client, path = stoppable
    wait_for(lambda: printing.is_lit)
    assert client.post(f"{path}/stop").status == 200
    assert not printing.is_lit
    assert printing.orders == [{"do": "stop", "by": "page at 127.0.0.1"}]
    assert '"by": "page at 127.0.0.1"' in client.ask(f"{path}/files/log.jsonl").body.decode()


def test_stop_by_socket_is_answered_and_confirmed_by_what_is_projected(
    stoppable: tuple[PretendPrint, Client, str],
) -> None:
    printing, client, path = stoppable
    with client.socket(f"/ws/{key_of(path)}/state") as socket:
        until(socket, lambda told: bool(told["status"]) and told["status"]["pattern"] is not None)
        socket.send('{"order": {"do": "stop"}, "id": 7}')
        answer, _ = take(socket, "answer")
        assert (answer["id"], answer["answer"]) == (7, {"state": "after", "is_dark": True, "is_over": True})
        assert until(socket, lambda told: told["status"]["pattern"] is None)["status"]["state"] == "after"
    assert not printing.is_lit


def test_stop_goes_through_while_a_mesh_is_under_way_to_a_page_that_does_not_take_it(tmp_path: Path) -> None:
    pretence = Pretence(vertices=200_000, with_surfaces=False)
    with (
        PretendProcess(tmp_path / "ring", pretence) as printing,
        PageProcess(tmp_path / "ring", PageSettings(port=0)) as page,
    ):
        client = Client(page.link)
        path = f"/api/runs/{client.ask('/api/runs').json[0]['key']}"
        with client.socket(f"/ws/{key_of(path)}/surface"), client.socket(f"/ws/{key_of(path)}/state") as socket:
            # 6 MB do not fit into the sockets' buffers, and nobody reads them.
            until(socket, lambda told: "surface" in told["ages_s"] and told["status"]["pattern"] is not None)
            pressed = time.time()
            assert client.post(f"{path}/stop").status == 200
        events = [json.loads(line) for line in (tmp_path / "ring" / "log.jsonl").read_text().splitlines()]
        black = next(event["wall_s"] for event in events if event["event"] == "light off")
        assert black - pressed < STOP_WITHIN_S
        assert printing.process.poll() is None


def test_other_orders_are_passed_on_and_answered(client: Client, run_path: str, printing: PretendPrint) -> None:
    assert client.post(f"{run_path}/orders", {"do": "extend", "turns": 1.5}).json == {"turns": 1.5}
    assert client.post(f"{run_path}/orders", {"do": "mode", "mode": "manual", "by": "nobody"}).json == {
        "mode": "manual"
    }
    assert printing.mode == "manual"
    assert printing.orders[-1]["by"] == "page at 127.0.0.1"


@pytest.mark.parametrize(
    "order",
    [
        None, [], {}, {"do": "burn"}, {"do": "extend"}, {"do": "extend", "turns": -1}, {"do": "extend", "turns": 1e9},
        {"do": "extend", "turns": "1"}, {"do": "extend", "turns": True}, {"do": "mode", "mode": "turbo"},
        {"do": "mode", "mode": None},
    ],
)  # fmt: skip
def test_what_is_no_order_is_not_passed_on(client: Client, run_path: str, printing: PretendPrint, order: Any) -> None:
    before = len(printing.orders)
    answer = client.post(f"{run_path}/orders", order)
    assert answer.status == 409
    assert answer.json["error"].startswith("order: ")
    assert len(printing.orders) == before


def test_a_finished_print_says_so_gives_its_files_and_takes_no_orders(
    stoppable: tuple[PretendPrint, Client, str],
) -> None:
    printing, client, path = stoppable
    wait_for(lambda: list_surfaces(printing.run))
    with client.socket(f"/ws/{key_of(path)}/state") as socket:
        client.post(f"{path}/stop")
        until(socket, lambda told: not told["live"])
    facts = client.ask(path).json
    assert facts["state"] == "done"
    assert facts["metrics"]["as_placed"]["iou"] == 0.97
    assert {"surface.stl", "deviation.ply", "metrics.json", "report.html"} <= set(facts["files"])
    download = client.ask(f"{path}/files/surface.stl")
    assert download.body == (printing.run / "surface.stl").read_bytes()
    assert download.headers["content-disposition"] == 'attachment; filename="ring-surface.stl"'
    report = client.ask(f"{path}/report")
    assert "sandbox" in report.headers["content-security-policy"]
    assert b"Report of the ring" in report.body
    assert client.post(f"{path}/stop").json["error"].startswith("print: is not running")
    assert client.ask(f"{path}/thumbnail").body.startswith(b"\x89PNG")
    assert unpack(client.ask(f"{path}/slices/0/0/1000").body)[0]["at_mm"]["z"] == pytest.approx(VOLUME_GRID.z_mm[-1])


def test_a_print_that_was_killed_is_no_longer_live(tmp_path: Path) -> None:
    with PageProcess(tmp_path, PageSettings(port=0)) as page:
        client = Client(page.link)
        assert client.ask("/api/runs").json == []
        printing = PretendProcess(tmp_path / "ring")
        run = client.ask("/api/runs").json[0]
        deadline = time.monotonic() + 20.0
        while run["fault"] == "is still being read" and time.monotonic() < deadline:
            run = client.ask("/api/runs").json[0]  # its readers have only begun
        assert run["state"] == "printing", run["fault"]
        with client.socket(f"/ws/{run['key']}/state") as socket:
            until(socket, lambda told: bool(told["live"]))
            printing.kill()
            until(socket, lambda told: not told["live"])
        assert client.ask(f"/api/runs/{run['key']}").json["state"] == "interrupted"


def test_pages_stay_let_in_when_the_server_is_started_again(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text("{}")
    with PageProcess(tmp_path, PageSettings(port=0)) as page:
        first = Client(page.link)
        cookie, port = first.cookie(), int(first.host.rsplit(":", 1)[1])
    with PageProcess(tmp_path, PageSettings(port=port)) as page:
        assert page.link == first.link
        assert first.ask("/api/session", headers={"Cookie": cookie}).status == 200


def test_a_port_that_is_taken_is_named(client: Client, printing: PretendPrint) -> None:
    port = int(client.host.rsplit(":", 1)[1])
    with pytest.raises(InputError, match=rf"cannot listen on 127\.0\.0\.1 port {port} .*choose another --port"):
        PageProcess(printing.run, PageSettings(port=port))


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such folder"):
        PageProcess(tmp_path / "nothing", PageSettings(port=0))


class _Touch:
    """Makes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self._path,)


def _send_code(root: Path, settings: PageSettings, pipe: Any) -> None:
    pipe.send(_Touch(root / "was-run"))


def _say_nothing(root: Path, settings: PageSettings, pipe: Any) -> None:
    pipe.close()


@pytest.mark.parametrize("child", [_send_code, _say_nothing])
def test_what_the_pages_process_says_is_data_and_runs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, child: Callable[..., None]
) -> None:
    monkeypatch.setattr("vialight.web.server._serve_beside", child)
    with pytest.raises(InputError, match="has not started"):
        PageProcess(tmp_path, PageSettings(port=0))
    assert not (tmp_path / "was-run").exists()
