"""What the operator's page reaches: snapshots, surfaces, latency, several pages, Stop: python benchmarks/page.py.

A pretended print publishes 10 snapshots a second of 480 x 480 pixels and a surface of 200 000 vertices a second, in a
process of its own; chromium, without a graphics processor, shows it.  All of it shares this machine's cores.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from playwright.sync_api import Browser
from websockets.sync.client import ClientConnection, connect

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from vialight.core.messages import Snapshot
from vialight.printing.live_link import find_live_print
from vialight.system.mailboxes import Mailbox
from vialight.web import PageProcess, PageSettings
from vialight.web.encoding import unpack
from web.browser import all_flags, chromium, find_chromium, wait
from web.clients import Client
from web.pretend_print import Pretence, PretendProcess

FULL = Pretence(size=480, vertices=200_000, grows_for_s=600, with_surfaces=False)
WATCHED_S = 15.0
STOPS = 3
WITHOUT_3D = ("--disable-gpu", "--disable-software-rasterizer")
KINDS = {"images": "snapshot", "surface": "surface"}


def main() -> None:
    """Print a table in Markdown."""
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before the first row\n")
    print("| what | found | wanted |\n| --- | --- | --- |")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with printing(folder / "rates") as (client, key, run):
            time.sleep(2)
            row("snapshots a second that the print publishes, nobody watching", f"{publishing_hz(run):.1f}", "10")
            plain_pages(client, key, run, 1)
            plain_pages(client, key, run, 5)
            browser_pages(client, key, run, 1)
            browser_pages(client, key, run, 5, *WITHOUT_3D, how=", their 3-D view off")
            # Five times 400 000 triangles by processor are more than two cores can do: what becomes of the print then?
            browser_pages(client, key, run, 5, how=", all drawing 3-D by processor")
        row("Stop to black, a mesh under way to a page that does not take it, s", stops(folder), "< 0.5")
        with chromium() as browser:
            row("Stop to black, pressed in chromium under full load, s", stops(folder, browser), "< 0.5")


def row(what: str, found: str, wanted: str) -> None:
    """Print one figure, what it is and what is asked for."""
    print(f"| {what} | {found} | {wanted} |", flush=True)


@contextlib.contextmanager
def printing(run: Path) -> Iterator[tuple[Client, str, Path]]:
    """Pretend a print and serve it; give a client, the run's key and its folder."""
    with PretendProcess(run, FULL), PageProcess(run, PageSettings(port=0)) as page:
        client = Client(page.link)
        yield client, client.ask("/api/runs").json[0]["key"], run


def publishing_hz(run: Path, during_s: float = 8.0) -> float:
    """Measure how many snapshots a second the print manages to publish."""
    link = find_live_print(run)
    assert link is not None
    with Mailbox(link.mailboxes / "snapshot", Snapshot) as box:
        first, began = box.newest(), time.monotonic()
        time.sleep(during_s)
        last, ended = box.newest(), time.monotonic()
    assert first is not None
    assert last is not None
    return (last[0] - first[0]) / (ended - began)


def began_s(run: Path) -> float:
    """Return when the print's clock was at zero."""
    for line in (run / "log.jsonl").read_text().splitlines():
        if (event := json.loads(line))["event"] == "began":
            return float(event["wall_s"])
    raise LookupError("began")


def plain_pages(client: Client, key: str, run: Path, count: int) -> None:
    """Measure pages that only take what comes: what the server can give."""
    threads = [Listener(client, key, channel, began_s(run)) for _ in range(count) for channel in KINDS]
    for thread in threads:
        thread.start()
    time.sleep(3)
    for thread in threads:
        thread.came.clear()
    hz = publishing_hz(run, WATCHED_S)
    for thread in threads:
        thread.over.set()
        thread.join()
    tell(f"{count} plain page{'s' * (count > 1)}", threads, hz)


class Listener(threading.Thread):
    """A page without a browser, of one channel: notes when messages came, and when they were made."""

    def __init__(self, client: Client, key: str, channel: str, began: float) -> None:
        super().__init__(daemon=True)
        self.kind = KINDS[channel]
        self.over = threading.Event()
        self.came: list[tuple[float, float]] = []
        self._client, self._path, self._began = client, f"/ws/{key}/{channel}", began

    def run(self) -> None:
        """Take messages until it is over."""
        with self._client.socket(self._path) as socket:
            while not self.over.is_set():
                content = socket.recv(timeout=20)
                now = time.time() - self._began
                assert isinstance(content, bytes)
                header = unpack(content)[0]
                socket.send(json.dumps({"got": header["kind"]}))
                if header["kind"] == self.kind:
                    self.came.append((now, header["time_s"]))


def browser_pages(client: Client, key: str, run: Path, count: int, *flags: str, how: str = "") -> None:
    """Measure pages in chromium, which draws them all by processor."""
    with Tabs(*flags) as tabs:
        first = tabs.open(client.link)
        first.wait("document.getElementById('run-state').textContent.startsWith('Printing')")
        pages = [first, *(tabs.open(f"http://{client.host}/#run={key}") for _ in range(count - 1))]
        time.sleep(4)
        for page in pages:
            page.evaluate("performance.clearMarks()")
        hz = publishing_hz(run, WATCHED_S)
        seen = [Seen(page, kind, began_s(run)) for page in pages for kind in KINDS.values()]
    tell(f"{count} page{'s' * (count > 1)} in chromium{how}", seen, hz)


