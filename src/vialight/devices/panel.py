"""What every process that has to do with the light sees at once: the stop switch, and when each was last alive.

It is a few numbers in shared memory.  Nobody waits for anybody: a process that hangs, or whose messages are held up,
cannot keep the switch from being pressed or seen.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from vialight.system import make_shared_file, map_shared_file, words_of

Beating = Literal["projector", "guardian", "follower", "analyst"]
_STOP, _ENDED, _COVERED, _FIRST_BEAT = range(4)
_PLACES: dict[str, int] = {name: place for place, name in enumerate(get_args(Beating), start=_FIRST_BEAT)}
_COUNT = _FIRST_BEAT + len(_PLACES)
_NAME = "panel"


class LightPanel:
    """The stop switch and the heartbeats of one print.

    Parameters
    ----------
    folder
        The print's shared folder.
    is_new
        Whether it is to be made: the switch is not pressed, and nobody has been alive yet.

    Raises
    ------
    InputError
        There is none, or no room for one.

    Examples
    --------
    >>> import shutil
    >>> from vialight.system import shared_folder
    >>> folder = shared_folder()
    >>> panel, other = LightPanel(folder, is_new=True), LightPanel(folder)
    >>> panel.is_stopped, other.press_stop(), panel.is_stopped
    (False, None, True)
    >>> panel.age_s("projector")
    inf
    >>> other.beat("projector")
    >>> panel.age_s("projector") < 1
    True
    >>> panel.is_dark_for_good, other.tell_ended(), panel.is_dark_for_good
    (False, None, True)
    >>> shutil.rmtree(folder)
    """

    def __init__(self, folder: Path, *, is_new: bool = False) -> None:
        path, size = folder / _NAME, 8 * _COUNT
        if is_new:
            make_shared_file(path, size)
        # Each number is written and read by one instruction, so that it is never seen half.
        self._numbers = words_of(map_shared_file(path, size)).view(np.float64)

    @classmethod
    def of(cls, folder: Path) -> LightPanel:
        """Return the panel of a folder; where there is none, such as for a replay without light, one is made."""
        return cls(folder, is_new=not (folder / _NAME).exists())

    @property
    def is_stopped(self) -> bool:
        """Whether the switch has been pressed."""
        return bool(self._numbers[_STOP] != 0.0)

    def press_stop(self) -> None:
        """End the light for good: there is no way to release the switch."""
        self._numbers[_STOP] = 1.0

    @property
    def is_dark_for_good(self) -> bool:
        """Whether the light has ended, as seen where it comes from: nothing can light any more in this print."""
        return bool(self._numbers[_ENDED] != 0.0 or self._numbers[_COVERED] != 0.0)

    def tell_ended(self) -> None:
        """Say that the projector shows black, and will not show anything else: for who shows it."""
        self._numbers[_ENDED] = 1.0

    def tell_covered(self) -> None:
        """Say that the projector's light is covered: for the guardian."""
        self._numbers[_COVERED] = 1.0

    def beat(self, who: Beating) -> None:
        """Say that a process is alive."""
        self._numbers[_PLACES[who]] = time.monotonic()

    def last_beat_s(self, who: Beating) -> float:
        """Return when a process was alive last, by `time.monotonic`; 0 where it never was."""
        return float(self._numbers[_PLACES[who]])

    def age_s(self, who: Beating) -> float:
        """Return for how long a process has given no sign of life; infinite where it never has."""
        now, last = time.monotonic(), self.last_beat_s(who)
        return now - last if last > 0 else float("inf")
