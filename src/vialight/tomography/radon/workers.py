"""Threads that take shares of work as they become free.

Numba's own threads get even shares ahead and then wait for each other, awake.  Beside other processes, where one of two
cores may be busy, that takes twice as long and takes from the others what it waits.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue


class Workers:
    """The calling thread and some more; what they run has to release the interpreter's lock.

    Parameters
    ----------
    count
        Threads in all.

    Examples
    --------
    >>> squares = [0] * 5
    >>> Workers(2).run(5, lambda worker, task: squares.__setitem__(task, task**2))
    >>> squares
    [0, 1, 4, 9, 16]
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._others = ThreadPoolExecutor(count - 1, "vialight-worker") if count > 1 else None

    def run(self, tasks: int, work: Callable[[int, int], None]) -> None:
        """Call ``work(worker, task)`` for every task; calls with the same worker come one after another."""
        waiting: SimpleQueue[int] = SimpleQueue()
        for task in range(tasks):
            waiting.put(task)

        def take(worker: int) -> None:
            while True:
                try:
                    task = waiting.get_nowait()
                except Empty:
                    return
                work(worker, task)

        others = [self._others.submit(take, worker) for worker in range(1, self.count)] if self._others else []
        take(0)
        for other in others:
            other.result()
