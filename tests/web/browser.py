"""A real browser for the tests of the page: Debian's chromium, driven by Playwright."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from needs import skip_without

FLAGS = (
    # WebGL without a graphics processor; the rest of the page is put together without OpenGL, six times as fast then.
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing",
    "--disable-dev-shm-usage", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run",
)  # fmt: skip
_PATIENCE_S = 20.0


def find_chromium() -> str:
    """Return the path of chromium; without it the test is skipped, but not where CI is to have it."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        skip_without("chromium is not installed: apt-get install chromium")
    return path


def all_flags(*more_flags: str) -> list[str]:
    """Return what chromium is started with."""
    # Chromium's own sandbox needs rights that root in a container does not have.
    return [*FLAGS, *more_flags, *(["--no-sandbox"] if os.geteuid() == 0 else [])]


@contextmanager
def chromium(*more_flags: str) -> Iterator[Browser]:
    """Start chromium."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=all_flags(*more_flags))
        try:
            yield browser
        finally:
            browser.close()


def wait(page: Page, condition: str, argument: Any = None, timeout_s: float = _PATIENCE_S) -> Any:
    """Wait until a JavaScript expression, or function of `argument`, is true, and return it.

    Playwright's own way to wait evaluates text in the page, which its security policy forbids, as it should.
    """
    deadline = time.monotonic() + timeout_s
    while not (found := page.evaluate(condition, argument)):
        assert time.monotonic() < deadline, f"it has not come true: {condition}"
        page.wait_for_timeout(30)
    return found


@contextmanager
def opened(
    browser: Browser, link: str, *, size: tuple[int, int] = (1024, 768), may_fail: bool = False
) -> Iterator[Page]:
    """Open a page, and find no fault in its console when it is left.

    Parameters
    ----------
    browser, link
        What opens what.
    size
        Of the window, in CSS pixels; a tablet's by default.
    may_fail
        Whether requests may: where a server is ended on purpose.
    """
    faults: list[str] = []
    context = browser.new_context(viewport={"width": size[0], "height": size[1]})
    try:
        page = context.new_page()
        page.set_default_timeout(15_000)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda said: faults.append(said.text) if said.type in ("error", "warning") else None)
        page.goto(link)
        yield page
    finally:
        context.close()
    # What WebGL in software says of itself is no fault of the page.
    told = [fault for fault in faults if "GPU stall" not in fault and "swiftshader" not in fault.lower()]
    if may_fail:
        told = [fault for fault in told if "Failed to load resource" not in fault and "WebSocket" not in fault]
    assert told == []
