"""The page as a person has it: in a browser, with its security policy on."""

from __future__ import annotations

import io
import re
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page

from vialight.store import list_history, list_surfaces
from vialight.web import PageProcess, PageSettings
from web.browser import chromium, opened, wait
from web.clients import Client
from web.pretend_print import RIG, RING_MM, TUBE_MM, Pretence, PretendPrint, PretendProcess

pytestmark = pytest.mark.alone

HOSTILE = '<img src=x onerror="document.title=1">.stl'


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def live(browser: Browser, client: Client, run_path: str) -> Iterator[Page]:
    """A page of the print that the module's tests share."""
    with opened(browser, client.link) as page:
        page.click(f'a[href="#run={run_path.rsplit("/", 1)[1]}"]')
        page.wait_for_selector("#run-state[data-state=printing]")
        wait(page, "performance.getEntriesByName('surface').length > 1")
        yield page


@pytest.fixture
def lone(tmp_path: Path, browser: Browser) -> Iterator[tuple[PretendPrint, Page]]:
    """A print and a page of one test's own."""
    with (
        PretendPrint(tmp_path / "ring") as printing,
        PageProcess(printing.run, PageSettings(port=0)) as process,
        opened(browser, process.link) as page,
    ):
        page.wait_for_selector("#run-state[data-state=printing]")
        yield printing, page


def pixels(page: Page, selector: str) -> NDArray[np.uint8]:
    """Return what a person sees there, (row, column, red green blue)."""
    return np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB"))


def drawn(page: Page, selector: str) -> NDArray[np.uint8]:
    """Return what a page has drawn on a canvas."""
    read = "c => Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data)"
    canvas = page.locator(selector)
    width = int(canvas.evaluate("c => c.width"))
    return np.array(canvas.evaluate(read), dtype=np.uint8).reshape(-1, width, 4)[..., :3]


def banner(page: Page, *words: str) -> str:
    """Wait until the banner says something with these words in it."""
    wait(
        page,
        "words => words.every((word) => document.getElementById('banner').textContent.includes(word))",
        list(words),
    )
    return page.inner_text("#banner")


def test_the_link_lets_in_and_the_token_stays_nowhere_in_sight(browser: Browser, client: Client) -> None:
    with opened(browser, client.link) as page:
        page.wait_for_selector("#runs-list a")
        assert client.token not in page.url
        assert client.token not in page.evaluate("document.documentElement.outerHTML + document.cookie")
        page.reload()
        page.wait_for_selector("#runs-list a")


def test_a_token_can_be_typed_and_a_wrong_one_is_told(browser: Browser, client: Client) -> None:
    with opened(browser, f"http://{client.host}/", may_fail=True) as page:
        page.fill("#token", "wrong")
        page.press("#token", "Enter")
        wait(page, "document.getElementById('login-answer').textContent.includes('wrong token')")
        page.fill("#token", client.token)
        page.click("text=Open >> nth=-1")
        page.wait_for_selector("#runs-list a")


def test_nine_projections_are_drawn_to_one_scale(live: Page) -> None:
    wait(live, "document.querySelectorAll('.projections canvas[style]').length === 9")
    columns = ("density", "cured", "reference")
    for place, plane in enumerate(("xy", "xz", "yz")):
        of_kind = [drawn(live, f"#projections-{kind} canvas >> nth={place}") for kind in columns]
        assert of_kind[0].shape == of_kind[1].shape == of_kind[2].shape, plane
        # The live ring is thinner than the reference's: some of what is bright there is still dark here.
        assert of_kind[2].astype(int).sum() > of_kind[1].astype(int).sum(), plane
    widths = {round(live.locator(f"#projections-{kind} canvas").nth(0).bounding_box()["width"]) for kind in columns}  # type: ignore[index]
    assert len(widths) == 1


def test_the_surface_is_drawn_in_the_colours_of_its_deviation_and_can_be_cut(live: Page) -> None:
    live.select_option("#limit", "1")
    wait(live, "document.getElementById('surface-numbers').textContent.includes('RMSE')")
    whole = _settled(live, "#surface-canvas")
    blue = _blue(whole)  # the ring is too small by more than a millimetre
    assert blue.mean() > 0.02
    live.select_option("#clip-axis", "x")
    deadline = time.monotonic() + 15
    while not 0.2 < _blue(pixels(live, "#surface-canvas")).sum() / blue.sum() < 0.85:
        assert time.monotonic() < deadline, "it is not cut in half"
    assert "x = " in live.inner_text("#clip-value")
    live.select_option("#clip-axis", "")


