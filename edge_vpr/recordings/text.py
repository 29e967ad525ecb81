"""Text with one event a line: ``t,x,y,p`` in any order, with or without a header."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import RecordingError
from edge_vpr.events import Columns, Events, Sensor
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source
from edge_vpr.recordings.table import match_columns, no_unit, on_events

# Kernel that parses lines of decimal numbers.


#: Status of a line: an event, an event whose time is no whole number as it is written, blank, or
#: unknown to the kernel.
GOOD, FRACTION, BLANK, STRANGE = range(4)


@kernel
def _separates(c, point):  # type: ignore[no-untyped-def]
    """Return whether a byte is a blank, a tab, CR, a quote, ``,`` or ``;``, and not the point."""
    return c == 32 or c == 9 or c == 13 or c == 34 or ((c == 44 or c == 59) and c != point)


@kernel
def _parse_lines(buffer, order, point, digits_to_us, out, starts, status):  # type: ignore[no-untyped-def]
    """Parse whole lines into ``out[field, line]``, and set where each line begins and its status.

    ``order[c]`` is the field of column ``c``: 0 to 3 for t, x, y, p; -1 to skip it. `point` stands
    before decimals: 46, or 44 for a comma.
    """
    line, i = 0, 0
    while i < buffer.size:
        starts[line] = i
        column, state = 0, GOOD
        while buffer[i] != 10:
            c = int(buffer[i])
            if _separates(c, point):
                i += 1
                continue
            negative = c == 45
            if c == 45 or c == 43:
                i += 1
            value, digits, decimals = 0, 0, -1
            seen = False  # whether a digit was read
            residue = False  # whether digits beyond the 18th are not 0
            while True:
                c = int(buffer[i])
                if 48 <= c <= 57:
                    if digits < 18:
                        value = value * 10 + (c - 48)
                        if decimals >= 0:
                            decimals += 1
                        if value > 0:
                            digits += 1
                    elif decimals < 0:
                        state = STRANGE
                    elif c != 48:
                        residue = True
                    seen = True
                elif c == point and decimals < 0:
                    decimals = 0
                else:
                    break
                i += 1
            c = int(buffer[i])
            if not seen or not (c == 10 or _separates(c, point)):
                state = STRANGE
            if state == STRANGE:
                break
            field = order[column] if column < order.size else -1
            if column >= order.size:
                state = STRANGE
                break
            if field == 0 and decimals >= 0:
                state = FRACTION
            decimals = max(decimals, 0)
            if field == 0:
                shift = digits_to_us - decimals
                while shift > 0:
                    if value > 922337203685477579:
                        state = STRANGE
                        break
                    value *= 10
                    shift -= 1
                if shift < 0:
                    unit = 1
                    while shift < 0 and unit < 1000000000000000000:
                        unit *= 10
                        shift += 1
                    rest = value % unit
                    value //= unit
                    # round to the nearest, ties to even, as Decimal does
                    if 2 * rest > unit or (2 * rest == unit and (residue or value % 2)):
                        value += 1
            elif field > 0 and decimals > 0:
                state = STRANGE  # includes 12.0, which is read slowly
            if state == STRANGE:
                break
            if field >= 0:
                out[field, line] = -value if negative else value
            column += 1
        while buffer[i] != 10:
            i += 1
        if state != STRANGE and column != order.size:
            state = STRANGE  # includes blank lines, which the slow reader recognises
        status[line] = state
        line += 1
        i += 1


_POINT, _COMMA = 46, 44
_SEPARATORS = {_POINT: str.maketrans(',;\t"', "    "), _COMMA: str.maketrans(',;\t"', ".   ")}
_DIGITS_TO_US = {"s": 6, "ms": 3, "us": 0, "ns": -3}
_BYTES_A_LINE = 24  # typical; only determines how much is read at once
_LONGEST_LINE = 1 << 16
_FIELDS = "txyp"
#: First line of the files that this package writes.
_COMMENT = "# edge-vpr sensor={sensor} start_us={start_us}\n"
_COMMENT_PATTERN = re.compile(
    rb"# edge-vpr sensor=([0-9]{1,5})x([0-9]{1,5}) start_us=(-?[0-9]{1,19})"
)
_SIZES_PATTERN = re.compile(rb"(?:\xef\xbb\xbf)?\s*([0-9]{1,9})[\s,;]+([0-9]{1,9})\s*")
#: A comment of other packages that states the size of the sensor, as ``%geometry:640,480``.
_GEOMETRY_PATTERN = re.compile(
    rb'["\s]{0,9}[#%]\s*(?:geometry|resolution|sensor.?size|sensor)[:=\s]{1,9}'
    rb'([0-9]{1,5})[x,;\s]{1,9}([0-9]{1,5})["\s]*',
    re.IGNORECASE,
)
#: Separators of a header, outside the brackets of a unit.
_HEADER_PATTERN = re.compile(r"[,;\t](?![^(\[]{0,40}[)\]])")
#: No number of an event has this many digits before the point, or zeros behind it.
_MOST_DIGITS = 40
_TRUTH = {"true": 1, "false": 0}


class TextSource(Source):
    """Source of lines of numbers between commas, semicolons, tabs or spaces; ``#`` starts comments.

    A comma in a line with semicolons or tabs is a decimal one. A first line of two whole numbers is
    the sensor's size (as in the rpg data sets); a comment of this package states the size and the
    start. Times are read as decimal numbers: seconds are converted to microseconds without rounding
    to a float.

    The parser is our own: of 5 million lines, pandas takes three times as long, and pyarrow 1.6
    times.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        head = _first_lines(path)
        self._skip, sensor, start_us, comment = 0, None, None, b""
        while head and (_is_comment(head[0]) or not head[0].strip()):
            comment = head.pop(0)
            if match := _COMMENT_PATTERN.fullmatch(comment.strip()):
                sensor = Sensor(int(match[1]), int(match[2]))
                start_us = int(match[3])
            elif match := _GEOMETRY_PATTERN.fullmatch(comment):
                sensor = Sensor(int(match[1]), int(match[2]))
            self._skip += len(comment)
        if head and (match := _SIZES_PATTERN.fullmatch(head[0])):
            sensor = Sensor(int(match[1]), int(match[2]))
            self._skip += len(head.pop(0))
        commas = any(b"," in line and (b";" in line or b"\t" in line) for line in head)
        self._point = _COMMA if commas else _POINT
        headed = bool(head) and any(
            _number(word) is None and word.lower() not in _TRUTH for word in self._split(head[0])
        )
        names = _names(head[0] if headed else comment)
        if headed:
            self._skip += len(head.pop(0))
        rows = [self._split(line) for line in head if line.strip() and not _is_comment(line)]
        self._order, stated = _find_order(path, names, headed, rows, options.columns)
        stated = options.time_unit or stated
        self._is_stated, self._unit = stated is not None or start_us is not None, stated or "us"
        super().__init__(path, options, sensor, start_us)

    def _split(self, line: bytes) -> list[str]:
        return _text(line).translate(_SEPARATORS[self._point]).split()

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        log.without_polarity = "p" not in self._order
        size = max(1, self.path.stat().st_size)
        block = self.options.chunk_events * _BYTES_A_LINE
        with self.path.open("rb") as file:
            file.seek(self._skip)
            entry, rest = 0, b""
            while data := file.read(block):
                data, newline, rest = (rest + data).rpartition(b"\n")
                self.position = file.tell() / size
                if len(rest) > _LONGEST_LINE:
                    raise RecordingError(
                        f"{self.path} has no line feed in {len(rest):,} bytes: this is no text "
                        "with one event a line"
                    )
                if newline:
                    columns, lines = self._parse(data + newline, log, entry)
                    entry += lines
                    yield columns
            if rest.strip():
                yield self._last_line(rest, log, entry)
        self.position = 1.0

    def _parse(self, data: bytes, log: FaultLog, entry: int) -> tuple[Columns, int]:
        buffer = np.frombuffer(data, np.uint8)
        order = np.array([_FIELDS.find(name) for name in self._order], np.int64)
        n = data.count(b"\n")
        out = np.ones((4, n), np.int64)
        starts = np.empty(n, np.int64)
        status = np.empty(n, np.uint8)
        _parse_lines(buffer, order, self._point, _DIGITS_TO_US[self._unit], out, starts, status)
        bad = []
        for i in np.flatnonzero(status == STRANGE).tolist():
            start = int(starts[i])
            line = data[start : data.index(b"\n", start)]
            status[i] = self._parse_slowly(line, out[:, i])
            if status[i] == STRANGE:
                bad.append((i, line))
        if bad:
            i, line = bad[0]
            shown = line.strip()[:60].decode("ascii", "replace")
            where = f"line {entry + i:,} of the events is no event ({shown!r})"
            log.unreadable(len(bad), where)
        if not self._is_stated and (status == FRACTION).any():
            raise no_unit(self.path, "have a decimal point or an exponent")
        good = (status == GOOD) | (status == FRACTION)
        t, x, y, p = out if good.all() else out[:, good]
        return Columns(t, x, y, on_events(p, self.path)), n

    def _parse_slowly(self, line: bytes, out: npt.NDArray[np.int64]) -> int:
        """Read a line that the kernel cannot: with exponents or ``true``; return its status."""
        words, status = self._split(line), GOOD
        if not words or _is_comment(line):
            return BLANK
        if len(words) != len(self._order):
            return STRANGE
        for name, word in zip(self._order, words, strict=True):
            value = _number(word)
            if name == "p" and value is None:
                value = _number(str(_TRUTH.get(word.lower(), word)))
            if name == "-":
                continue
            if value is None or (name in "xy" and value != int(value)):
                return STRANGE
            if name == "t":
                status = GOOD if word.lstrip("+-").isdigit() else FRACTION
                value = (value * Decimal(10) ** _DIGITS_TO_US[self._unit]).to_integral_value()
            if abs(value) >= 2**63:
                return STRANGE
            out[_FIELDS.index(name)] = int(value)
        return status

    def _last_line(self, rest: bytes, log: FaultLog, entry: int) -> Columns:
        """Read a last line without line feed, which may be cut off."""
        slow = np.ones((4, 1), np.int64)
        if self._parse_slowly(rest, slow[:, 0]) == STRANGE:
            log.truncated(len(rest), f"line {entry:,} of the events")
            t, x, y, p = slow[:, :0]
            return Columns(t, x, y, p > 0)
        return self._parse(rest + b"\n", log, entry)[0]


