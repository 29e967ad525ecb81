"""Event recordings of many formats behind one function.

>>> from edge_vpr.recordings import open_recording
>>> for events in open_recording("drive.raw"):  # doctest: +SKIP
...     ...

The reader of a file is found by its content and its suffix, the writer by the suffix. Then
`reading.Recording` checks the events of the reader and yields them.
"""

from __future__ import annotations

import contextlib
import io
import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, get_args

import numpy as np

from edge_vpr.errors import (
    EdgeVprError,
    RecordingError,
    UsageError,
    as_path,
    expect,
)
from edge_vpr.events import Columns, Events, Sensor, SensorSize, as_events, in_order
from edge_vpr.files import check_absent, open_input, replacing
from edge_vpr.plugins import Registry
from edge_vpr.recordings.frames import CountFrames, parse_period, read_count_frames
from edge_vpr.recordings.memory import FORMAT as MEMORY
from edge_vpr.recordings.memory import EventData, MemorySource, is_event_data
from edge_vpr.recordings.numpy_files import Archive, ArrayStream
from edge_vpr.recordings.reading import (
    CHUNK_EVENTS,
    NO_CAMERA,
    Camera,
    Faults,
    OnFault,
    ReadOptions,
    Recording,
    Source,
    TimeCrop,
    TimeUnit,
    crop_of,
    foreign_errors,
)
from edge_vpr.results import MATCHES, RUN, read_run

__all__ = [
    "FORMATS",
    "Columns",
    "CountFrames",
    "EventData",
    "Faults",
    "Format",
    "Recording",
    "Source",
    "TimeCrop",
    "open_recording",
    "parse_period",
    "read_count_frames",
    "write_recording",
]

# Choice of the reader for a file: by its first bytes, then by its suffix.


@dataclass(frozen=True)
class Format:
    """File format, and what reads and writes it, as ``module:name``.

    Modules of this package begin with a dot. They are imported when the first such file is opened.
    """

    name: str
    title: str
    source: str  #: Called with path and `ReadOptions`; returns a `Source`.
    sink: str = ""  #: Called with path, sensor and start; returns a `Sink`. Empty: never written.
    suffixes: tuple[str, ...] = ()
    magic: tuple[bytes, ...] = ()  #: With one of which each such file begins.

    def open_source(self, path: Path, options: ReadOptions) -> Source:
        """Open a file to read from."""
        source: Source = _imported(self.source)(path, options)
        return source

    def open_sink(self, path: Path, sensor: Sensor, start_us: int) -> Sink:
        """Open a file to write to."""
        sink: Sink = _imported(self.sink)(path, sensor, start_us)
        return sink


def _imported(name: str) -> Any:
    module, _, attribute = name.partition(":")
    return getattr(import_module(module, __package__), attribute)