def test_a_click_reads_the_deviation_and_keys_turn_the_surface(live: Page) -> None:
    seen = _settled(live, "#surface-canvas")
    rows, columns = np.nonzero(_blue(seen))
    place = len(rows) // 2
    # The notice gives way to the next surface's: watch it.
    live.evaluate("""() => { window.told = []; new MutationObserver(() => {
        window.told.push(document.getElementById("surface-notice").textContent);
    }).observe(document.getElementById("surface-notice"), { childList: true }); }""")
    live.click("#surface-canvas", position={"x": float(columns[place]), "y": float(rows[place])})
    told = wait(live, r"window.told.find((text) => / mm at \(.*\) mm$/.test(text))")
    deviation, x, y, z = (float(number) for number in re.findall(r"-?\d+\.\d+", told.replace("\u2212", "-")))
    assert deviation < -1  # the ring is too small by more than a millimetre
    assert deviation == pytest.approx(np.hypot(np.hypot(x, y) - RING_MM, z) - TUBE_MM, abs=0.15)
    for _ in range(8):
        live.press("#surface-canvas", "ArrowUp")
    deadline = time.monotonic() + 15
    while np.abs(pixels(live, "#surface-canvas").astype(int) - seen).mean() < 1:
        assert time.monotonic() < deadline, "it does not turn"
    live.click("#surface-reset")


