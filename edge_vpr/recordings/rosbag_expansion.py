"""Expansion of ROS 2 bags of compression mode ``file`` with limits, which rosbags lacks."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path, PurePath
from typing import Any

from edge_vpr.errors import RecordingError
from edge_vpr.recordings.decompression import DecompressionError, expand_file, zstd_decompressor
from edge_vpr.whole_files import work_folder

#: Limits of the expanded size: this number of bytes, or this multiple of the files' size.
LEAST_BYTES, MOST_EXPANSION = 1 << 28, 32
_LISTING = "metadata.yaml"


def expand_bag(folder: Path, owner: object) -> Path:
    """Expand a bag of compressed files into a temporary folder.

    Parameters
    ----------
    folder : Path
        With a ``metadata.yaml`` that rosbags can read.
    owner : object
        The temporary folder is removed with this object, or when Python ends.

    Returns
    -------
    Path
        Folder of the same bag without compression; `folder` if its files are not compressed.

    Raises
    ------
    RecordingError
        If a file is damaged, lies outside the folder, or expands to more than the limit, or if
        the temporary folder is full.
    """
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe")
    listing = yaml.load((folder / _LISTING).read_text("utf-8"))
    facts = listing["rosbag2_bagfile_information"]
    compressed = str(facts.get("compression_mode", "")).lower() == "file"
    if not compressed or facts.get("compression_format") != "zstd":
        return folder
    # rosbags uses only the last part of a path
    paths = [folder / PurePath(name).name for name in facts["relative_file_paths"]]
    held = sum(path.stat().st_size for path in set(paths))
    left = max(LEAST_BYTES, MOST_EXPANSION * held)
    stack = ExitStack()
    # the next run removes what a killed run leaves there
    target = stack.enter_context(work_folder(Path(tempfile.gettempdir()) / folder.name))
    weakref.finalize(owner, stack.close)
    names = []
    for i, path in enumerate(paths):
        names.append(f"{i}{PurePath(path.stem).suffix}")
        try:
            left -= _write(target / names[-1], _expanded(path, left))
        except DecompressionError as error:
            raise RecordingError(f"{path} cannot be expanded ({error}): copy it again") from error
    changed: dict[str, Any] = {"compression_mode": "", "compression_format": ""}
    facts |= {**changed, "relative_file_paths": names, "files": []}
    with (target / _LISTING).open("w", encoding="utf-8") as file:
        yaml.dump(listing, file)
    return target


def _expanded(path: Path, limit: int) -> Iterator[bytes]:
    decompressor, errors = zstd_decompressor(str(path), "ros")
    with path.open("rb") as file:
        yield from expand_file(decompressor, file, errors, limit)


def _write(path: Path, parts: Iterator[bytes]) -> int:
    """Write the parts, and return their total size."""
    size = 0
    with path.open("wb") as file:
        for part in parts:
            try:
                file.write(part)
            except OSError as error:
                raise RecordingError(
                    f"{path.parent} is too small to expand the bag ({error.strerror} after "
                    f"{size:,} bytes): name a larger folder with TMPDIR"
                ) from error
            size += len(part)
    return size
