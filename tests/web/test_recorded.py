from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vialight.core.errors import InputError
from vialight.store import write_frames
from vialight.web.recorded import pattern_shown, recorded_image


def test_a_frame_comes_back_with_its_time_and_angle(tmp_path: Path) -> None:
    counts = np.arange(24, dtype=np.uint16).reshape(3, 2, 4)
    write_frames(tmp_path / "frames.h5", counts, np.deg2rad([0, 20, 40]), time_s=[1.0, 2.0, 3.0])
    image = recorded_image(tmp_path, 1)
    assert np.array_equal(image.counts, counts[1])
    assert (image.frame, image.time_s, round(image.angle_deg, 9)) == (1, 2.0, 20.0)


@pytest.mark.parametrize("number", [-1, 3])
def test_a_frame_that_is_not_there_is_named(tmp_path: Path, number: int) -> None:
    write_frames(tmp_path / "frames.h5", np.zeros((3, 2, 4), np.uint16), [0, 1, 2])
    with pytest.raises(InputError, match=f"has no frame {number}; accepted: 0 to 2"):
        recorded_image(tmp_path, number)


def test_the_pattern_is_the_last_that_was_shown_by_then(tmp_path: Path) -> None:
    rows = ["refresh_s,shown_s,due,shown", "1.0,1.0,7,7", "1.1,,8,7", "1.2,1.2,9,9", "3.0,3.01,-1,-1", "3.1,3."]
    (tmp_path / "projector.csv").write_text("\n".join(rows))
    assert [pattern_shown(tmp_path, time_s) for time_s in (0.5, 1.0, 1.15, 2.0, 3.0, 9.0)] == [None, 7, 7, 9, 9, None]


@pytest.mark.parametrize("text", [None, "time_s,shown\n1,2\n", "refresh_s,shown_s,due,shown\n1,x,2,2\n"])
def test_a_log_that_cannot_be_read_says_so(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "projector.csv").write_text(text)
    with pytest.raises(InputError, match=r"projector\.csv: is not there, or cannot be read"):
        pattern_shown(tmp_path, 2.0)
