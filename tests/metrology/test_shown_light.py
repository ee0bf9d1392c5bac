"""What a print says of the patterns that it has shown."""

from __future__ import annotations

from pathlib import Path

from vialight.metrology.kinetics.shown_light import patterns_shown


def test_refreshes_that_were_missed_count_as_showing_what_was_on_the_screen(tmp_path: Path) -> None:
    rows = ["1.0,1.0,7,7", "1.1,,8,7", "1.2,,9,7", "1.3,1.3,9,9", "1.4,1.4,-1,-1"]
    (tmp_path / "projector.csv").write_text("refresh_s,shown_s,due,shown\n" + "\n".join(rows) + "\n1.5,1")
    assert patterns_shown(tmp_path) == {"refreshes": 4, "refreshes_not_due": 2, "refreshes_off": 1}


def test_a_run_without_a_log_has_no_refreshes(tmp_path: Path) -> None:
    assert patterns_shown(tmp_path) == {"refreshes": 0, "refreshes_not_due": 0, "refreshes_off": 0}
