"""Bags of ROS 1 and ROS 2, read message by message with rosbags."""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from edge_vpr.errors import EdgeVprError, MissingExtraError, RecordingError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings.decompression import bzip2, lz4, zstd
from edge_vpr.recordings.event_packet import (
    Cursor,
    PacketDecoder,
    read_event_array,
    read_preamble,
)
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.rosbag_expansion import expand_bag
from edge_vpr.recordings.source import Columns, ReadOptions, Source

#: Message types of one structure an event, and of packets of a camera's own words.
_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_PACKETS = ("event_camera_msgs/msg/EventPacket", "event_array_msgs/msg/EventArray")


#: rosbags' names of what a file of a ROS 2 bag is, by its suffix.
_STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
_LONGEST_METADATA = 1 << 22


class _BoundedFile(io.BufferedReader):
    """A file of which no read asks for more than there is: rosbags believes announced sizes."""

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, os.fstat(self.fileno()).st_size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


class _BoundedPath(type(Path())):  # type: ignore[misc]  # of the platform's own kind
    """A path whose files are :class:`_BoundedFile`."""

    def open(self, mode: str = "r", *args: Any, **options: Any) -> Any:
        """Open the file; for reading bytes, with bounded reads."""
        if mode != "rb":
            return super().open(mode, *args, **options)
        return _BoundedFile(super().open(mode, buffering=0))


class BagSource(Source):
    """The messages of one topic.

    Times of event arrays are wall-clock times. Packets have the camera's clock; there the start is
    the time stamp of the first packet, which lines up with other topics and with GPS.
    """

    def __init__(self, path: Path, options: ReadOptions, ros: int) -> None:
        self._ros = ros
        self._rosbags = _load(ros)
        self._place = _place(path) if ros == 2 else path
        self.path = path
        try:
            if ros == 2 and self._place.is_dir():
                self._place = expand_bag(self._place, self)
            with self._open() as reader:
                connection = _choose(reader.connections, options.topic, path)
                self._topic = connection.topic
                self._packets = connection.msgtype in _PACKETS
                self._total = sum(
                    c.msgcount for c in reader.connections if c.topic == connection.topic
                )
                preamble = self._first(reader)
        except EdgeVprError:
            raise
        except MemoryError:
            raise
        except Exception as error:  # rosbags raises what its parsers raise
            raise _unreadable(path, ros, error) from error
        size = Sensor(preamble.width, preamble.height) if preamble and preamble.width else None
        super().__init__(path, options, size)
        if self._packets and preamble is not None:
            self.start_us = preamble.stamp_us
        self.position = 0.0

    @contextmanager
    def _open(self) -> Iterator[Any]:
        """Open the bag with rosbags, with a limit on what its parts may expand to."""
        if self._ros == 2:
            _limit_mcap()
        with self._rosbags.Reader(_BoundedPath(self._place)) as reader:
            if self._ros == 1:
                reader.chunks = {at: _limited(chunk) for at, chunk in reader.chunks.items()}
            self._expand = self._take_over(reader)
            yield reader

    def _take_over(self, reader: Any) -> Callable[[bytes], bytes]:
        """Return how messages are decompressed, which rosbags would do without a limit."""
        storage = getattr(reader, "storage", None)
        mode = getattr(getattr(storage, "metadata", None), "compression_mode", None)
        if mode != "message" or storage is None:
            return bytes
        storage.metadata = storage.metadata._replace(compression_mode=None)
        return zstd(str(self.path), "ros")

    def _messages(self, reader: Any) -> Iterator[bytes]:
        connections = [c for c in reader.connections if c.topic == self._topic]
        for _, _, data in reader.messages(connections=connections):
            yield self._expand(data)

    def _first(self, reader: Any) -> Any:
        for data in self._messages(reader):
            return read_preamble(Cursor(data, self._ros), self._ros)
        return None

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a message at a time; see :class:`Source`."""
        packets = PacketDecoder()
        message = undated = 0
        try:
            with self._open() as reader:
                for message, data in enumerate(self._messages(reader), 1):
                    cursor = Cursor(data, self._ros)
                    read_preamble(cursor, self._ros)
                    columns = (
                        packets.read(cursor)
                        if self._packets
                        else read_event_array(cursor, self._ros)
                    )
                    self.position = message / max(1, self._total)
                    step = self.options.chunk_events
                    for i in range(0, columns.t.size, step):
                        yield Columns(*(column[i : i + step] for column in columns))
                    log.undated(packets.undated - undated)
                    undated = packets.undated
        except EdgeVprError:
            raise
        except struct.error as error:
            raise RecordingError(
                f"{self.path}: message {message:,} on {self._topic} is cut off ({error}): "
                "record or copy the bag again"
            ) from error
        except MemoryError:
            raise
        except Exception as error:  # rosbags raises what its parsers raise
            raise _unreadable(self.path, self._ros, error) from error


def _load(ros: int) -> Any:
    try:
        return import_module(f"rosbags.rosbag{ros}")
    except ImportError as error:
        raise MissingExtraError("a ROS bag", "rosbags", "ros") from error


def _place(path: Path) -> Path:
    """Return the path that rosbags opens: the folder of a bag, or a single file of it.

    A file is opened with the others of its bag where ``metadata.yaml`` lists it. Where that is
    absent or cannot be used, the file is opened on its own.

    Raises
    ------
    RecordingError
        If a folder holds several files, and its ``metadata.yaml`` is missing or cannot be used.
    """
    folder = path if path.is_dir() else path.parent
    listing = folder / "metadata.yaml"
    if not path.is_dir() and not listing.exists():
        return path
    fault = _metadata_fault(listing) if listing.exists() else "is missing"
    if not fault:
        return folder
    if not path.is_dir():
        return path
    files = [file for file in sorted(folder.iterdir()) if file.suffix in _STORAGES]
    if len(files) == 1:
        return files[0]
    raise RecordingError(
        f"{listing} {fault}: make it again with ros2 bag reindex, or name one file of the bag"
    )


def _metadata_fault(listing: Path) -> str:
    """Return why rosbags cannot use a ``metadata.yaml``; "" if it can."""
    if listing.stat().st_size > _LONGEST_METADATA:
        return f"is larger than {_LONGEST_METADATA:,} bytes"
    from ruamel.yaml import YAML  # rosbags' own parser

    try:
        facts = YAML(typ="safe").load(listing.read_text("utf-8"))["rosbag2_bagfile_information"]
        storage, names = facts["storage_identifier"], facts["relative_file_paths"]
        suffixes = {Path(name).suffix for name in names}
    except Exception as error:  # the parser raises what it comes across
        return f"is damaged ({type(error).__name__}: {error})"
    if storage not in _STORAGES.values():
        return f"has the storage identifier {storage!r}, and not {' or '.join(_STORAGES.values())}"
    if facts.get("compression_mode", "").lower() not in ("file",) and suffixes != {
        suffix for suffix, name in _STORAGES.items() if name == storage
    }:
        return f"has the storage identifier {storage!r} for files {', '.join(map(str, names))}"
    return ""


def _limit_mcap() -> None:
    """Give rosbags' decompressors of MCAP chunks a limit; it has none of its own."""
    storage = import_module("rosbags.rosbag2.storage_mcap")
    for name, limited in (("lz4", lz4("MCAP", "ros")), ("zstd", zstd("MCAP", "ros"))):
        storage.DECOMPRESSORS[name] = lambda data, _, limited=limited: limited(data)


