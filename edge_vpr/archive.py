"""Maps and matches on disk: ``.npz`` without pickle, versioned, written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import MapError, UsageError

Arrays = dict[str, npt.NDArray[Any]]

SCHEMA_VERSION = 1
_HEADER = "edge_vpr"


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a temporary file beside `path` that takes its place when the block ends well.

    After an error or an interrupt the temporary file is gone and `path` is as it was.

    Raises
    ------
    UsageError
        If the folder does not exist or cannot be written to.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    except OSError as error:
        raise UsageError(
            f"cannot write {path}: {error.strerror}: name a folder that exists and is writable"
        ) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)  # mkstemp makes files that only their owner may read
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_archive(
    path: str | Path, kind: str, arrays: Mapping[str, npt.NDArray[Any]], meta: Mapping[str, Any]
) -> None:
    """Write arrays and plain values as one compressed ``.npz``, atomically.

    Parameters
    ----------
    path : path
        Replaced if it exists.
    kind : str
        What the file is, for example ``reference map``; checked when it is read.
    arrays : mapping of str to ndarray
    meta : mapping
        Values that JSON can hold.
    """
    header = json.dumps({"kind": kind, "version": SCHEMA_VERSION, **meta})
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **{_HEADER: np.array(header)}, **arrays)


def kind_of(path: str | Path) -> str | None:
    """Return the kind of a file that `write_archive` wrote, or None for any other file."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{_HEADER}.npy") as member:
            header = np.lib.format.read_array(member, allow_pickle=False)
        return str(dict(json.loads(str(header)))["kind"])
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def read_archive(path: str | Path, kind: str) -> tuple[Arrays, dict[str, Any]]:
    """Read what `write_archive` wrote.

    Parameters
    ----------
    path : path
    kind : str
        What the file is expected to be.

    Returns
    -------
    arrays : dict of str to ndarray
    meta : dict

    Raises
    ------
    MapError
        If the file is missing, unreadable, of another kind, or from a newer version.
    """
    try:
        with Path(path).open("rb") as file, zipfile.ZipFile(file):
            file.seek(0)
            archive = np.load(file, allow_pickle=False)
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError as error:
        raise MapError(f"there is no {kind} at {path}: check the path") from error
    except PermissionError as error:
        raise MapError(f"{path} may not be read: check its permissions") from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise MapError(f"{path} is not a readable {kind} ({error}): make it again") from error
    header = arrays.pop(_HEADER, None)
    if header is None:
        raise MapError(f"{path} is not a {kind} of edge-vpr: name a file that edge-vpr wrote")
    try:
        meta = dict(json.loads(str(header)))
    except (ValueError, TypeError) as error:
        raise MapError(f"{path} is a damaged {kind} ({error}): make it again") from error
    found, version = meta.pop("kind", None), meta.pop("version", None)
    if found != kind:
        raise MapError(f"{path} is a {found}, not a {kind}: name the other file")
    if not isinstance(version, int) or version > SCHEMA_VERSION:
        raise MapError(
            f"{path} has schema version {version} and this edge-vpr reads up to {SCHEMA_VERSION}: "
            "update edge-vpr, or make the file again"
        )
    return arrays, meta
