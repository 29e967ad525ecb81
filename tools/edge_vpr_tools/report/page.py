"""A self-contained HTML page: text, tables and figures in one file that can be sent on."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import Template

from edge_vpr import __version__
from edge_vpr.errors import escaped
from edge_vpr.files import replacing
from edge_vpr.records import json_text
from edge_vpr.results import RunRecord
from edge_vpr.settings import setting_words

_TEMPLATES = Path(__file__).parent / "templates"
#: pixels of a browser in a point of a figure
_PIXELS = 96 / 72
#: figures are enlarged by this on a screen that is wide enough
_ENLARGED = 1.25
#: colours of figures that differ on a dark page, and their names in page.css
_THEMED = {
    "#000000": "currentColor", "#ffffff": "var(--paper)", "#0072b2": "var(--blue)",
    "#56b4e9": "var(--sky)",
}  # fmt: skip
#: longer cells are text, even if they begin with a number
_LONGEST_NUMBER = 28
#: a number, followed by a space, a per cent sign or nothing; or a dash
_NUMBER = re.compile(r"(-?\d[\d,.]*(e[+-]?\d+)?|-)([ %]|$)")


@dataclass
class _Section:
    title: str = ""
    parts: list[str] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")

    def html(self) -> str:
        opening = f'<section id="{self.anchor}">\n' if self.anchor else "<section>\n"
        title = f"<h2>{as_html(self.title)}</h2>\n" if self.title else ""
        return f"{opening}{title}{''.join(self.parts)}</section>\n"


class Page:
    """Gathers the parts of a page as HTML and writes it at once, by ``templates/page.html``."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._sections = [_Section()]
        self._pictures = 0

    def _add(self, part: str) -> None:
        self._sections[-1].parts.append(part)

    def heading(self, text: str) -> None:
        """Start a section."""
        self._sections.append(_Section(text))

    def text(self, text: str) -> None:
        """Add a paragraph."""
        self._add(f"<p>{as_html(text)}</p>\n")

    def table(self, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Add a table; columns in which every cell is a number are aligned on the right."""
        rows = [tuple(cells) for cells in rows]
        columns = zip(*rows, strict=True) if rows else [()] * len(header)
        numbers = [any(column) and all(map(_is_number, column)) for column in columns]
        classes = [' class="number"' if number else "" for number in numbers]

        def row(cells: Sequence[str], tag: str, scope: str = "") -> str:
            marked = zip(cells, classes, strict=True)
            inner = (f"<{tag}{scope}{kind}>{as_html(text)}</{tag}>\n" for text, kind in marked)
            return f"<tr>\n{''.join(inner)}</tr>"

        label = ", ".join(map(as_html, header))
        head = row(header, "th", ' scope="col"')
        body = "".join(f"{row(cells, 'td')}\n" for cells in rows)
        self._add(
            f'<div class="scroll" role="region" tabindex="0" aria-label="{label}">\n<table>\n'
            f"<thead>{head}</thead>\n"
            f"<tbody>\n{body}</tbody>\n</table>\n</div>\n"
        )

    def verdict(self, text: str) -> None:
        """Add the most important sentence, in large letters."""
        # a number and its unit stay in one line
        text = re.sub(r"(?<=\d) (?=(s|%)\b|%)", "\u00a0", text)
        self._add(f'<p class="verdict">{as_html(text)}</p>\n')

    def warning(self, text: str) -> None:
        """Add a warning, in a box."""
        self._add(f'<p class="warning"><strong>Warning:</strong> {as_html(text)}</p>\n')

    def picture(self, svg: bytes, caption: str) -> None:
        """Add an SVG of Matplotlib, which becomes a part of the page and has its colours."""
        self._pictures += 1
        drawn = _themed(svg.decode("utf-8"), f"f{self._pictures}-")
        drawn = drawn.replace("<svg", f'<svg role="img" aria-label="{as_html(caption)}"', 1)
        size = _VIEW.search(drawn)
        width = round(float(size[1]) * _PIXELS * _ENLARGED) if size else 0
        self._add(
            f'<figure style="max-width: {width}px">\n{drawn}\n'
            f"<figcaption>{as_html(caption)}</figcaption>\n</figure>\n"
        )

    def folded(self, summary: str, text: str) -> None:
        """Add preformatted text, for example JSON, which opens on a click and is not printed."""
        self._add(
            f"<details>\n<summary>{as_html(summary)}</summary>\n"
            f"<pre>{as_html(text)}</pre>\n</details>\n"
        )

    def write(self, path: Path) -> None:
        """Write the page, atomically."""
        sections = [each for each in self._sections if each.parts or each.title]
        links = "".join(
            f'<a href="#{each.anchor}">{as_html(each.title)}</a>\n'
            for each in sections
            if each.title
        )
        menu = f'<nav aria-label="Sections">\n{links}</nav>\n' if len(sections) > 2 else ""
        text = Template((_TEMPLATES / "page.html").read_text(encoding="utf-8")).substitute(
            title=as_html(self._title),
            menu=menu,
            sections="".join(each.html() for each in sections),
            style=(_TEMPLATES / "page.css").read_text(encoding="utf-8").removesuffix("\n"),
            version=__version__,
        )
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


def as_html(text: str) -> str:
    """Escape a text for HTML, and control characters in it, such as those of a file name."""
    lines = (line.split("\u00a0") for line in text.split("\n"))
    return html.escape("\n".join("\u00a0".join(map(escaped, parts)) for parts in lines))


_VIEW = re.compile(r'viewBox="0 0 ([0-9.]+) ')
#: parts of an SVG file that a page does not need: metadata, fonts, the size, the global style
_OUTER = re.compile(
    r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|font-family: [^;\"]*;? ?"
    r'| (?:width|height)="[0-9.]+pt"',
    re.DOTALL,
)
_NAMED = re.compile(r'(\bid="|href="#|url\(#)')
_COLOUR = re.compile(rf"(?<=: )(?:{'|'.join(_THEMED)})\b")


def _themed(svg: str, prefix: str) -> str:
    """Return an SVG file of Matplotlib as an element of a page, in the colours of the page.

    Black is taken as ink, and white as paper. The prefix keeps the names within it apart from those
    of all other elements.
    """
    element = _OUTER.sub("", svg[svg.index("<svg") :])
    element = _NAMED.sub(rf"\1{prefix}", element)
    return _COLOUR.sub(lambda colour: _THEMED[colour[0]], element)


def _is_number(cell: str) -> bool:
    """Return whether a cell is a short number, perhaps with unit, bounds or spread."""
    return not cell or (len(cell) <= _LONGEST_NUMBER and _NUMBER.match(cell) is not None)


# The section of a report on settings, versions, machine and inputs.


_HASH_SHOWN = 16
_NAMES = {"python": "Python", "numpy": "NumPy", "numba": "Numba"}


def add_run(page: Page, record: RunRecord) -> None:
    """Add the contents of ``run.json``."""
    page.heading("Settings and versions")
    if record.command:
        program, *words = record.command
        page.text(f"Made by: {' '.join([Path(program).name, *words])} ({record.finished_utc}).")
    if record.settings:
        page.table(("setting", "value"), list(setting_words(record.settings).items()))
    versions = [(_NAMES.get(name, name), one) for name, one in record.versions.items()]
    where = [("system", record.machine.system), ("processor", record.machine.processor)]
    page.table(("software and machine", ""), [row for row in (*versions, *where) if row[1]])
    if record.inputs:
        page.heading("Inputs")
        page.table(
            ("file", "bytes", f"SHA-256, first {_HASH_SHOWN} digits"),
            [(one.path, f"{one.bytes:,}", one.sha256[:_HASH_SHOWN]) for one in record.inputs],
        )
    page.folded("The whole record of the run", json_text(record, indent=2))


# Text of quantities, with a suitable unit prefix and with bounds.


_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))


def quantity(
    value: float, unit: str, low: float | None = None, high: float | None = None, digits: int = 3
) -> str:
    """Write a value with its bounds, all three in one unit.

    Parameters
    ----------
    value : float
        Determines the prefix, from pico to none.
    low, high : float, optional
        Left out where both are equal.
    digits : int
        That count, below a thousand.

    Examples
    --------
    >>> quantity(0.004294, "J", 0.00397, 0.004325)
    '4.29 (3.97 to 4.33) mJ'
    """
    factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= f), _PREFIXES[-1])

    def written(number: float) -> str:
        scaled = number / factor
        return f"{scaled:,.0f}" if abs(scaled) >= 1_000 else f"{scaled:.{digits}g}"

    bounds = ""
    if low is not None and high is not None and low != high:
        bounds = f" ({written(low)} to {written(high)})"
    return f"{written(value)}{bounds} {prefix}{unit}"
