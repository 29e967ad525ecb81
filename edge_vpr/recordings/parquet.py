"""Apache Parquet, the format of the data sets of the paper's authors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edge_vpr.errors import MissingExtraError, RecordingError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.parquet_pages import read_column_chunks, read_pages
from edge_vpr.recordings.source import ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy

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
        found = match_columns(schema.names)
        if found is None:
            raise RecordingError(
                f"{path} has the columns {', '.join(schema.names)}, and not t, x, y, p: rename them"
            )
        self._names = found
        self._check_types(path, schema)
        self._check_pages(path)
        facts = schema.metadata or {}
        sensor = Sensor.parse(facts[_SENSOR].decode()) if _SENSOR in facts else None
        super().__init__(path, options, sensor)
        if sensor is not None and _START in facts:
            self.start_us, self.relative = int(facts[_START]), True
        self.unit_assumed = sensor is None and options.time_unit is None

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
                for page in read_pages(file, chunk.begin, chunk.end):
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
                    yield tidy(columns, self.options.time_unit, log, entry)
                    entry += batch.num_rows
            except self._pyarrow.ArrowException as error:
                raise RecordingError(
                    f"{self.path} is damaged after event {entry:,} ({error}): copy it again"
                ) from error


open_source = ParquetSource


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


open_sink = ParquetSink
