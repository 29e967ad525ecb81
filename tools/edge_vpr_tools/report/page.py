"""A self-contained HTML page: text, tables and figures in one file that can be sent on."""

from __future__ import annotations

import base64
import re
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from jinja2 import Environment, PackageLoader, StrictUndefined

from edge_vpr import __version__
from edge_vpr.archive import replacing

#: Matplotlib draws at 130 dots an inch, a browser shows 96
_SHOWN = 96 / 130
#: longer cells are text, even if they begin with a number
_LONGEST_NUMBER = 28
#: a number, followed by a space, a per cent sign or nothing; or a dash
_NUMBER = re.compile(r"(-?\d[\d,.]*(e[+-]?\d+)?|-)([ %]|$)")


@dataclass(frozen=True)
class _Text:
    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class _Table:
    kind: ClassVar[str] = "table"
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def is_number(self) -> tuple[bool, ...]:
        """Return whether each column holds numbers, which are aligned on the right."""
        columns = zip(*self.rows, strict=True) if self.rows else [()] * len(self.header)
        return tuple(any(column) and all(map(_is_number, column)) for column in columns)


@dataclass(frozen=True)
class _Picture:
    kind: ClassVar[str] = "picture"
    data: str
    caption: str
    width: int
    height: int


@dataclass(frozen=True)
class _Folded:
    kind: ClassVar[str] = "folded"
    summary: str
    text: str


@dataclass
class _Section:
    title: str = ""
    parts: list[_Text | _Table | _Picture | _Folded] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


class Page:
    """Gathers the parts of a page and writes it at once, by ``templates/page.html.jinja``."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._sections = [_Section()]

    def heading(self, text: str) -> None:
        """Start a section."""
        self._sections.append(_Section(text))

    def text(self, text: str) -> None:
        """Add a paragraph."""
        self._sections[-1].parts.append(_Text(text))

    def table(self, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Add a table; columns in which every cell is a number are aligned on the right."""
        self._sections[-1].parts.append(_Table(tuple(header), tuple(map(tuple, rows))))

    def picture(self, png: bytes, caption: str) -> None:
        """Add a PNG, which becomes a part of the page's file."""
        data = base64.b64encode(png).decode("ascii")
        # with the size, the browser reserves room for a picture before it is decoded
        width, height = struct.unpack(">II", png[16:24])
        shown = (round(width * _SHOWN), round(height * _SHOWN))
        self._sections[-1].parts.append(_Picture(data, caption, *shown))

    def folded(self, summary: str, text: str) -> None:
        """Add preformatted text, for example JSON, which opens on a click and is not printed."""
        self._sections[-1].parts.append(_Folded(summary, text))

    def write(self, path: Path) -> None:
        """Write the page, atomically."""
        pages = Environment(
            loader=PackageLoader(__package__),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        sections = [each for each in self._sections if each.parts or each.title]
        html = pages.get_template("page.html.jinja").render(
            title=self._title, sections=sections, version=__version__
        )
        with replacing(path) as temporary:
            temporary.write_text(html.lstrip(), encoding="utf-8")


def _is_number(cell: str) -> bool:
    """Return whether a cell is a short number, perhaps with unit, bounds or spread."""
    return not cell or (len(cell) <= _LONGEST_NUMBER and _NUMBER.match(cell) is not None)
