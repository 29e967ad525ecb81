"""Apache Parquet, the format of the data sets of the paper's authors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar

from edge_vpr.errors import MissingExtraError, RecordingError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.reading import Columns, FaultLog, ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy

# Places and sizes of the pages of a Parquet file, read before Arrow reserves memory for them.
#
# Arrow trusts the size that a page's header states, up to 2 GiB. pyarrow ends the process where
# the statistics of a column chunk do not fit its schema; it is therefore not asked for the
# position of the chunk. Footer and page headers are structures of Thrift's compact protocol: a
# byte with type and field number before each value, and integers as zigzag varints
# (parquet.apache.org, "File Format"; Apache Thrift, "Compact Protocol").
#
# A child process with limits of memory and time would make this unnecessary, but costs 17 to 47 %
# more processor time (8 million events), and each pass begins 0.13 s later.


_LONGEST_HEADER = 1 << 16  # includes statistics
_DEEPEST = 8
_UNCOMPRESSED, _COMPRESSED = 2, 3  # fields of PageHeader
# fields of FileMetaData, RowGroup, ColumnChunk and ColumnMetaData
_ROW_GROUPS, _COLUMNS, _METADATA = 4, 1, 3
_PATH, _SIZE, _DATA_PAGE, _DICTIONARY_PAGE = 3, 7, 9, 11
_MAGIC = b"PAR1"
T = TypeVar("T")


class Page(NamedTuple):
    """Position of one page in the file, and its sizes in bytes without the header."""

    at: int
    compressed: int
    uncompressed: int


class ColumnChunk(NamedTuple):
    """One column of one row group: its name, and the position of its pages."""

    name: str
    start: int
    end: int


def read_column_chunks(file: IO[bytes]) -> list[ColumnChunk]:
    """Read the positions of all column chunks from the footer.

    Raises
    ------
    ValueError
        If the footer cannot be read.
    """
    size = file.seek(-8, 2) + 8
    tail = file.read(8)
    length = int.from_bytes(tail[:4], "little")
    if tail[4:] != _MAGIC or length > size - 8:
        raise ValueError("there is no footer")
    file.seek(size - 8 - length)
    footer = _Thrift(file.read(length)).structure()
    chunks = []
    for group in _field(footer, _ROW_GROUPS, list) or ():
        for column in _field(group, _COLUMNS, list) or ():
            facts = _field(column, _METADATA, dict) or {}
            path, data_page = _field(facts, _PATH, list), _number(facts, _DATA_PAGE)
            taken = _number(facts, _SIZE)
            if path is None or data_page is None or taken is None:
                raise ValueError("a column chunk does not say where it lies")
            # 0 and None both mean that there is no dictionary
            start = min(_field(facts, _DICTIONARY_PAGE, int) or data_page, data_page)
            if start < 0 or taken < 0:
                raise ValueError(f"a column chunk lies at byte {start:,}")
            name = b".".join(path).decode("utf-8", "replace")
            chunks.append(ColumnChunk(name, start, start + taken))
    return chunks


def read_pages(file: IO[bytes], start: int, end: int) -> list[Page]:
    """Read the headers of all pages between two positions in a file.

    Parameters
    ----------
    file : binary file
        Open for reading; its position is changed.
    start, end : int
        Of a column chunk.

    Raises
    ------
    ValueError
        If a header cannot be read.
    """
    pages, at = [], start
    while at < end:
        file.seek(at)
        header = _Thrift(file.read(min(_LONGEST_HEADER, end - at)))
        fields = header.structure()
        compressed, uncompressed = _number(fields, _COMPRESSED), _number(fields, _UNCOMPRESSED)
        if compressed is None or uncompressed is None or min(compressed, uncompressed) < 0:
            raise ValueError(f"the page at byte {at:,} states no size")
        pages.append(Page(at, compressed, uncompressed))
        at += header.at + compressed
    return pages


def _field(fields: dict[int, Any], number: int, kind: type[T]) -> T | None:
    """Return a field of a structure; None if it is absent.

    A field of another type is an error: Arrow skips it, and goes by one of that number before it.
    """
    value = fields.get(number)
    if value is not None and type(value) is not kind:
        raise ValueError(f"field {number} is a {type(value).__name__}, and not a {kind.__name__}")
    return value


def _number(fields: dict[int, Any], number: int) -> int | None:
    value = fields.get(number)
    return value if isinstance(value, int) else None


class _Thrift:
    """Reads a structure."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def structure(self, depth: int = 0) -> dict[int, Any]:
        """Read the fields of one structure, by their numbers."""
        if depth > _DEEPEST:
            raise ValueError("a structure is nested too deeply")
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            number = number + step if step else self._integer()
            # the type of a boolean field is also its value, which is not needed
            fields[number] = b"" if kind in (1, 2) else self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        """Read a value: a number, bytes, a list, a tuple (of a set) or a structure."""
        if kind in (1, 2, 3):
            return self._bytes(1)
        if kind in (4, 5, 6):
            return self._integer()
        if kind == 7:
            return self._bytes(8)
        if kind == 8:
            return self._bytes(self._varint())
        if kind in (9, 10):
            head = self._byte()
            values = [self._value(head & 15, depth) for _ in range(self._count(head >> 4))]
            return values if kind == 9 else tuple(values)
        if kind == 12:
            return self.structure(depth + 1)
        raise ValueError(f"a structure has a field of type {kind}")

    def _bytes(self, length: int) -> bytes:
        self.at += length
        return self._data[self.at - length : self.at]

    def _count(self, short: int) -> int:
        count = self._varint() if short == 15 else short
        if count > len(self._data):
            raise ValueError("a list is longer than the structure that holds it")
        return count

    def _byte(self) -> int:
        if self.at >= len(self._data):
            raise ValueError("a structure is cut off")
        self.at += 1
        return self._data[self.at - 1]

    def _varint(self) -> int:
        value, shift = 0, 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value
            if shift > 63:
                raise ValueError("a number has no end")

    def _integer(self) -> int:
        zigzag = self._varint()
        return zigzag >> 1 ^ -(zigzag & 1)


