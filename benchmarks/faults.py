"""Kill and stop every process of prints at every moment, with Stop and without: python benchmarks/faults.py.

Usage: ``python benchmarks/faults.py [--prints 500] [--seed 0] [--only projector] [--screen both] [--out faults.jsonl]
[--at-once 2]``.

Each print runs in all its processes, as ``vialight print`` does: on the simulated printer, and every fifth one with
instruments at real transports and a window under Xvfb.  One process is killed (SIGKILL) or stopped for a while
(SIGSTOP); in three of four prints somebody stops the print up to 0.4 s later: by the page, by Ctrl-C or by SIGTERM.
It must be dark 0.25 s after the fault and after Stop, by the wall clock; after Stop it must stay dark.  Frames that
others had been told are recorded must be readable afterwards, with the same counts, and every frame must have the angle
at which the stage truly stood.  With ``--out`` each result is kept, and a later run with the same seed goes on there.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import get_args

import numpy as np
from fault_scenes import Scene, SimulatedScene, window_scene
from fault_verdicts import DARK_WITHIN_S, Found
from faulty_prints import Case, Moment, Order, Victim, run_case

STOPPED_S = (0.0, 1.0, 3.0, 15.0)
"""For which processes are stopped; 0 kills them."""
_WINDOW_EVERY = 5
_NOT_WITH_A_WINDOW = {"display", "world"}
_LIVE = {"follower", "analyst"}


def main() -> None:
    """Go through the cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prints", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=get_args(Victim), help="process that faults befall")
    parser.add_argument("--moment", choices=get_args(Moment), help="only then")
    parser.add_argument("--screen", choices=("both", "simulated", "window"), default="both")
    parser.add_argument("--at-once", type=int, default=1, help="prints that run beside each other")
    parser.add_argument("--out", type=Path, help="JSON lines, one for each print")
    options = parser.parse_args()
    # A job in the background ignores Ctrl-C, and so would all that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    cases = list(itertools.islice(_cases(options), options.prints))
    done = _kept(options.out, cases)
    lock = threading.Lock()

    def run(number: int) -> None:
        case, begin = cases[number], time.monotonic()
        scene = scenes["window" if case.on_window else "simulated"]
        with at_the_window if case.on_window else contextlib.nullcontext():
            try:
                found = run_case(case, scene, np.random.default_rng((options.seed, number)))
            except Exception as error:  # one print must not end all others
                found = Found(str(case), case.victim, case.fault, odd=[f"could not be looked at: {error!r}"])
        with lock:
            done[number] = found
            if options.out is not None:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"number": number} | asdict(found)) + "\n")
            print(f"{number:4d} {time.monotonic() - begin:5.1f} s  {line(found)}", flush=True)

    at_the_window = threading.Lock()
    scenes: dict[str, Scene] = {"simulated": SimulatedScene()}
    with contextlib.ExitStack() as stack:
        if any(case.on_window for case in cases):
            scenes["window"] = stack.enter_context(window_scene())
        with ThreadPoolExecutor(options.at_once) as pool:
            list(pool.map(run, [number for number in range(len(cases)) if number not in done]))
    found = [done[number] for number in sorted(done)]
    print("\n" + table(found))
    sys.exit(any(one.faults() for one in found))


def line(found: Found) -> str:
    """Return what became of a print, in a line."""
    if found.was_gone:
        return f"{found.case}: {found.was_gone}" + "".join(f"  FAILED: {told}" for told in found.odd)
    order = "" if found.dark_after_order_s is None else f", {found.dark_after_order_s:.3f} s after Stop"
    was = "lit" if found.was_lit else "dark"
    told = "; ".join(found.faults())
    return (
        f"{found.case}: was {was}, dark after {found.dark_after_fault_s:.3f} s{order} (machine late by "
        f"{found.late_s:.3f} s); {found.acknowledged} frames acknowledged" + (f"  FAILED: {told}" if told else "")
    )


def table(all_found: list[Found]) -> str:
    """Return a table in Markdown, by process and fault."""
    lines = [
        "| process | fault | prints | lit then | dark after fault, s | dark after Stop, s | lit after Stop | frames "
        "acknowledged | lost | wrong angles | all else |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for victim in get_args(Victim):
        for fault in ("KILL", "STOP 1 s", "STOP 3 s", "STOP 15 s"):
            found = [one for one in all_found if (one.victim, one.fault) == (victim, fault) and not one.was_gone]
            if found:
                lines.append(_row(victim, fault, found))
    happened = [one for one in all_found if not one.was_gone]
    lines.append(_row("all", "", happened))
    wrong = sum(bool(one.faults()) for one in happened)
    lines.append(
        f"\n{len(all_found)} prints; in {len(all_found) - len(happened)} the process had ended before. {wrong} were "
        f"not as promised (dark within {DARK_WITHIN_S} s)."
    )
    return "\n".join(lines)


def _row(victim: str, fault: str, found: list[Found]) -> str:
    after_fault = max((one.dark_after_fault_s for one in found), default=0.0)
    after_order = max((one.dark_after_order_s or 0.0 for one in found), default=0.0)
    return (
        f"| {victim} | {fault} | {len(found)} | {sum(one.was_lit for one in found)} | {after_fault:.3f} | "
        f"{after_order:.3f} | {sum(one.lit_after_stop_s > 0 for one in found)} | "
        f"{sum(one.acknowledged for one in found)} | {sum(one.lost for one in found)} | "
        f"{sum(one.wrong_angles for one in found)} | {sum(bool(one.odd or one.lit_after_fault_s) for one in found)} |"
    )


def _cases(options: argparse.Namespace) -> Iterator[Case]:
    """Yield cases without end, each once before any comes again; every fifth with a window."""
    rng = np.random.default_rng(options.seed)
    simulated, window = (
        [
            case
            for case in all_cases(on_window=on_window)
            if options.only in (None, case.victim) and options.moment in (None, case.moment)
        ]
        for on_window in (False, True)
    )
    endless = [_shuffled_without_end(simulated, rng.spawn(1)[0]), _shuffled_without_end(window, rng.spawn(1)[0])]
    for number in itertools.count():
        is_window = (
            number % _WINDOW_EVERY == _WINDOW_EVERY - 1 if options.screen == "both" else options.screen == "window"
        )
        yield next(endless[is_window and bool(window)])


def _shuffled_without_end(cases: list[Case], rng: np.random.Generator) -> Iterator[Case]:
    while cases:
        yield from (cases[place] for place in rng.permutation(len(cases)))


def all_cases(*, on_window: bool) -> list[Case]:
    """Return every fault of every process at every moment at which it is there, with every kind of Stop."""
    return [
        Case(victim, stopped_s, moment, order, on_window)
        for victim in get_args(Victim)
        for stopped_s in STOPPED_S
        for moment in get_args(Moment)
        for order in get_args(Order)
        if not (on_window and victim in _NOT_WITH_A_WINDOW)
        and not (victim in _LIVE and moment == "preflight")  # they start with the background
        and not (victim != "print" and moment == "measuring" and order == "page" and victim not in _LIVE)
    ]


def _kept(path: Path | None, cases: list[Case]) -> dict[int, Found]:
    """Return what an earlier run has found, where it was of the same cases."""
    done: dict[int, Found] = {}
    if path is not None and path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            fields = json.loads(text)
            number = fields.pop("number")
            if number < len(cases):
                found = Found(**fields)
                if found.case != str(cases[number]):
                    sys.exit(f"{path}: print {number} was another one there; give its seed, or another file")
                done[number] = found
    return done


if __name__ == "__main__":
    main()
