"""What a print refuses before its first light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from printing.prints import recorded_rig
from twin.test_print import upright_cylinder
from vialight.core.errors import InputError
from vialight.printing import preflight
from vialight.printing.live.following import LiveSettings
from vialight.printing.live.watcher import LiveWatcher

IMAGE = np.zeros((30, 44), np.uint16)


def room(every_deg: float | None, turns: float = 40.0) -> int:
    settings = LiveSettings(Path(), Path(), recorded_rig(), 880.0, 30, upright_cylinder(2.5, 3.6), every_deg=every_deg)
    return LiveWatcher(settings).room_for((30, 44), turns)


def test_a_disk_that_holds_the_frames_but_not_the_volumes_is_refused(tmp_path: Path) -> None:
    preflight.check_room(tmp_path, IMAGE, 100, 0)
    with pytest.raises(InputError, match=r"100 frames may take .* volumes and all else .* 1000000000\.00 GB"):
        preflight.check_room(tmp_path, IMAGE, 100, 10**18)


def test_volumes_take_what_their_voxels_take_and_more_the_more_are_kept() -> None:
    assert room(None) == 0
    # A part of 5 x 5 x 3.6 mm and a millimetre about it, in voxels of half a pixel of 0.62 mm.
    volume = 4 * (7 / 0.31) ** 2 * (5.6 / 0.31)
    assert room(360.0) - room(360.0, turns=30.0) > 10 * volume
    assert room(90.0) - room(360.0) > 3 * 40 * volume
