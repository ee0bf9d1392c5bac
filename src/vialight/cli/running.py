"""What every command does about errors, signals and progress, and how it shows its result."""

from __future__ import annotations

import atexit
import functools
import json
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vialight.core.errors import InputError, VialightError, VialightWarning
from vialight.system import LineWriter, StopAsked

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
        tell(f"vialight: {error}")
        sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)
    except MemoryError:
        tell("vialight: not enough memory; choose a larger --voxel or --bin")
        sys.exit(FAILED)
    finally:
        for warning in caught:
            if issubclass(warning.category, VialightWarning):
                tell(f"vialight: warning: {warning.message}")
        _terminal().flush()


def tell(text: str, *, is_line: bool = True) -> None:
    """Tell a person something; a terminal that nobody reads, or that is closed, holds up nothing and ends nothing."""
    _terminal().put(text + "\n" if is_line else text)


def is_terminal() -> bool:
    """Whether a person sees what is told, as it is told."""
    return sys.stderr is not None and sys.stderr.isatty()


@functools.cache
def _terminal() -> LineWriter:
    writer = LineWriter(_write_to_terminal)
    atexit.register(writer.close)
    return writer


def _write_to_terminal(text: str) -> None:
    """Write past Python's own buffer, whose lock a write that is held up would keep."""
    try:
        descriptor = sys.stderr.fileno()
    except (OSError, AttributeError, ValueError):  # no file, such as in a notebook
        click.echo(text, err=True, nl=False)
        return
    content = text.encode(errors="replace")
    while content:
        content = content[os.write(descriptor, content) :]


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
    with StopAsked(lambda: tell(message)) as asked:
        yield lambda: not asked
