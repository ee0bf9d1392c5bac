"""Ctrl-C, which a terminal sends to every process that was started from it."""

from __future__ import annotations

import signal


def leave_interrupts_to_the_print() -> None:
    """Go on when the user presses Ctrl-C: what that ends, and when, is for the process that prints to decide.

    For processes that a print has started, called first of all.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
