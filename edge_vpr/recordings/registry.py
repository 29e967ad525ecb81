"""Choice of the reader for a file: by its first bytes, then by its suffix."""

from __future__ import annotations

import io
from dataclasses import dataclass
from fractions import Fraction
from importlib import import_module
from pathlib import Path

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings.array_stream import ArrayStream
from edge_vpr.recordings.faults import check_policy
from edge_vpr.recordings.guard import foreign_errors
from edge_vpr.recordings.npz import Archive
from edge_vpr.recordings.prophesee import encoding_of
from edge_vpr.recordings.recording import Recording
from edge_vpr.recordings.source import CHUNK_EVENTS, ReadOptions


@dataclass(frozen=True)
class Format:
    """File format, and the module that reads (and perhaps writes) it.

    The module is imported when the first such file is opened. It has ``open_source(path, options)``
    and, if `writable`, ``open_sink(path, sensor, start_us)``.
    """

    name: str
    title: str
    module: str
    suffixes: tuple[str, ...] = ()
    writable: bool = False


#: All formats by their short names, which ``--format`` takes.
FORMATS: dict[str, Format] = {
    entry.name: entry
    for entry in (
        Format("npz", "NumPy archive of events", "npz", (".npz",), True),
        Format("npy", "NumPy array of events", "npy", (".npy",), True),
        Format("csv", "text, one event a line", "text", (".csv", ".txt"), True),
        Format("frames", "count frames in .npz or .npy, or a folder of PNG or .npy", "frames"),
        Format("parquet", "Apache Parquet", "parquet", (".parquet",), True),
        Format("evt2", "Prophesee RAW EVT 2.0", "evt", (".raw",), True),
        Format("evt21", "Prophesee RAW EVT 2.1", "evt"),
        Format("evt3", "Prophesee RAW EVT 3.0", "evt"),
        Format("dat", "Prophesee DAT", "dat", (".dat",), True),
        Format("aedat4", "iniVation AEDAT 4", "aedat4", (".aedat4",)),
        Format("aedat3", "cAER AEDAT 3.1", "aedat3"),
        Format("aedat2", "jAER AEDAT 2", "aedat2", (".aedat", ".aedat2")),
        Format("hdf5", "HDF5 (Metavision, DSEC)", "hdf5", (".h5", ".hdf5"), True),
        Format("rosbag1", "ROS 1 bag", "rosbag", (".bag",)),
        Format("rosbag2", "ROS 2 bag", "rosbag", (".db3", ".mcap")),
        Format("es", "Event Stream", "es", (".es",), True),
    )
}


def open_recording(
    path: str | Path,
    *,
    format: str | None = None,
    sensor: Sensor | None = None,
    on_fault: str = "error",
    frame_period: Fraction | None = None,
    chunk_events: int = CHUNK_EVENTS,
    topic: str | None = None,
    time_unit: str | None = None,
    columns: str | None = None,
) -> Recording:
    r"""Open a recording of any known format.

    Parameters
    ----------
    path : str or Path
        A file; a folder for a ROS 2 bag or for count frames.
    format : str, optional
        A name from :data:`FORMATS`; found from content and suffix if absent.
    sensor : Sensor, optional
        For files that do not state the size of their sensor. It is never guessed.
    on_fault : {"error", "drop"}
        Whether faults raise, or are left out and counted in ``Recording.faults``. Faults are time
        running backwards, pixels off the sensor, unreadable entries and a cut-off end.
    frame_period : Fraction, optional
        Seconds a frame, for count frames that do not state it.
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
    UsageError
        If an argument is wrong, or needed and absent.
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
    """
    path = Path(path)
    check_policy(on_fault)
    if chunk_events < 1:
        raise UsageError(f"chunk_events {chunk_events} is not positive: give 1 or more")
    if time_unit not in (None, "s", "ms", "us", "ns"):
        raise UsageError(f"time unit {time_unit!r} is unknown: choose s, ms, us or ns")
    if columns is not None and not {"t", "x", "y"} <= set(columns) <= set("txyp-"):
        raise UsageError(f"columns {columns!r} do not name t, x and y: write for example xytp")
    if frame_period is not None and frame_period <= 0:
        raise UsageError(f"frame period {frame_period} s is not positive: write for example 1/30")
    if format is not None and format not in FORMATS:
        raise UsageError(f"format {format!r} is unknown: choose one of {', '.join(FORMATS)}")
    if not path.exists():
        raise RecordingError(f"{path} does not exist: check the path")
    with foreign_errors(path):
        name = format or sniff(path)
        options = ReadOptions(name, sensor, frame_period, chunk_events, topic, time_unit, columns)
        reader = import_module(f"edge_vpr.recordings.{FORMATS[name].module}")
        return Recording(reader.open_source(path, options), on_fault)


def sniff(path: Path) -> str:
    """Find the format of a file or folder.

    Raises
    ------
    RecordingError
        If it cannot be read, is empty, or is of no known format.
    """
    if path.is_dir():
        return _sniff_folder(path)
    with foreign_errors(path), path.open("rb") as file:
        head = file.read(4096)
    if not head:
        raise RecordingError(f"{path} is empty (0 bytes): record or copy it again")
    name = _sniff_bytes(path, head)
    if name == "npy" and _dimensions(head, path) > 2:
        return "frames"
    if name is None:
        suffix = path.suffix.lower()
        # these formats have no signature; the first bytes identify all others
        if suffix in (".csv", ".txt") and b"\0" not in head:
            return "csv"
        if suffix == ".dat" and head.startswith(b"%"):
            return "dat"
        if suffix == ".raw":
            raise RecordingError(
                f"{path} has no header that names its encoding: pass --format evt2, evt21 or evt3"
            )
        known = ", ".join(sorted({s for f in FORMATS.values() for s in f.suffixes}))
        raise RecordingError(
            f"{path} has no known format: known are {known}, and folders of PNG, of .npy or of a "
            "ROS 2 bag; name the format with --format if the suffix is wrong"
        )
    return name


def _sniff_bytes(path: Path, head: bytes) -> str | None:
    if head.startswith(b"PK"):
        return _sniff_zip(path)
    for magic, name in (
        (b"\x93NUMPY", "npy"),
        (b"PAR1", "parquet"),
        (b"\x89HDF\r\n\x1a\n", "hdf5"),
        (b"#ROSBAG V2.0", "rosbag1"),
        (b"SQLite format 3\0", "rosbag2"),
        (b"\x89MCAP0\r\n", "rosbag2"),
        (b"#!AER-DAT4", "aedat4"),
        (b"#!AER-DAT3.1", "aedat3"),
        (b"#!AER-DAT2", "aedat2"),
        (b"Event Stream", "es"),
    ):
        if head.startswith(magic):
            return name
    if head.startswith(b"% "):
        return encoding_of(head)
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
    with Archive(path) as archive:
        members = set(archive.names)
    if "events" in members or {"t", "x", "y"} <= members:
        return "npz"
    if members & {"frames", "counts"}:
        return "frames"
    raise RecordingError(
        f"{path} holds {', '.join(sorted(members)) or 'nothing'}, and neither events (or t, x, "
        "y, p) nor frames nor counts: name its arrays so"
    )


def _sniff_folder(path: Path) -> str:
    if (path / "metadata.yaml").exists() or any(path.glob("*.db3")) or any(path.glob("*.mcap")):
        return "rosbag2"
    if any(path.glob("*.png")) or any(path.glob("*.npy")):
        return "frames"
    raise RecordingError(
        f"{path} is a folder without *.db3 or *.mcap (a ROS 2 bag), *.png or *.npy (count frames): "
        "name a recording"
    )
