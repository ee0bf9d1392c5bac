"""What every command does about errors, signals and progress, and how it shows its result."""

from __future__ import annotations

import json
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vialight.errors import InputError, VialightError, VialightWarning

if TYPE_CHECKING:
    from types import FrameType

BAD_INPUT = 2
FAILED = 1


def rig_named(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """Return the file of a rig that is named by its path, or as one that comes with vialight."""
    from vialight.twin import rig_file

    return None if value is None else rig_file(value)


@contextmanager
def faults_told() -> Iterator[None]:
    """Tell errors and warnings in a line each, and end with the exit code that belongs to them."""

    def stop(number: int, frame: FrameType | None) -> None:
        sys.exit(128 + number)

    # An exception, so that what is half-written is cleared away.
    signal.signal(signal.SIGTERM, stop)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", VialightWarning)
            yield
    except VialightError as error:
        click.echo(f"vialight: {error}", err=True)
        sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)
    except MemoryError:
        click.echo("vialight: not enough memory; choose a larger --voxel or --bin", err=True)
        sys.exit(FAILED)
    finally:
        for warning in caught:
            if issubclass(warning.category, VialightWarning):
                click.echo(f"vialight: warning: {warning.message}", err=True)


@contextmanager
def progress(unit: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a progress callback that draws a bar where stderr is a terminal."""
    from tqdm import tqdm

    with tqdm(unit=unit, disable=None, leave=False) as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield advance


def show(result: dict[str, Any], as_json: bool, lines: Callable[[], list[str]]) -> None:
    """Print a result, for programs or for people."""
    click.echo(json.dumps(result, indent=2) if as_json else "\n".join(lines()))


@contextmanager
def stopped_by_interrupt(
    message: str = "stopping after this pass with the best so far",
) -> Iterator[Callable[[], bool]]:
    """Yield a question that the first Ctrl-C answers with no; the second one interrupts as ever."""
    asked_to_stop = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal asked_to_stop
        asked_to_stop = True
        click.echo(message, err=True)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: not asked_to_stop
    finally:
        signal.signal(signal.SIGINT, before)