def _limited(chunk: Any) -> Any:
    """Return a chunk of a ROS 1 bag whose decompression has a limit."""
    name = getattr(chunk.decompressor, "__module__", None)
    if name in ("bz2", "_bz2"):
        return chunk._replace(decompressor=bzip2)
    if name is not None and name.startswith("lz4"):
        return chunk._replace(decompressor=lz4("a ROS bag", "ros"))
    return chunk


def _choose(connections: Any, wanted: str | None, path: Path) -> Any:
    known = [c for c in connections if c.msgtype in _ARRAYS + _PACKETS]
    if wanted is not None:
        known = [c for c in known if c.topic == wanted]
    topics = {c.topic: c.msgtype for c in connections}
    if not known:
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in topics.items()) or "none"
        raise RecordingError(
            f"{path} has no events on {wanted or 'any topic'}; its topics are: {listed}: "
            "name one of dvs_msgs/EventArray or event_camera_msgs/EventPacket with --topic"
        )
    names = list(dict.fromkeys(c.topic for c in known))
    if len(names) > 1:
        raise UsageError(f"{path} has events on {', '.join(names)}: choose one with --topic")
    return known[0]


def _unreadable(path: Path, ros: int, error: Exception) -> RecordingError:
    remedy = "rosbag reindex" if ros == 1 else "ros2 bag reindex"
    text = " ".join(str(error).split())
    return RecordingError(
        f"{path} is cut off, damaged or no ROS {ros} bag ({text}): try {remedy}, or copy it again"
    )


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open a bag."""
    return BagSource(path, options, 1 if format_name == "rosbag1" else 2)
