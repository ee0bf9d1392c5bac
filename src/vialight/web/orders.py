"""Orders from the page to the running print: checked, sent, answered; Stop before everything else."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from vialight.core.errors import InputError
from vialight.printing.order_channel import send_order
from vialight.web.connections import Reserve
from vialight.web.runs import Run, cannot_tell, find_print

MODES = ("auto", "manual")
_MOST_TURNS = 100.0
_PATIENCE_S = 4.0
"""For a print's answer."""
_STOPS = 8
"""Presses of Stop, of different runs, that can be under way at once."""
_SPARE_DESCRIPTORS = 8
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
            if 0 < turns <= _MOST_TURNS:  # of every number, however large; and false of one that is none
                return {"do": "extend", "turns": float(turns)}
            raise InputError("order", "turns cannot be that many", accepted=f"more than 0, up to {_MOST_TURNS:g}")
    raise InputError("order", "is not one", accepted=_ACCEPTED)


class OrderDesk:
    """Sends orders on threads of its own, so that Stop waits neither for pictures nor for other orders.

    Parameters
    ----------
    reserve
        Descriptors for Stop, let go of where the process has none left.
    """

    def __init__(self, reserve: Reserve | None = None) -> None:
        self._reserve = Reserve(_SPARE_DESCRIPTORS) if reserve is None else reserve
        self._stops = ThreadPoolExecutor(_STOPS, "stop")
        self._others = ThreadPoolExecutor(2, "order")
        self._stopping: dict[str, asyncio.Future[dict[str, Any]]] = {}

    def close(self) -> None:
        """Let go of the threads."""
        self._stops.shutdown(wait=False)
        self._others.shutdown(wait=False)
        self._reserve.close()

    async def obey(self, run: Run, order: Mapping[str, Any], by: str) -> dict[str, Any]:
        """Return the print's answer; presses of Stop that come while one is under way share its answer.

        Raises
        ------
        InputError
            Nothing is printing there, or the print refuses.
        CannotTellError
            The print cannot be reached, does not answer in time, or it cannot be told whether there is one.
        """
        loop = asyncio.get_running_loop()
        if order["do"] != "stop":
            sent = loop.run_in_executor(self._others, _send, run, order, by)
        elif run.key in self._stopping:
            sent = self._stopping[run.key]
        else:
            sent = loop.run_in_executor(self._stops, self._reserve.spent_on, _send, run, order, by)
            self._stopping[run.key] = sent
            sent.add_done_callback(lambda _: self._forget(run.key, sent))
        try:
            # The press goes through whatever becomes of the page that waits for it.
            return await asyncio.wait_for(asyncio.shield(sent), _PATIENCE_S)
        except TimeoutError as error:
            self._forget(run.key, sent)  # the next press is not to wait for this one
            raise cannot_tell(f"it has not answered within {_PATIENCE_S:g} s") from error

    def _forget(self, key: str, sent: asyncio.Future[dict[str, Any]]) -> None:
        if self._stopping.get(key) is sent:
            del self._stopping[key]


def _send(run: Run, order: Mapping[str, Any], by: str) -> dict[str, Any]:
    link = find_print(run)
    if link is None:
        raise InputError("print", "is not running", remedy="nothing is to be done")
    try:
        return send_order(link, {**order, "by": by})
    except InputError as error:
        if error.__cause__ is None:
            raise  # the print itself refuses
        raise cannot_tell(str(error)) from error
    except OSError as error:
        raise cannot_tell(error.strerror or str(error)) from error
