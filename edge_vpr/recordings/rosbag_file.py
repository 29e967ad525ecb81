"""Bags of ROS 1 and ROS 2, read message by message with rosbags, with limits that it lacks."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from edge_vpr.errors import EdgeVprError, MissingExtraError, RecordingError
from edge_vpr.recordings.decompression import bzip2, lz4, zstd
from edge_vpr.recordings.rosbag_expansion import expand_bag

#: rosbags' names of the storage formats of ROS 2 bags, by suffix.
_STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
_LONGEST_METADATA = 1 << 22


class _BoundedFile(io.BufferedReader):
    """File whose reads are limited to the rest of the file: rosbags trusts announced sizes."""

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, os.fstat(self.fileno()).st_size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


class _BoundedPath(type(Path())):  # type: ignore[misc]  # of the platform's own kind
    """Path that opens its files as :class:`_BoundedFile`."""

    def open(self, mode: str = "r", *args: Any, **options: Any) -> Any:
        """Open the file; reads of bytes are bounded."""
        if mode != "rb":
            return super().open(mode, *args, **options)
        return _BoundedFile(super().open(mode, buffering=0))


class Bag:
    """ROS 1 or ROS 2 bag.

    Parameters
    ----------
    path : Path
    ros : {1, 2}

    Raises
    ------
    RecordingError
        If its files cannot be found or expanded.
    """

    def __init__(self, path: Path, ros: int) -> None:
        self.path, self.ros = path, ros
        self._rosbags = _load(ros)
        self._place = _place(path) if ros == 2 else path
        self._expand: Callable[[bytes], bytes] = bytes
        if ros == 2 and self._place.is_dir():
            with self.errors():
                self._place = expand_bag(self._place, self)

    @contextmanager
    def open(self) -> Iterator[Any]:
        """Open the bag with rosbags, with a limit on the expanded size of its parts."""
        if self.ros == 2:
            _limit_mcap()
        with self._rosbags.Reader(_BoundedPath(self._place)) as reader:
            if self.ros == 1:
                reader.chunks = {at: _limited(chunk) for at, chunk in reader.chunks.items()}
            self._expand = self._take_over(reader)
            yield reader

    def messages(self, reader: Any, topic: str) -> Iterator[bytes]:
        """Yield the serialised messages of a topic."""
        connections = [c for c in reader.connections if c.topic == topic]
        for _, _, data in reader.messages(connections=connections):
            yield self._expand(data)

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Convert exceptions of rosbags' parsers to a RecordingError with a remedy."""
        try:
            yield
        except (EdgeVprError, MemoryError):
            raise
        except Exception as error:
            raise _unreadable(self.path, self.ros, error) from error

    def _take_over(self, reader: Any) -> Callable[[bytes], bytes]:
        """Return the function that decompresses messages; rosbags would do it without a limit."""
        storage = getattr(reader, "storage", None)
        mode = getattr(getattr(storage, "metadata", None), "compression_mode", None)
        if mode != "message" or storage is None:
            return bytes
        storage.metadata = storage.metadata._replace(compression_mode=None)
        return zstd(str(self.path), "ros")


def _load(ros: int) -> Any:
    try:
        return import_module(f"rosbags.rosbag{ros}")
    except ImportError as error:
        raise MissingExtraError("a ROS bag", "rosbags", "ros") from error


def _place(path: Path) -> Path:
    """Return the path that rosbags opens: the folder of a bag, or a single file of it.

    A file is opened with the others of its bag if ``metadata.yaml`` lists it. If this is absent or
    cannot be used, the file is opened on its own.

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
    except Exception as error:  # the parser raises exceptions of many kinds
        return f"is damaged ({type(error).__name__}: {error})"
    if storage not in _STORAGES.values():
        return f"has the storage identifier {storage!r}, and not {' or '.join(_STORAGES.values())}"
    if facts.get("compression_mode", "").lower() not in ("file",) and suffixes != {
        suffix for suffix, name in _STORAGES.items() if name == storage
    }:
        return f"has the storage identifier {storage!r} for files {', '.join(map(str, names))}"
    return ""


def _limit_mcap() -> None:
    """Give rosbags' decompressors of MCAP chunks a limit; they have none of their own."""
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


def _unreadable(path: Path, ros: int, error: Exception) -> RecordingError:
    remedy = "rosbag reindex" if ros == 1 else "ros2 bag reindex"
    text = " ".join(str(error).split())
    return RecordingError(
        f"{path} is cut off, damaged or no ROS {ros} bag ({text}): try {remedy}, or copy it again"
    )