def _blue(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray(picture[..., 2].astype(int) - picture[..., 0] > 60)


def _settled(page: Page, selector: str) -> NDArray[np.uint8]:
    """Return a picture once something is drawn."""
    deadline = time.monotonic() + 15
    while True:
        seen = pixels(page, selector)
        if len(np.unique(seen.reshape(-1, 3), axis=0)) > 50:
            return seen
        assert time.monotonic() < deadline, "it is not drawn"
        page.wait_for_timeout(100)


def test_slices_are_shown_where_their_sliders_stand(live: Page) -> None:
    wait(live, "!document.querySelector('#plane-xy input').disabled")
    live.fill("#plane-xy input", "900")  # density rises by 100 a mm along z, and by 10 along y
    wait(live, "document.querySelector('#plane-xy output').textContent.startsWith('z = ')")
    wait(live, "parseFloat(document.querySelector('#plane-xy output').textContent.slice(4)) > 4.5")
    high = drawn(live, "#plane-xy canvas").astype(int).sum()
    live.fill("#plane-xy input", "100")
    wait(live, "document.querySelector('#plane-xy output').textContent.includes('\u2212')")
    assert drawn(live, "#plane-xy canvas").astype(int).sum() < high
    live.click("#planes-middle")
    wait(live, "document.querySelector('#plane-xy output').textContent === 'middle'")


def test_the_vial_is_drawn_where_the_rig_has_it(live: Page, client: Client, run_path: str) -> None:
    wait(live, "document.getElementById('camera-caption').textContent.startsWith('Frame')")
    picture = drawn(live, "#camera-canvas").astype(int)
    edges = client.ask(run_path).json["camera"]["edge_columns"]
    scale = picture.shape[1] / 480
    is_yellow = ((picture[..., 0] - picture[..., 2]) > 60).mean(axis=0) > 0.8
    found = np.flatnonzero(is_yellow)
    for edge in edges:
        assert np.abs(found - (edge + 0.5) * scale).min() <= 2
    axis = round((RIG.need_camera().axis_column + 0.5) * scale)
    is_blue = ((picture[..., 2] - picture[..., 0]) > 40).mean(axis=0)
    assert is_blue[axis - 2 : axis + 2].max() > 0.4


def test_state_figures_curves_and_machine_are_told_in_words(live: Page) -> None:
    assert live.inner_text("#run-state").startswith("Printing")
    figures = live.inner_text("#figures")
    assert "Turn" in figures
    assert "Remaining" in figures
    machine = live.inner_text("#machine-facts")
    assert "12.3 GB free, lasts 1 h 12 min" in machine
    assert "not answering since 2 s" in machine
    assert "[calibration.axis] is 120 days old" in machine
    wait(live, "document.querySelector('.charts canvas').getAttribute('aria-label').includes(' s: print to')")
    assert live.locator(".charts canvas").count() == 4


def test_every_control_has_a_name_and_a_keyboard_reaches_stop_before_the_print(live: Page) -> None:
    nameless = live.evaluate("""() => [...document.querySelectorAll("button, input, select, canvas, ol")]
        .filter((item) => item.offsetParent && !item.ariaLabel && !item.labels?.length && !item.textContent.trim())
        .map((item) => item.id)""")
    assert nameless == []
    order = live.evaluate("""() => [...document.querySelectorAll("button, input, select, a, [tabindex]")]
        .filter((item) => item.offsetParent && item.tabIndex >= 0).map((item) => item.id)""")
    assert order[:2] == ["to-runs", "stop-button"]
    assert live.evaluate("[...document.querySelectorAll('[tabindex]')].every((item) => item.tabIndex === 0)")


def test_one_can_look_back_while_it_prints_and_return(live: Page, printing: PretendPrint) -> None:
    wait(live, "Number(document.getElementById('moment').max) >= 3")
    live.focus("#moment")
    live.keyboard.press("Home")
    banner(live, "looking back")
    first = list_history(printing.run)[0]
    wait(live, f"document.getElementById('moment-label').textContent.endsWith('frame {first}')")
    assert live.is_enabled("#stop-button")
    wait(live, f"document.getElementById('camera-caption').textContent.startsWith('Frame {first},')")
    back = drawn(live, "#projections-cured canvas >> nth=0").astype(int).sum()
    live.click("#to-live")
    wait(live, "document.getElementById('moment-label').textContent.startsWith('live')")
    wait(live, "document.getElementById('banner').hidden")
    live.wait_for_timeout(300)
    assert drawn(live, "#projections-cured canvas >> nth=0").astype(int).sum() > back


def test_orders_go_through_and_are_answered(live: Page, printing: PretendPrint) -> None:
    live.fill("#extend-turns", "2.5")
    live.click("#extend-button")
    wait(live, "document.getElementById('order-answer').textContent === 'Extended by 2.50 turns.'")
    live.check("input[name=mode][value=manual]")
    wait(live, "document.getElementById('order-answer').textContent === 'Mode manual.'")
    assert (printing.turns_more, printing.mode) == (2.5, "manual")


def test_stop_in_mid_print_is_one_press_and_is_confirmed_by_what_is_projected(lone: tuple[PretendPrint, Page]) -> None:
    printing, page = lone
    wait(page, "document.getElementById('pattern-caption').textContent.includes('shows pattern')")
    page.mouse.click(*_middle(page, "#stop-button"))
    page.wait_for_selector("#stop-button[data-state=confirmed]")
    assert page.inner_text("#stop-answer").startswith("The projector shows black, ")
    assert not printing.is_lit
    assert {order["do"] for order in printing.orders} == {"stop"}
    wait(page, "document.getElementById('log').textContent.includes('by page at 127.0.0.1')")
    page.wait_for_selector("#run-state[data-state=done]")
    assert "RMSE, print to reference" in page.inner_text("#results-numbers")


def test_a_confirmed_stop_stays_so_while_a_print_that_runs_has_told_nothing(
    lone: tuple[PretendPrint, Page],
) -> None:
    _, page = lone
    told = page.evaluate(
        """async () => {
          const { Stop } = await import("/static/js/stop.js");
          const stop = new Stop(() => undefined, () => []);
          Object.assign(stop, { pressedAt: performance.now(), isConfirmed: true });
          stop.see(true, null, false);  // live, without a status yet
          return [stop.isConfirmed, (stop.see(true, { pattern: 3, state: "printing" }, false), stop.pressedAt)];
        }"""
    )
    assert told == [True, None]  # and a pattern, by an extension, makes a new Stop of it


def _middle(page: Page, selector: str) -> tuple[float, float]:
    box = page.locator(selector).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_a_page_says_that_its_data_are_old_and_whose_fault_it_is(lone: tuple[PretendPrint, Page]) -> None:
    printing, page = lone
    wait(page, "performance.getEntriesByName('snapshot').length > 1")
    printing.paused = {"snapshot"}
    assert banner(page, "The pictures are").endswith("the print itself goes on.")
    printing.paused = {"snapshot", "status"}
    banner(page, "The print has said nothing for")
    printing.paused = set()
    wait(page, "document.getElementById('banner').hidden")


def test_a_page_finds_its_print_again_when_the_server_is_started_again(tmp_path: Path, browser: Browser) -> None:
    with PretendPrint(tmp_path / "ring") as printing:
        first = PageProcess(printing.run, PageSettings(port=0))
        port = int(Client(first.link).host.rsplit(":", 1)[1])
        with opened(browser, first.link, may_fail=True) as page:
            page.wait_for_selector("#run-state[data-state=printing]")
            first.close()
            banner(page, "No connection to the server", "use the switch at the printer")
            page.click("#stop-button")
            wait(page, "document.getElementById('stop-answer').textContent.includes('cannot be reached')")
            assert printing.is_lit
            with PageProcess(printing.run, PageSettings(port=port)):
                # The press that could not be sent goes through as soon as it can.
                page.wait_for_selector("#stop-button[data-state=confirmed]")
                wait(page, "document.getElementById('banner').hidden")
        assert not printing.is_lit


def test_a_print_that_was_killed_is_told_plainly(tmp_path: Path, browser: Browser) -> None:
    printing = PretendProcess(tmp_path / "ring")
    with PageProcess(tmp_path / "ring", PageSettings(port=0)) as process, opened(browser, process.link) as page:
        page.wait_for_selector("#run-state[data-state=printing]")
        printing.kill()
        banner(page, "has ended without finishing")
        assert page.is_disabled("#stop-button")


def test_a_script_in_the_name_of_a_part_is_a_name(tmp_path: Path, browser: Browser) -> None:
    run = tmp_path / "<script>document.title=2<"
    with (
        PretendPrint(run, Pretence(part=HOSTILE)) as printing,
        PageProcess(tmp_path, PageSettings(port=0)) as process,
        opened(browser, process.link) as page,
    ):
        printing.note("part", message=HOSTILE, **{HOSTILE: HOSTILE})
        assert HOSTILE in page.inner_text("#runs-list a >> nth=0")
        page.click("#runs-list a >> nth=0")
        wait(page, "document.getElementById('log').textContent.includes('onerror')")
        assert page.inner_text("#run-name") == f"{run.name} \N{MIDDLE DOT} {HOSTILE}"
        assert page.title() not in ("1", "2")
        assert page.locator("#log img, #runs-list img[src=x]").count() == 0


def test_a_finished_run_shows_its_end_its_report_its_files_and_a_time_lapse(tmp_path: Path, browser: Browser) -> None:
    with PretendPrint(tmp_path / "ring", Pretence(vertices=800)) as printing:
        while len(list_surfaces(printing.run)) < 2:
            time.sleep(0.05)
        printing._obey({"do": "stop"})
        assert printing.over.wait(15)
    with PageProcess(tmp_path, PageSettings(port=0)) as process, opened(browser, process.link) as page:
        wait(page, "document.querySelector('#runs-list img')?.naturalWidth > 50")
        assert "RMSE" in page.inner_text("#runs-list a")
        page.click("#runs-list a")
        wait(page, "document.getElementById('surface-numbers').textContent.includes('RMSE')")
        assert page.inner_text("#stop-button") == "Not printing"
        wait(page, "document.querySelectorAll('.projections canvas[style]').length === 9")
        with page.context.expect_page() as report:
            page.click("text=Open the report")
        assert report.value.inner_text("h1") == "Report of the ring"
        with page.expect_download() as download:
            page.click("text=Deviation, PLY")
        assert download.value.suggested_filename == "ring-deviation.ply"
        page.click("#timelapse-button")
        with page.expect_download(timeout=30_000) as video:
            page.click("text=Time-lapse, MP4", timeout=30_000)
        assert _frames_of(Path(video.value.path())) >= 2


def _frames_of(path: Path) -> int:
    import av

    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


def test_five_pages_are_kept_up_to_date_at_once(browser: Browser, client: Client, run_path: str) -> None:
    key = run_path.rsplit("/", 1)[1]
    context = browser.new_context(viewport={"width": 640, "height": 480})
    try:
        first = context.new_page()
        first.goto(client.link)
        first.wait_for_selector("#runs-list a")
        pages = [context.new_page() for _ in range(5)]
        for page in pages:
            page.goto(f"http://{client.host}/#run={key}")
        for page in pages:
            wait(page, "performance.getEntriesByName('snapshot').length > 3")
            assert page.is_hidden("#banner")
    finally:
        context.close()