_SENSOR, _START = b"edge_vpr.sensor", b"edge_vpr.start_us"
_BUFFER_BYTES = 1 << 20
#: Most bytes of a page. A page is read whole; usual writers make pages of about 1 MB.
_LARGEST_PAGE = 1 << 27


def _pyarrow() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise MissingExtraError("a .parquet file", "pyarrow", "parquet") from error
    return pyarrow


class ParquetSource(Source):
    """Source of the columns t, x, y and p, read in batches.

    Pre-buffering and memory mapping are off: with either, a file of one large row group would be
    held in memory whole.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._pyarrow = _pyarrow()
        with self._open(path) as file:
            schema = file.schema_arrow
            self._rows = file.metadata.num_rows
        found = match_columns(schema.names, options.columns)
        if found is None:
            raise RecordingError(
                f"{path} has the columns {', '.join(schema.names)}, and not t, x, y, p: name all "
                "of them in their order with --columns"
            )
        self._names = found.fields
        self._check_types(path, schema)
        self._check_pages(path)
        facts = schema.metadata or {}
        sensor = Sensor.parse(facts[_SENSOR].decode()) if _SENSOR in facts else None
        stated = sensor is not None and _START in facts
        super().__init__(path, options, sensor, int(facts[_START]) if stated else None)
        self._unit = options.time_unit or found.unit or (None if sensor is None else "us")

    def _open(self, path: Path) -> Any:
        try:
            return self._pyarrow.parquet.ParquetFile(
                path, buffer_size=_BUFFER_BYTES, pre_buffer=False
            )
        except self._pyarrow.ArrowInvalid as error:
            raise RecordingError(
                f"{path} is damaged, cut off or no Parquet file ({error}): copy it again"
            ) from error

    def _check_types(self, path: Path, schema: Any) -> None:
        """Refuse columns of text and lists, whose values can have any length."""
        types = self._pyarrow.types
        for name in self._names.values():
            kind = schema.field(name).type
            if not (types.is_primitive(kind) and (kind.bit_width or 0) <= 64):
                raise RecordingError(f"{path}: column {name} has type {kind}: save numbers")

    def _check_pages(self, path: Path) -> None:
        """Refuse pages that claim more than the limit, before Arrow reserves memory for them."""
        wanted = set(self._names.values())
        with path.open("rb") as file:
            for chunk in read_column_chunks(file):
                if chunk.name not in wanted:
                    continue
                for page in read_pages(file, chunk.start, chunk.end):
                    if max(page.compressed, page.uncompressed) > _LARGEST_PAGE:
                        raise RecordingError(
                            f"{path}: the page at byte {page.at:,} claims {page.compressed:,} "
                            f"bytes for {page.uncompressed:,}, and the most is "
                            f"{_LARGEST_PAGE:,}: write it with smaller pages, or copy it again"
                        )

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        entry = 0
        with self._open(self.path) as file:
            batches = file.iter_batches(
                self.options.chunk_events, columns=list(self._names.values()), use_threads=False
            )
            try:
                for batch in batches:
                    columns = {
                        name: batch.column(field).to_numpy(zero_copy_only=False)
                        for name, field in self._names.items()
                    }
                    self.position = min(1.0, (entry + batch.num_rows) / max(1, self._rows))
                    yield tidy(columns, self._unit, log, entry)
                    entry += batch.num_rows
            except self._pyarrow.ArrowException as error:
                raise RecordingError(
                    f"{self.path} is damaged after event {entry:,} ({error}): copy it again"
                ) from error


class ParquetSink:
    """Write t (int64 us), x, y (uint16) and p (bool), with sensor and start in the metadata."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        pyarrow = self._pyarrow = _pyarrow()
        self._schema = pyarrow.schema(
            [
                ("t", pyarrow.int64()),
                ("x", pyarrow.uint16()),
                ("y", pyarrow.uint16()),
                ("p", pyarrow.bool_()),
            ],
            metadata={_SENSOR: str(sensor).encode(), _START: str(start_us).encode()},
        )
        # this encoding is made for values such as times, which differ little from one to the next
        self._writer = pyarrow.parquet.ParquetWriter(
            path,
            self._schema,
            compression="zstd",
            use_dictionary=["x", "y"],
            column_encoding={"t": "DELTA_BINARY_PACKED"},
        )

    def write(self, events: Events) -> None:
        """Append events."""
        columns = [self._pyarrow.array(events[name].copy()) for name in ("t", "x", "y", "p")]
        self._writer.write_batch(
            self._pyarrow.RecordBatch.from_arrays(columns, schema=self._schema)
        )

    def close(self) -> None:
        """Write the footer."""
        self._writer.close()
