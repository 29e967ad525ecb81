"""Events that a program holds: an array, four columns, a table such as a DataFrame, a data set."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError, kind_of
from edge_vpr.events import EVENT_DTYPE, Columns, Events, Sensor
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source
from edge_vpr.recordings.table import array_columns, match_columns, tidy


class NamedTable(Protocol):
    """Table with named columns, as those of pandas, polars and Arrow."""

    @property
    def columns(self) -> Any:
        """Names of the columns (of Arrow, the columns)."""

    def __getitem__(self, name: Any, /) -> Any:
        """Return a column."""


#: Events in memory: `Events`, a structured array, an array with a column for each of t, x, y and p,
#: these four as a sequence, or a table of them by name (a DataFrame, a mapping).
EventData: TypeAlias = (
    Events | npt.NDArray[Any] | Sequence[npt.ArrayLike] | Mapping[str, npt.ArrayLike] | NamedTable
)
#: Stands for a path in messages.
_PLACE = Path("the event data")
FORMAT = "memory"


def is_event_data(recording: object) -> bool:
    """Return whether an object is events in memory or a data set of them, not a recording."""
    if hasattr(recording, "sensor"):  # an `EventSource`, which can be a named tuple
        return False
    return (
        isinstance(recording, Events | np.ndarray | tuple | list)
        or column_names(recording) is not None
        or hasattr(recording, "__array__")
        or _is_data_set(recording)
    )


def column_names(table: object) -> list[str] | None:
    """Return the names of the columns of an Arrow table, a DataFrame or a mapping."""
    for attribute in ("column_names", "columns"):
        names = getattr(table, attribute, None)
        if isinstance(names, Iterable) and hasattr(table, "__getitem__"):
            return [str(name) for name in names]
    return [str(name) for name in table] if isinstance(table, Mapping) else None


def _is_data_set(recording: object) -> bool:
    """Return whether an object is a data set of tonic, whose classes are not imported here."""
    return all(hasattr(recording, name) for name in ("sensor_size", "__len__", "__getitem__"))


def _is_sample(recording: object) -> bool:
    """Return whether an object is a pair of events and their target, not of two recordings."""
    if not isinstance(recording, tuple | list) or len(recording) != 2:
        return False
    events, target = recording
    names = _names_of(target)
    if isinstance(target, Events) or (names is not None and match_columns(names) is not None):
        return False
    two_axes = isinstance(events, np.ndarray) and events.ndim == 2
    return isinstance(events, Events) or two_axes or _names_of(events) is not None


def _names_of(events: object) -> list[str] | None:
    """Return the names of the columns of a table, or of the fields of an array."""
    if isinstance(events, np.ndarray):
        return None if events.dtype.names is None else list(events.dtype.names)
    return column_names(events)


class MemorySource(Source):
    """Source of events in memory, which are read by the rules for tables in files.

    Parameters
    ----------
    recording : EventData, or a sample or a data set of tonic
        Of a sample, a pair of events and target, the events are taken, of a data set its only item.
    options : ReadOptions
    """

    def __init__(self, recording: Any, options: ReadOptions) -> None:
        if options.topic is not None:
            raise UsageError("topic= is for files: leave it out for events in memory")
        if _is_data_set(recording):
            if len(recording) != 1:
                raise UsageError(
                    f"the data set holds {len(recording):,} recordings, and a drive is one: give "
                    "the events of one, dataset[0][0], with sensor=dataset.sensor_size; a map "
                    "learns further drives by route.update(dataset[1][0])"
                )
            options = replace(options, sensor=options.sensor or Sensor.of(recording.sensor_size))
            recording = recording[0]
        if _is_sample(recording):
            recording = recording[0]
        self._columns, self._unit = _columns_of(recording, options)
        sizes = {name: column.shape for name, column in self._columns.items()}
        if len(set(sizes.values())) > 1:
            listed = ", ".join(f"{name} {shape}" for name, shape in sizes.items())
            raise RecordingError(f"the event data has columns of shapes {listed}: give equal ones")
        # times of this package's own arrays count from the start of their recording
        own = isinstance(recording, Events) or (
            isinstance(recording, np.ndarray) and recording.dtype == EVENT_DTYPE
        )
        super().__init__(_PLACE, options, start_us=0 if own else None)

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        total, step = self._columns["t"].shape[0], self.options.chunk_events
        for first in range(0, total, step):
            self.position = min(1.0, (first + step) / total)
            part = {name: column[first : first + step] for name, column in self._columns.items()}
            yield tidy(part, self._unit, log, first)


def _columns_of(
    recording: Any, options: ReadOptions
) -> tuple[dict[str, npt.NDArray[Any]], str | None]:
    """Return the columns t, x, y and perhaps p as arrays, and the unit of t if it is stated."""
    order = options.columns
    if isinstance(recording, Events):
        return dict(zip("txyp", recording.columns, strict=True)), options.time_unit
    if (names := column_names(recording)) is not None:
        named = match_columns(names, order)
        if named is None:
            raise RecordingError(
                f"the event data has the columns {', '.join(names)}, and not t, x, y, p: "
                "name all of them in their order with columns='xytp', for example"
                + ", or make a column of the index (reset_index)"
                * hasattr(recording, "reset_index")
            )
        columns = {name: np.asarray(recording[field]) for name, field in named.fields.items()}
        return columns, options.time_unit or named.unit
    if isinstance(recording, tuple | list):
        wanted = order or "txyp"[: len(recording)]
        if len(recording) < 3 or len(recording) != len(wanted):
            raise UsageError(
                f"the event data is a sequence of {len(recording)}: give t, x, y and p as four "
                "arrays, or name their order with columns='xytp', for example; of a data set's "
                "sample its events, such as dataset[0][0]; of several recordings one, as a drive "
                "is (a map learns others by route.update), or np.concatenate of the parts of one"
            )
        arrays = [np.asarray(column) for column in recording]
        columns = {name: a for name, a in zip(wanted, arrays, strict=True) if name != "-"}
        return columns, options.time_unit
    array = np.asarray(recording)
    if array.ndim == 0:
        raise UsageError(f"the event data is {kind_of(recording)}: give an array of events")
    if array.ndim > 2:
        raise UsageError(
            f"the event data has shape {array.shape}: if these are frames of counts, save them as "
            "(frames, height, width) by np.save and give "
            "edge_vpr.PublishedWindows('frames.npy', frame_period=0.1), each a window"
        )
    layout = array_columns(str(_PLACE), array.dtype, array.shape, order)
    return layout.of(array), options.time_unit or layout.unit
