"""A print on the digital twin, seen in a browser from its start to its report."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from printing.prints import write_quick_plan
from vialight.web import PageProcess, PageSettings
from web.browser import chromium, opened, wait

pytestmark = pytest.mark.alone


@contextmanager
def printing(folder: Path) -> Iterator[str]:
    """Print as a user does, and give the link that it tells."""
    plan, rig = write_quick_plan(folder)
    command = [
        sys.executable, "-c", "from vialight.cli import main; main()", "print", str(plan),
        "--rig", str(rig), "--out", str(folder / "run"), "--resin", "DUDMA", "--bin", "4", "--stop", "manual",
        "--resin-voxel", "0.4", "--voxel", "0.4", "--serve",
    ]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            assert process.stdout is not None
            told = []
            for line in process.stdout:
                told.append(line)
                if found := re.search(r"open (http\S+)", line):
                    yield found[1]
                    break
            else:
                raise AssertionError("".join(told))
            process.stdout.read()  # a full pipe would hold it up
            assert process.wait(60) == 0
        finally:
            process.kill()


def test_a_print_on_the_twin_is_seen_from_start_to_report_and_stopped_on_the_way(tmp_path: Path) -> None:
    run = tmp_path / "run"
    with chromium() as browser, printing(tmp_path) as link, opened(browser, link, may_fail=True) as page:
        wait(page, "document.getElementById('run-state').textContent.startsWith('Recording the background')")
        wait(page, "document.getElementById('run-state').textContent.startsWith('Printing')", timeout_s=60)
        wait(page, "document.querySelectorAll('.projections canvas[style]').length === 9", timeout_s=60)
        wait(page, "/^The projector shows pattern \\d+ /.test(document.getElementById('pattern-caption').textContent)")
        wait(page, "document.getElementById('camera-caption').textContent.includes('as the rig has them')")
        wait(page, "/RMSE \\d/.test(document.getElementById('surface-numbers').textContent)", timeout_s=60)
        wait(page, "Number(document.getElementById('moment').max) >= 2", timeout_s=60)
        page.click("#stop-button")
        wait(page, "document.getElementById('stop-button').dataset.state === 'confirmed'")
        assert page.inner_text("#stop-answer").startswith("The projector shows black")
        wait(page, "document.getElementById('log').textContent.includes('page at 127.0.0.1')")
        wait(page, "document.getElementById('banner').textContent.includes('No connection')", timeout_s=60)
        port = int(link.split("/#")[0].rsplit(":", 1)[1])
        with PageProcess(run, PageSettings(port=port)):  # the command has ended; `vialight serve` takes over
            wait(page, "document.getElementById('run-state').textContent === 'Done'", timeout_s=60)
            measured = "document.getElementById('results-numbers').textContent.includes('RMSE, print to reference')"
            wait(page, measured, timeout_s=60)  # the print is measured once it is done
            with page.context.expect_page() as report:
                page.click("text=Open the report")
            assert "RMSE" in report.value.inner_text("main")
            report.value.close()
    assert json.loads((run / "run.json").read_text())["state"] == "done"
    assert "page at 127.0.0.1" in (run / "log.jsonl").read_text()