def _first_lines(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        lines = file.read(1 << 16).splitlines(keepends=True)
        if file.read(1):
            lines.pop()  # it is cut off
    return lines[:1000]


def _is_comment(line: bytes) -> bool:
    return line.lstrip(b' "\t\xef\xbb\xbf').startswith((b"#", b"%"))


def _text(line: bytes) -> str:
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def _names(line: bytes) -> list[str]:
    """Return the names of columns in a header: between commas, semicolons or tabs, else blanks."""
    text = _text(line).strip("\r\n")
    if _HEADER_PATTERN.search(text):
        names = [name.strip(' "') for name in _HEADER_PATTERN.split(text)]
    else:  # not before brackets, as of "t [us]"
        names = re.split(r" (?![\[(])", " ".join(text.replace('"', "").lstrip("#% ").split()))
    while names and not names[-1]:  # a comma at the end of each line
        names.pop()
    return names


def _find_order(
    path: Path, names: list[str], headed: bool, rows: list[list[str]], columns: str | None
) -> tuple[list[str], str | None]:
    """Return the column of each word of a line ("-" to skip it), and the unit of the times.

    Parameters
    ----------
    names : list of str
        Words of the header, or of the last comment before the first event.
    headed : bool
        Whether they are a header.
    rows : list of list of str
        Words of the first lines.
    columns : str or None
        Order given by the caller, which overrides the header.
    """
    widths = Counter(map(len, rows))
    width, number = widths.most_common(1)[0] if rows else (0, 0)
    named = None if columns else match_columns(names)
    if named and not headed and len(names) != width:
        named = None  # any comment
    unit = None
    if columns:
        order, named_by = list(columns), "columns= names"
    elif named:
        field = {name: column for column, name in named.fields.items()}
        order, named_by = [field.get(name, "-") for name in names], "the header names"
        unit = named.unit
    elif headed:
        raise RecordingError(
            f"{path} begins with {' '.join(names)!r}, which is no event and names no columns: "
            "head them t,x,y,p, or name them with columns=, for example columns='xytp'"
        )
    else:
        order, named_by = list("txy" if width == 3 else "txyp"), "t, x, y, p are"
    if width != len(order) and 2 * number > len(rows):
        raise RecordingError(
            f"{path} has {width} columns a line, and {named_by} {len(order)}: name all of them "
            "with columns=, and with - those to leave out, for example columns='-txyp'; write a "
            "time in two columns in one, and numbers with a decimal comma between semicolons"
        )
    return order, unit


def _number(word: str) -> Decimal | None:
    try:
        value = Decimal(word)
    except InvalidOperation:
        return None
    if not value.is_finite():
        return None
    if not value:
        return Decimal(0)
    # 1e999999999 is also a number, but its digits would fill the memory
    return value if abs(value.adjusted()) < _MOST_DIGITS else None


class TextSink:
    """Write ``t,x,y,p`` under a comment with sensor and start and a header; times in us."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        self._file = path.open("w", encoding="ascii", newline="\n")
        self._file.write(_COMMENT.format(sensor=sensor, start_us=start_us) + "t,x,y,p\n")

    def write(self, events: Events) -> None:
        """Append events."""
        columns = (column.tolist() for column in (events.t, events.x, events.y))
        polarity = events.p.view(np.uint8).tolist()
        self._file.writelines(map("{},{},{},{}\n".format, *columns, polarity))

    def close(self) -> None:
        """End the file."""
        self._file.close()