#: All formats by their short names, which ``--format`` takes.
FORMATS: dict[str, Format] = {each.name: each for each in (
    Format("npz", "NumPy archive of events", ".numpy_files:NpzSource", ".numpy_files:NpzSink",
           (".npz",)),
    Format("npy", "NumPy array of events", ".numpy_files:NpySource", "", (".npy",),
           (b"\x93NUMPY",)),
    Format("csv", "text, one event a line", ".text:TextSource", ".text:TextSink", (".csv", ".txt")),
    Format("frames", "count frames in .npz or .npy, or a folder of PNG or .npy",
           ".frames:FrameSource"),
    Format("parquet", "Apache Parquet", ".parquet:ParquetSource", "", (".parquet",), (b"PAR1",)),
    Format("evt2", "Prophesee RAW EVT 2.0", ".prophesee:EvtSource", ".prophesee:Evt2Sink",
           (".raw",)),
    Format("evt21", "Prophesee RAW EVT 2.1", ".prophesee:EvtSource"),
    Format("evt3", "Prophesee RAW EVT 3.0", ".prophesee:EvtSource"),
    Format("aedat4", "iniVation AEDAT 4", ".aedat:Aedat4Source", "", (".aedat4",),
           (b"#!AER-DAT4",)),
    Format("aedat3", "cAER AEDAT 3.1", ".aedat:Aedat3Source", magic=(b"#!AER-DAT3.1",)),
    Format("aedat2", "jAER AEDAT 2", ".aedat:Aedat2Source", "", (".aedat", ".aedat2"),
           (b"#!AER-DAT2",)),
    Format("hdf5", "HDF5 (Metavision, DSEC)", ".hdf5:Hdf5Source", "", (".h5", ".hdf5"),
           (b"\x89HDF\r\n\x1a\n",)),
    Format("rosbag1", "ROS 1 bag", ".rosbag:BagSource", "", (".bag",), (b"#ROSBAG V2.0",)),
    Format("rosbag2", "ROS 2 bag", ".rosbag:BagSource", "", (".db3", ".mcap"),
           (b"SQLite format 3\0", b"\x89MCAP0\r\n")),
)}  # fmt: skip
#: What `sniff` calls a file whose header states its encoding; the reader finds which.
RAW = "raw"
_RAW = Format("", "Prophesee RAW", ".prophesee:EvtSource")
_TEXT = (".csv", ".txt", ".tsv")
#: Suffixes of the formats of this package that can be written.
WRITTEN = tuple(suffix for each in FORMATS.values() if each.sink for suffix in each.suffixes)

#: An entry point of this group names a module with ``SUFFIXES``, ``open_source(path, options)``
#: and perhaps ``open_sink(path, sensor, start_us)`` and ``TITLE``.
GROUP = "edge_vpr.formats"
_PLUGINS = Registry(GROUP, {})


def format_of(name: str) -> Format:
    """Return the format of a name, of this package or of another.

    Raises
    ------
    UsageError
        If there is none, or the import of the other package fails.
    """
    if name in FORMATS:
        return FORMATS[name]
    plugin = _PLUGINS.load(name)
    if plugin is None:
        formats = ", ".join([*FORMATS, *_PLUGINS.names()])
        raise UsageError(f"format {name!r} is unknown: choose one of {formats}")
    module, title = plugin.__name__, getattr(plugin, "TITLE", name)
    sink = f"{module}:open_sink" if hasattr(plugin, "open_sink") else ""
    return Format(name, title, f"{module}:open_source", sink, tuple(plugin.SUFFIXES))


def _plugin_of(suffix: str) -> Format | None:
    """Return the format of another package for a suffix.

    If there is none, raise the error of a package that cannot be imported: it may be the one.
    """
    failed = None
    for name in _PLUGINS.names():
        try:
            entry = format_of(name)
        except UsageError as error:
            failed = error
            continue
        if suffix in entry.suffixes:
            return entry
    if failed is not None:
        raise failed
    return None


