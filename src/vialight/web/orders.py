"""Orders from the page to the running print: checked, sent, answered; Stop before everything else."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from vialight.errors import InputError
from vialight.links import find_live_print, send_order
from vialight.web.catalogue import Run

MODES = ("auto", "manual")
_MOST_TURNS = 100.0
_ACCEPTED = '{"do": "stop"}, {"do": "extend", "turns": 1.0} or {"do": "mode", "mode": "auto"}'


def check_order(given: Any) -> dict[str, Any]:
    """Return what an order says, and nothing else that came with it.

    Raises
    ------
    InputError
        It is no order.

    Examples
    --------
    >>> check_order({"do": "extend", "turns": 2, "by": "someone else"})
    {'do': 'extend', 'turns': 2.0}
    """
    match given:
        case {"do": "stop"}:
            return {"do": "stop"}
        case {"do": "mode", "mode": str(mode)} if mode in MODES:
            return {"do": "mode", "mode": mode}
        case {"do": "extend", "turns": int(turns) | float(turns)} if not isinstance(turns, bool):
            if math.isfinite(turns) and 0 < turns <= _MOST_TURNS:
                return {"do": "extend", "turns": float(turns)}
            raise InputError("order", "turns cannot be that many", accepted=f"more than 0, up to {_MOST_TURNS:g}")
    raise InputError("order", "is not one", accepted=_ACCEPTED)


class OrderDesk:
    """Sends orders on threads of its own, so that Stop waits neither for pictures nor for other orders."""

    def __init__(self) -> None:
        self._stops = ThreadPoolExecutor(4, "stop")
        self._others = ThreadPoolExecutor(2, "order")
        self._stopping: dict[str, asyncio.Future[dict[str, Any]]] = {}

    def close(self) -> None:
        """Let go of the threads."""
        self._stops.shutdown(wait=False)
        self._others.shutdown(wait=False)

    async def obey(self, run: Run, order: Mapping[str, Any], by: str) -> dict[str, Any]:
        """Return the print's answer; presses of Stop that come while one is under way share its answer.

        Raises
        ------
        InputError
            Nothing is printing there, or the print refuses or does not answer.
        """
        loop = asyncio.get_running_loop()
        if order["do"] != "stop":
            return await loop.run_in_executor(self._others, _send, run, order, by)
        if run.key not in self._stopping:
            stopping = loop.run_in_executor(self._stops, _send, run, order, by)
            self._stopping[run.key] = stopping
            stopping.add_done_callback(lambda _: self._stopping.pop(run.key, None))
        # The press goes through whatever becomes of the page that waits for it.
        return await asyncio.shield(self._stopping[run.key])


def _send(run: Run, order: Mapping[str, Any], by: str) -> dict[str, Any]:
    link = find_live_print(run.folder)
    if link is None:
        raise InputError("print", "is not running", remedy="nothing is to be done")
    return send_order(link, {**order, "by": by})
