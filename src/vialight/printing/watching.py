"""What a print asks of whoever measures it live."""

from __future__ import annotations

from typing import Protocol

from vialight.core.messages import StopForecast


class Watcher(Protocol):
    """Sees the print while it forms; lives in processes of its own and reads what is recorded."""

    def room_for(self, image_shape: tuple[int, int], turns: float) -> int:
        """Return the bytes that it may add to the run's folder in so many turns of the stage."""
        ...

    def start(self) -> None:
        """Begin to follow the recording, which exists by now; again after it has failed."""
        ...

    def is_ready(self) -> bool:
        """Whether it follows."""
        ...

    def fault(self) -> str | None:
        """Say what is wrong; None while it is well."""
        ...

    def has_ended(self) -> bool:
        """Whether it must be started again."""
        ...

    def forecast(self) -> StopForecast | None:
        """Return when the light should go off; None where that is not known yet."""
        ...

    def close(self) -> None:
        """Finish with what is recorded, and end."""
        ...