def open_recording(
    path: str | Path | EventData,
    *,
    format: str | None = None,
    sensor: SensorSize | None = None,
    start: float | str | None = None,
    end: float | str | None = None,
    on_fault: OnFault = "error",
    frame_period: Fraction | float | str | None = None,
    default: Camera = NO_CAMERA,
    chunk_events: int = CHUNK_EVENTS,
    topic: str | None = None,
    time_unit: TimeUnit | None = None,
    columns: str | None = None,
) -> Recording:
    r"""Open a recording of any known format, or events in memory.

    Parameters
    ----------
    path : str or Path or EventData
        A file; a folder for a ROS 2 bag or for count frames. Or events that a program holds, which
        are read by the rules of tables: a structured array, an array of columns, a sequence of the
        four columns, a table (DataFrame, Arrow table, mapping), an item of a tonic data set, or a
        data set with one item.
    format : str, optional
        A name from :data:`FORMATS`, or of another package; found from content and suffix if absent.
    sensor : Sensor or (int, int) or str, optional
        Width and height, or ``"346x260"``, for files that do not state the size of their sensor.
        It is never guessed.
    start, end : float or str, optional
        Part of the recording to read, in seconds from its first event; `start` becomes time 0.
    on_fault : {"error", "drop"}
        Whether faults raise, or are left out and counted in ``Recording.faults``. Faults are time
        running backwards, pixels off the sensor, unreadable entries and a cut-off end.
    frame_period : Fraction or float or str, optional
        Seconds a frame, such as ``"1/30"``, for count frames that do not state it.
    default : Camera, optional
        Sensor and seconds a frame where neither the file nor the caller states them, as of a map.
    chunk_events : int
        Approximate number of events in a chunk.
    topic : str, optional
        Topic of a ROS bag, or stream of an AEDAT4 file, if there are several.
    time_unit : {"s", "ms", "us", "ns"}, optional
        For tables (csv, parquet, npy, npz, HDF5) whose unit is neither stated nor the usual one.
    columns : str, optional
        Order of the columns of a table without names, as ``"txyp"`` (the default) or ``"xytp"``;
        ``"-"`` skips a column.

    Raises
    ------
    RecordingError
        If the file is missing, empty, unreadable, or of an unknown format.

    Examples
    --------
    >>> import numpy as np, tempfile, edge_vpr.recordings as recordings
    >>> from edge_vpr.events import Sensor
    >>> path = Path(tempfile.mkdtemp()) / "three.csv"
    >>> _ = path.write_text("t,x,y,p\n100,0,0,1\n150,1,0,0\n150,1,1,1\n")
    >>> recording = recordings.open_recording(path, sensor=Sensor(2, 2))
    >>> [chunk["t"].tolist() for chunk in recording], recording.start_us
    ([[0, 50, 50]], 100)
    >>> later = recordings.open_recording(path, sensor="2x2", start="0.00004")
    >>> [chunk["t"].tolist() for chunk in later], later.start_us
    ([[10, 10]], 140)
    """
    if on_fault not in get_args(OnFault):
        raise UsageError(f"on_fault {on_fault!r} is unknown: choose error or drop")
    if type(chunk_events) is not int or chunk_events < 1:
        raise UsageError(f"chunk_events {chunk_events!r} is not positive: give a number from 1")
    if time_unit not in (None, *get_args(TimeUnit)):
        raise UsageError(f"time unit {time_unit!r} is unknown: choose s, ms, us or ns")
    for name, text in (("columns", columns), ("format", format), ("topic", topic)):
        if text is not None:
            expect(text, str, name, "text")
    if columns is not None and not {"t", "x", "y"} <= set(columns) <= set("txyp-"):
        raise UsageError(f"columns {columns!r} do not name t, x and y: write for example xytp")
    period = None if frame_period is None else parse_period(frame_period)
    chosen = None if format is None else format_of(format)
    crop = crop_of(start, end)
    size = None if sensor is None else Sensor.of(sensor)
    options = ReadOptions("", size, period, default, chunk_events, topic, time_unit, columns)
    if not isinstance(path, str | Path) and is_event_data(path):
        recording = Recording(MemorySource(path, replace(options, format=MEMORY)), on_fault)
    else:
        path = as_path(path, "a recording")
        check_file_or_folder(path)
        with foreign_errors(path):
            if chosen is None:
                try:
                    name = sniff(path)
                    chosen = _RAW if name == RAW else FORMATS[name]
                except RecordingError:
                    chosen = _plugin_of(path.suffix.lower())
                    if chosen is None:
                        raise
            options = replace(options, format=chosen.name)
            recording = Recording(chosen.open_source(path, options), on_fault)
    return recording if crop is None else recording.cropped(crop)


