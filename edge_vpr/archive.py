"""Archives: versioned ``.npz`` files with a checksum and without pickle; checks of arrays.

The header of an archive has one checksum of everything else in it. Contents whose checksum fits
were written by edge-vpr, so readers do not check each value again.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EdgeVprError, MapError, as_path, printable
from edge_vpr.files import link, open_input, replacing

Arrays = dict[str, npt.NDArray[Any]]

#: raised by a change of what is stored, or of what it means, as the scale of the trust
SCHEMA_VERSION = 5
#: Largest memory of an archive, in bytes and as a multiple of its file size; the larger one holds.
#: Real counts compress to a thirtieth at most.
MEMORY_BYTES = 128 << 20
MOST_COMPRESSION = 32
_HEADER = "edge_vpr"
_HEADER_BYTES = 4_096  # of one array
_LONGEST_HEADER = 1 << 20  # of ours: settings as JSON


@contextmanager
def archive_errors(path: str | Path, remedy: str, kind: str = "file") -> Iterator[None]:
    """Convert any error that the contents of a file raise to a `MapError` that names the file.

    A missing or unreadable file gets a message of its own.

    Parameters
    ----------
    path : path
        Of the file.
    remedy : str
        What the reader of the message is to do.
    kind : str
        What was looked for, where there is no file.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise MapError(f"there is no {kind} at {path}: check the path") from error
    except OSError as error:
        reason = error.strerror or error
        raise MapError(f"{path} cannot be read: {reason}: name a {kind} that can") from error
    except EdgeVprError as error:
        raise MapError(f"{path}: {error}: {remedy}") from error
    except KeyError as error:
        raise MapError(f"{path} lacks {error}: {remedy}") from error
    # for broken contents, zipfile, zlib and NumPy raise a dozen kinds of error, also MemoryError
    # and RecursionError, and document only a few of them
    except Exception as error:
        reason = printable(error, 200) or type(error).__name__
        raise MapError(f"{path} is damaged ({reason}): {remedy}") from error


def present(**arrays: npt.NDArray[Any] | None) -> Arrays:
    """Return arrays by name, without those that are None."""
    return {name: array for name, array in arrays.items() if array is not None}


def write_archive(
    path: str | Path,
    kind: str,
    arrays: Mapping[str, npt.NDArray[Any]],
    meta: Mapping[str, Any],
    *,
    overwrite: bool = True,
    others: Iterable[str | Path] = (),
) -> None:
    """Write arrays and plain values as one compressed ``.npz``, atomically.

    Parameters
    ----------
    path : path
        The file to write.
    kind : str
        What the file is, for example ``reference map``; checked when it is read.
    arrays : mapping of str to ndarray
        Contents, by the names under which they are read.
    meta : mapping
        Values that JSON can hold.
    overwrite : bool
        Replace a file that exists.
    others : iterable of path
        Files that were read: of the first with the same contents, a hard link is made instead, as
        compressing takes long. Archives are only ever replaced whole, so that no change of one
        reaches the other.
    """
    path = as_path(path, f"a {kind}")
    meta = {"kind": kind, "version": SCHEMA_VERSION, **meta}
    checksum = checksum_of(meta, arrays)
    header = json.dumps({**meta, "checksum": checksum})
    with replacing(path, overwrite) as temporary:
        for other in others:
            if _header_of(other).get("checksum") == checksum and link(other, temporary):
                return
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **{_HEADER: np.array(header)}, **arrays)