class Tabs:
    """Chromium, asked by nothing but its debugging socket.

    Playwright has a copy of everything that comes over a page's sockets, which costs more than the pages do.
    """

    def __init__(self, *flags: str) -> None:
        self._flags, self._open = flags, contextlib.ExitStack()

    def __enter__(self) -> Tabs:
        self._profile = Path(self._open.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
        self._process = subprocess.Popen(
            [find_chromium(), *all_flags(*self._flags), "--headless=new", "--remote-debugging-port=0",
             "--disable-background-timer-throttling", "--disable-backgrounding-occluded-windows",
             "--disable-renderer-backgrounding", "--window-size=1024,768",
             f"--user-data-dir={self._profile}", "about:blank"],
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._open.callback(self._end)
        told, deadline = self._profile / "DevToolsActivePort", time.monotonic() + 60
        while not (told.exists() and told.read_text().count("\n")):
            assert time.monotonic() < deadline, "chromium does not start"
            time.sleep(0.1)
        self._port = int(told.read_text().splitlines()[0])
        return self

    def __exit__(self, *ended: object) -> None:
        self._open.close()

    def _end(self) -> None:
        self._process.terminate()
        self._process.wait(20)

    def open(self, link: str) -> Tab:
        """Open a page."""
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=60)
        connection.request("PUT", f"/json/new?{quote(link, safe='')}")
        told = json.loads(connection.getresponse().read())
        connection.close()
        return Tab(self._open.enter_context(connect(told["webSocketDebuggerUrl"], max_size=None)))


class Tab:
    """A page in chromium."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._asked = socket, 0
        # A page that is not in front would not be drawn.
        self._ask("Emulation.setFocusEmulationEnabled", enabled=True)

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression in the page; None where it fails, as while the page loads."""
        told = self._ask("Runtime.evaluate", expression=expression, returnByValue=True)
        return told.get("result", {}).get("value")

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._asked += 1
        self._socket.send(json.dumps({"id": self._asked, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv(timeout=60))).get("id") != self._asked:
            pass
        return dict(answer.get("result", {}))

    def wait(self, condition: str, timeout_s: float = 60) -> None:
        """Wait until an expression is true."""
        deadline = time.monotonic() + timeout_s
        while not self.evaluate(condition):
            assert time.monotonic() < deadline, condition
            time.sleep(0.1)


class Seen:
    """What came to a page in a browser, as its own marks say."""

    def __init__(self, page: Tab, kind: str, began: float) -> None:
        marks = page.evaluate(
            f"performance.getEntriesByName({json.dumps(kind)})"
            ".map((mark) => [performance.timeOrigin + mark.startTime, mark.detail.time_s])"
        )
        self.kind = kind
        self.came = [(wall_ms / 1000 - began, made) for wall_ms, made in marks]


def tell(who: str, watchers: list[Listener] | list[Seen], publishing: float) -> None:
    """Print how often things came, of the slowest page, and how old they were, of all."""
    row(f"{who}: snapshots a second that the print still publishes", f"{publishing:.1f}", "10")
    for kind, wanted in (("snapshot", "10"), ("surface", "1")):
        of_kind = [watcher.came for watcher in watchers if watcher.kind == kind]
        rates = [(len(came) - 1) / (came[-1][0] - came[0][0]) if len(came) > 1 else 0.0 for came in of_kind]
        row(f"{who}: {kind}s a second", f"{min(rates):.2f}", wanted)
        if kind == "snapshot":
            ages = np.array([came - made for page in of_kind for came, made in page])
            found = f"{np.median(ages):.3f}, {np.quantile(ages, 0.95):.3f}" if len(ages) else "none came"
            row(f"{who}: snapshot to receipt, s (median, 95 %)", found, "< 0.2")


def stops(folder: Path, browser: Browser | None = None) -> str:
    """Stop some prints, and return how long light stayed on."""
    found = []
    for index in range(STOPS):
        run = folder / f"stop-{index}-{browser is not None}"
        with printing(run) as (client, key, _):
            pressed = press(browser, client) if browser else post(client, key)
            events = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
            found.append(next(event["wall_s"] for event in events if event["event"] == "light off") - pressed)
    return ", ".join(f"{seconds:.3f}" for seconds in sorted(found))


def post(client: Client, key: str) -> float:
    """Stop by a plain request while a surface waits for a page that does not read; return when."""
    with client.socket(f"/ws/{key}/surface"), client.socket(f"/ws/{key}/images"):
        time.sleep(4)
        pressed = time.time()
        client.post(f"/api/runs/{key}/stop")
    return pressed


def press(browser: Browser, client: Client) -> float:
    """Press the button in a page that is busy with meshes; return when."""
    context = browser.new_context(viewport={"width": 1024, "height": 768})
    page = context.new_page()
    page.goto(client.link)
    wait(page, "performance.getEntriesByName('surface').length > 2", timeout_s=60)
    page.evaluate("""document.getElementById("stop-button").addEventListener("pointerdown",
        () => performance.mark("pressed"))""")
    page.click("#stop-button")
    wait(page, "document.getElementById('stop-button').dataset.state === 'confirmed'", timeout_s=60)
    pressed = page.evaluate("performance.timeOrigin + performance.getEntriesByName('pressed')[0].startTime") / 1000
    context.close()
    return float(pressed)


if __name__ == "__main__":
    main()
