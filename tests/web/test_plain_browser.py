"""The page in a browser that cannot draw in 3-D; apart from the others, since Playwright has one browser at a time."""

from __future__ import annotations

import pytest

from web.browser import chromium, wait
from web.clients import Client

pytestmark = pytest.mark.alone


def test_without_webgl_a_page_says_so_and_shows_the_rest(client: Client, run_path: str) -> None:
    with chromium("--disable-gpu", "--disable-software-rasterizer") as plain:
        page = plain.new_page()
        faults: list[str] = []
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(client.link)
        page.click(f'a[href="#run={run_path.rsplit("/", 1)[1]}"]')
        wait(page, "performance.getEntriesByName('surface').length > 0")
        wait(page, "document.getElementById('surface-notice').textContent.includes('no WebGL')")
        wait(page, "document.querySelectorAll('.projections canvas[style]').length === 9")
        page.set_viewport_size({"width": 800, "height": 600})
        assert "RMSE" in page.inner_text("#surface-numbers")
        assert faults == []