def checksum_of(meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    """Return the SHA-256 of plain values and of arrays with their names, dtypes and shapes."""
    digest = hashlib.sha256(json.dumps(meta).encode())
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"\n{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def archive_kind(path: str | Path) -> str | None:
    """Return the kind of a file that `write_archive` wrote, or None for any other file."""
    kind = _header_of(path).get("kind")
    return None if kind is None else printable(kind, 40)


def _header_of(path: str | Path) -> dict[str, Any]:
    """Return the header of an archive without its arrays; of any other file an empty one."""
    try:
        with open_input(path) as file, zipfile.ZipFile(file) as archive:
            member = archive.getinfo(f"{_HEADER}.npy")
            if member.file_size > _LONGEST_HEADER:
                return {}
            with archive.open(member) as stream:
                header = _read_array(stream, _HEADER, member.file_size)
        return dict(json.loads(str(header)))
    # as in `archive_errors`: a file that is not ours may raise any kind of error
    except Exception:
        return {}


def read_archive(path: str | Path, kind: str) -> tuple[Arrays, dict[str, Any]]:
    """Read what `write_archive` wrote.

    Parameters
    ----------
    kind : str
        What the file is expected to be.

    Returns
    -------
    arrays : dict of str to ndarray
        As they were written.
    meta : dict
        Values of JSON, as they were written.

    Raises
    ------
    MapError
        If the file is missing, unreadable, of another kind or version, or damaged: its checksum
        does not fit, or it holds more than its size allows.
    """
    path = as_path(path, f"a {kind}")
    with archive_errors(path, f"it is not a readable {kind}, make it again", kind):
        arrays = read_members(path, holding=_HEADER)
    header = arrays.pop(_HEADER, None)
    if header is None or header.shape != () or header.dtype.kind != "U":
        raise MapError(f"{path} is not a {kind} of edge-vpr: name a file that edge-vpr wrote")
    with archive_errors(path, f"the {kind} is damaged, make it again"):
        meta = dict(json.loads(str(header)))
    stated_kind, version = meta.get("kind"), meta.get("version")
    if stated_kind != kind:
        raise MapError(f"{path} is a {stated_kind}, not a {kind}: name the other file")
    if version != SCHEMA_VERSION:
        raise MapError(
            f"{path} has schema version {version!r} and this edge-vpr reads version "
            f"{SCHEMA_VERSION}: make the file again, or install the edge-vpr that wrote it"
        )
    if meta.pop("checksum", None) != checksum_of(meta, arrays):
        raise MapError(
            f"{path} is damaged (its checksum does not fit): copy the {kind} again, or make it "
            "again"
        )
    del meta["kind"], meta["version"]
    return arrays, meta


def read_members(path: str | Path, holding: str | None = None) -> Arrays:
    """Read the arrays of an ``.npz``; announced sizes are checked before memory is allocated.

    Parameters
    ----------
    holding : str, optional
        Nothing is read of a file without this array, for example a recording.

    Returns
    -------
    dict of str to ndarray
        Of numbers, truth values or text; contiguous, in native byte order.

    Raises
    ------
    MapError
        If there are more bytes than the file's size allows, or an array is not of such values or
        not of the announced size.
    Exception
        Whatever the libraries raise for a broken file: see `archive_errors`.
    """
    with open_input(path) as file:
        if holding is not None and file.read(2) != b"PK":
            return {}
        archive = zipfile.ZipFile(file)
        members = archive.infolist()
        if holding is not None and f"{holding}.npy" not in archive.namelist():
            return {}
        announced = sum(member.file_size for member in members)
        allowed = max(MEMORY_BYTES, MOST_COMPRESSION * os.fstat(file.fileno()).st_size)
        if announced > allowed:
            raise MapError(
                f"it unpacks to {announced} bytes, more than the {allowed} that a file of its size "
                "may take"
            )
        arrays = {}
        for member in members:
            with archive.open(member) as stream:
                name = member.filename.removesuffix(".npy")
                arrays[name] = _read_array(stream, name, member.file_size)
        return arrays


def read_npy(path: str | Path) -> npt.NDArray[Any]:
    """Read an ``.npy`` with the checks and errors of `read_members`."""
    with open_input(path) as file:
        return _read_array(file, "in it", os.fstat(file.fileno()).st_size)


def write_npy(path: str | Path, array: npt.NDArray[Any]) -> None:
    """Write one array as ``.npy``, atomically."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.save(file, array, allow_pickle=False)


def _read_array(stream: IO[bytes], name: str, size: int) -> npt.NDArray[Any]:
    """Read one array of `size` bytes with its header."""
    version = np.lib.format.read_magic(stream)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise MapError(f"array {name} is of the .npy version {version}: expected 1.0 or 2.0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # header that Python 2 wrote
        shape, fortran, dtype = read(stream, max_header_size=_HEADER_BYTES)
    if dtype.kind not in "biufU" or dtype.hasobject or dtype.itemsize == 0:
        raise MapError(f"array {name} is {dtype}: expected numbers or text")
    count = math.prod(shape)
    if min(shape, default=0) < 0 or count * dtype.itemsize != size - stream.tell():
        raise MapError(
            f"array {name} announces {shape} of {dtype} and holds {size - stream.tell()} bytes"
        )
    flat = np.empty(count, dtype=dtype)
    left = flat.view(np.uint8).data if count else memoryview(b"")
    while len(left):
        read_bytes = stream.readinto(left)  # type: ignore[attr-defined]
        if not read_bytes:
            raise MapError(f"array {name} ends {len(left)} bytes early")
        left = left[read_bytes:]
    stream.read(1)  # reading to the end makes zipfile check the checksum
    array = flat.reshape(shape, order="F" if fortran else "C")
    return np.ascontiguousarray(array, dtype=dtype.newbyteorder("=")).reshape(shape)


# Checks of arrays and numbers from files, and comparison of records that hold arrays.


def check_array(
    array: object, name: str, dtypes: Sequence[npt.DTypeLike], shape: tuple[int | None, ...]
) -> None:
    """Check that an array has one of these dtypes, native byte order, and this shape.

    Parameters
    ----------
    array : object
        Checked; need not be an array.
    name : str
        What the message calls it.
    dtypes : sequence of dtype
        Any of which is accepted.
    shape : tuple of int or None
        None stands for any length.
    """
    if (
        isinstance(array, np.ndarray)
        and any(array.dtype == np.dtype(dtype) for dtype in dtypes)
        and len(array.shape) == len(shape)
        and all(length in (None, size) for length, size in zip(shape, array.shape, strict=True))
    ):
        return
    stated = f"a {type(array).__name__}"
    if isinstance(array, np.ndarray):
        stated = f"{array.dtype} of shape {array.shape}"
    names = " or ".join(np.dtype(dtype).name for dtype in dtypes)
    raise MapError(f"{name} is {stated}: expected {names} of shape {_shown(shape)}")


def check_range(array: npt.NDArray[Any], name: str, least: int, most: int) -> None:
    """Raise MapError unless every value lies between `least` and `most`, both allowed."""
    if array.size and not (array.min() >= least and array.max() <= most):
        raise MapError(
            f"{name} holds {array.min()} to {array.max()}: expected values from {least} to {most}"
        )


def _shown(shape: tuple[int | None, ...]) -> str:
    lengths = ", ".join("n" if length is None else str(length) for length in shape)
    return f"({lengths},)" if len(shape) == 1 else f"({lengths})"


class EqualByValue:
    """Base of dataclasses with arrays: two are equal if all their fields are, to the bit.

    NaN equals NaN, so that a record equals the same record after saving and loading.
    """

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, EqualByValue) or not is_dataclass(self):
            return NotImplemented
        names = [field.name for field in fields(self)]
        return names == [field.name for field in fields(other)] and all(
            _same(getattr(self, name), getattr(other, name)) for name in names
        )

    __hash__ = None  # type: ignore[assignment]  # holds arrays


def _same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        nan = one.dtype.kind == other.dtype.kind == "f"
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=nan)
    return type(one) is type(other) and bool(one == other)
