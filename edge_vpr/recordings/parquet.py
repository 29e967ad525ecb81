"""Apache Parquet, the format of the data sets of the paper's authors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edge_vpr.errors import RecordingError, import_extra
from edge_vpr.events import Columns
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy

_BUFFER_BYTES = 1 << 20
_EXTRA = "a .parquet file", "pyarrow", "parquet"


class ParquetSource(Source):
    """Source of the columns t, x, y and p, read in batches.

    Pre-buffering and memory mapping are off: with either, a file of one large row group would be
    held in memory whole. Arrow takes the memory that a page claims, and is not asked for the
    statistics of columns, which end the process if they are damaged.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with self._open(path) as file:
            schema = file.schema_arrow
            self._rows = file.metadata.num_rows
        matched = match_columns(schema.names, options.columns)
        if matched is None:
            raise RecordingError(
                f"{path} has the columns {', '.join(schema.names)}, and not t, x, y, p: name all "
                "of them in their order with columns="
            )
        self._names = matched.fields
        self._check_types(path, schema)
        super().__init__(path, options)
        self._unit = options.time_unit or matched.unit

    def _open(self, path: Path) -> Any:
        return import_extra("pyarrow.parquet", *_EXTRA).ParquetFile(
            path, buffer_size=_BUFFER_BYTES, pre_buffer=False, page_checksum_verification=True
        )

    def _check_types(self, path: Path, schema: Any) -> None:
        """Refuse columns of text and lists, whose values can have any length."""
        types = import_extra("pyarrow.types", *_EXTRA)
        for name in self._names.values():
            kind = schema.field(name).type
            if not (types.is_primitive(kind) and (kind.bit_width or 0) <= 64):
                raise RecordingError(f"{path}: column {name} has type {kind}: save numbers")

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        entry = 0
        with self._open(self.path) as file:
            batches = file.iter_batches(
                self.options.chunk_events, columns=list(self._names.values()), use_threads=False
            )
            for batch in batches:
                columns = {
                    name: batch.column(field).to_numpy(zero_copy_only=False)
                    for name, field in self._names.items()
                }
                self.position = min(1.0, (entry + batch.num_rows) / max(1, self._rows))
                yield tidy(columns, self._unit, log, entry)
                entry += batch.num_rows
