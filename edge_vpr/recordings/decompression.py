"""Decompression with a limit: a few bytes cannot become gigabytes of memory."""

from __future__ import annotations

import bz2
import io
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, BinaryIO

from edge_vpr.errors import MissingExtraError

#: Most bytes that one packet, chunk or message of a recording may expand to.
LIMIT_BYTES = 1 << 26
#: Bytes that are read, and expanded, at a time.
PIECE_BYTES = 1 << 20


class DecompressionError(ValueError):
    """Compressed data is damaged, cut off, or expands to more than the limit."""


def lz4(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses LZ4 frames; errors name `what`."""
    try:
        frame = import_module("lz4.frame")
    except ImportError as error:
        raise MissingExtraError(f"{what}, LZ4", "lz4", extra) from error
    return lambda data: expand(frame.LZ4FrameDecompressor, data, (RuntimeError, EOFError))


def zstd_decompressor(
    what: str, extra: str
) -> tuple[Callable[[], Any], tuple[type[Exception], ...]]:
    """Return a maker of Zstandard decompressors, and its exceptions; errors name `what`."""
    try:
        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd
    except ImportError as error:
        raise MissingExtraError(f"{what}, ZSTD", "backports.zstd", extra) from error
    return zstd.ZstdDecompressor, (zstd.ZstdError, EOFError)


def zstd(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses Zstandard frames; errors name `what`."""
    decompressor, errors = zstd_decompressor(what, extra)
    return lambda data: expand(decompressor, data, errors)


def bzip2(data: bytes) -> bytes:
    """Decompress bzip2 streams."""
    return expand(bz2.BZ2Decompressor, data, (OSError, EOFError))


def expand(
    new: Callable[[], Any],
    data: bytes,
    errors: tuple[type[Exception], ...],
    limit: int | None = None,
) -> bytes:
    """Decompress one or more frames, and stop at the limit.

    Parameters
    ----------
    new : callable
        Function that makes a decompressor with the interface of :class:`bz2.BZ2Decompressor`.
    data : bytes
    errors : tuple of exception types
        Exceptions that the decompressor raises for damaged data.
    limit : int, optional
        Most bytes of the result; by default :data:`LIMIT_BYTES`.

    Raises
    ------
    DecompressionError
        If the data is damaged, cut off, or expands to more than `limit`.
    """
    limit = LIMIT_BYTES if limit is None else limit
    return b"".join(expand_file(new, io.BytesIO(data), errors, limit))


def expand_file(
    new: Callable[[], Any], file: BinaryIO, errors: tuple[type[Exception], ...], limit: int
) -> Iterator[bytes]:
    """Decompress the frames of a file piece by piece, and stop at the limit.

    Parameters
    ----------
    new, errors, limit
        As for :func:`expand`.
    file : binary file
        Read to its end.

    Yields
    ------
    bytes
        At most :data:`PIECE_BYTES`.

    Raises
    ------
    DecompressionError
        As for :func:`expand`; the pieces yielded before are correct.
    """
    size = 0
    rest = file.read(PIECE_BYTES)
    while rest:
        frame = new()
        while not frame.eof:
            if frame.needs_input and not rest:
                rest = file.read(PIECE_BYTES)
                if not rest:
                    raise DecompressionError("the compressed data is cut off")
            try:
                part = frame.decompress(rest, max_length=min(PIECE_BYTES, limit + 1 - size))
            except errors as error:
                raise DecompressionError(str(error)) from error
            rest = b""  # the decompressor keeps the bytes that it has not used
            size += len(part)
            if size > limit:
                raise DecompressionError(f"it expands to more than {limit:,} bytes")
            if part:
                yield part
            elif not (frame.eof or frame.needs_input):
                raise DecompressionError("the compressed data gives nothing")
        rest = frame.unused_data or file.read(PIECE_BYTES)