def check_file_or_folder(path: Path) -> None:
    """Refuse what cannot be read twice, or has no end: a pipe, a device or a socket.

    Raises
    ------
    RecordingError
        If there is nothing at `path`, or neither a file nor a folder, or the folder holds
        something that is neither.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            with os.scandir(path) as entries:
                odd = [Path(entry) for entry in entries if not (entry.is_file() or entry.is_dir())]
            for inner in odd:
                if inner.exists():  # a link to nothing does no harm
                    raise RecordingError(f"{inner} is neither a file nor a folder: remove it")
    except FileNotFoundError:
        raise RecordingError(f"{path} does not exist: check the path") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise RecordingError(f"{path} cannot be read: {reason}: check the path") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise RecordingError(f"{path} is neither a file nor a folder: write it to a file first")


def sniff(path: Path) -> str:
    """Find the format of a file or folder.

    Raises
    ------
    RecordingError
        If it cannot be read, is empty, or is of no known format.
    """
    if path.is_dir():
        return _sniff_folder(path)
    with foreign_errors(path), open_input(path) as file:
        head = file.read(4096)
    if not head:
        raise RecordingError(f"{path} is empty (0 bytes): record or copy it again")
    name = _sniff_bytes(path, head)
    if name == "npy" and _dimensions(head, path) > 2:
        return "frames"
    if name is None:
        suffix = path.suffix.lower()
        # these formats have no signature; the first bytes identify all others
        if head.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise RecordingError(f"{path} is text in UTF-16: save it as UTF-8")
        if suffix in _TEXT and b"\0" not in head:
            return "csv"
        if suffix == ".dat" and head.startswith(b"%"):
            raise RecordingError(f"{path} is a DAT file: {_BY_FAERY}")
        if suffix == ".raw":
            raise RecordingError(
                f"{path} has no header that names its encoding: pass format=, one of evt2, "
                "evt21 and evt3"
            )
        suffixes = ", ".join(sorted({s for f in FORMATS.values() for s in f.suffixes}))
        raise RecordingError(
            f"{path} has no known format: known are {suffixes}, and folders of PNG, of .npy or of "
            "a ROS 2 bag; name the format with format= if the suffix is wrong"
        )
    return name


_BY_FAERY = "convert it to .npz by faery, as docs/recordings.md says"


def _sniff_bytes(path: Path, head: bytes) -> str | None:
    if head.startswith(b"PK"):
        return _sniff_zip(path)
    for each in FORMATS.values():
        if head.startswith(each.magic):
            return each.name
    if head.startswith(b"Event Stream"):
        raise RecordingError(f"{path} is an Event Stream: {_BY_FAERY}")
    if head.startswith(b"% ") and path.suffix.lower() not in (*_TEXT, ".dat"):
        return RAW
    for magic, program in (
        (b"\x1f\x8b", "gzip"),
        (b"\xfd7zXZ\0", "xz"),
        (b"BZh", "bzip2"),
        (b"\x28\xb5\x2f\xfd", "zstd"),
        (b"\x04\x22\x4d\x18", "lz4"),
        (b"7z\xbc\xaf\x27\x1c", "7z"),
    ):
        if head.startswith(magic):
            raise RecordingError(f"{path} is compressed by {program}: unpack it first")
    if head.startswith(b"#!AER-DAT"):
        version = head[9:12].decode("ascii", "replace").strip()
        raise RecordingError(
            f"{path} is AEDAT {version}, and only 2, 3.1 and 4 are read: convert it with DV or jAER"
        )
    return None


def _dimensions(head: bytes, path: Path) -> int:
    """Return the number of axes of a NumPy array; 0 if its header is not readable."""
    try:
        return len(ArrayStream(io.BytesIO(head), str(path)).shape)
    except RecordingError:
        return 0  # the format's reader reports the fault


def _sniff_zip(path: Path) -> str:
    with foreign_errors(path), Archive(path) as archive:
        files = archive.names.values()
        if files and not any(name.endswith(".npy") for name in files):
            raise RecordingError(
                f"{path} is a zip archive of {', '.join(sorted(files)[:5])}: unpack it first"
            )
        if archive.table is not None:
            return "npz"
        members = set(archive.names)
    if members & {"frames", "counts"}:
        return "frames"
    raise RecordingError(
        f"{path} holds {', '.join(sorted(members)) or 'nothing'}, and neither events (or t, x, "
        "y, p) nor frames nor counts: name its arrays so"
    )


def _sniff_folder(path: Path) -> str:
    if (path / MATCHES).is_file() and (path / RUN).is_file():
        inputs = ", ".join(file.path for file in read_run(path).inputs)
        demo = "no recording: the demo's drive is street/query.npz of edge-vpr simulate -o street"
        of = f"{inputs}: name the recording among them" if inputs else demo
        raise RecordingError(f"{path} is a folder of results of {of}")
    if (path / "metadata.yaml").exists() or any(path.glob("*.db3")) or any(path.glob("*.mcap")):
        return "rosbag2"
    if any(path.glob("*.png")) or any(path.glob("*.npy")):
        return "frames"
    raise RecordingError(
        f"{path} is a folder without *.db3 or *.mcap (a ROS 2 bag), *.png or *.npy (count frames): "
        "name a recording"
    )


# Writing of recordings, which appear whole or not at all.


class Sink(Protocol):
    """Writer of one format: takes events in time order, then finishes the file."""

    def write(self, events: Events) -> None:
        """Append events."""

    def close(self) -> None:
        """Finish and close the file."""


def write_recording(
    path: str | Path,
    events: Iterable[Events] | Events,
    *,
    sensor: Sensor | None = None,
    start_us: int | None = None,
    overwrite: bool = False,
) -> int:
    """Write events in the format that the suffix of `path` names.

    The file appears under its name only when it is complete. Memory does not grow with the number
    of events.

    Parameters
    ----------
    path : str or Path
        With one of the suffixes of `WRITTEN`; .raw is EVT 2.0.
    events : Recording, other iterable of events, or events
        In time order, with times counted from the start.
    sensor : Sensor, optional
        Needed unless `events` has an attribute `sensor`, as a recording does.
    start_us : int, optional
        Time t = 0 on an outer clock; by default the attribute `start_us` of `events`, else 0. The
        file keeps it.
    overwrite : bool
        Whether a file that exists may be replaced.

    Returns
    -------
    int
        Number of events written.

    Raises
    ------
    RecordingError
        If the events do not fit the format, there are none, or the disk cannot be written.
    """
    path = as_path(path, "a recording")
    entry = writable_format(path)
    sensor = getattr(events, "sensor", None) if sensor is None else sensor
    start_us = getattr(events, "start_us", 0) if start_us is None else start_us
    if sensor is None:
        raise UsageError(f"{path} needs the size of the sensor: pass sensor=")
    sensor = Sensor.of(sensor)
    check_absent(path, overwrite)
    chunks: Iterable[Events] = (
        [as_events(events)] if isinstance(events, Events | np.ndarray) else events
    )
    expect(chunks, Iterable, "events", "events, or a recording that yields them")
    try:
        with replacing(path) as part:
            n = _fill(entry.open_sink(part, sensor, start_us), chunks, sensor)
            if n == 0:
                raise RecordingError(f"there are no events to write to {path}: check the input")
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be written: {error.strerror or error}: check space and permissions"
        ) from error
    return n


def _fill(sink: Sink, chunks: Iterable[Events], sensor: Sensor) -> int:
    n = 0
    try:
        for events in in_order(chunks, sensor):
            sink.write(events)
            n += events.size
    except BaseException:
        with contextlib.suppress(EdgeVprError, OSError):
            sink.close()  # the first error is reported
        raise
    sink.close()
    return n


def writable_format(path: Path) -> Format:
    """Return the format that a file of this suffix is written in."""
    entries = [entry for entry in FORMATS.values() if path.suffix in entry.suffixes]
    if not entries and (of_others := _plugin_of(path.suffix)) is not None:
        entries = [of_others]
    for entry in entries:
        if entry.sink:
            return entry
    raise UsageError(f"{path.suffix or path} cannot be written: choose one of {', '.join(WRITTEN)}")
