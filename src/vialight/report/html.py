"""Pages as single files: the templates' environment, and pictures as part of the text."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vialight.store import staged_file

NONE = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"


@dataclass(frozen=True)
class Image:
    """A picture in a page.

    Parameters
    ----------
    title
        What it is.
    caption
        What a person should look for in it.
    alt
        What it shows, for those who do not see it.
    data
        The PNG in base64.
    """

    title: str
    caption: str
    alt: str
    data: str

    @classmethod
    def of(cls, png: bytes, title: str, caption: str, alt: str) -> Image:
        """Take a PNG as it is."""
        return cls(title, caption, alt, base64.b64encode(png).decode("ascii"))


def write_page(
    path: str | Path,
    template: str,
    content: Callable[[], Mapping[str, Any]],
    filters: Mapping[str, Callable[..., str]] | None = None,
) -> None:
    """Write a page as one HTML file; it appears whole, or not at all.

    Parameters
    ----------
    path
        The file to make.
    template
        One of ``vialight/report/templates``; all that it is given is escaped.
    content
        Makes what the template is given; asked for only once the file can be written.
    filters
        What the template calls to put values into words.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("vialight.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters or {}
    with staged_file(path) as staging:
        staging.write_text(environment.get_template(template).render(content()), encoding="utf-8")
