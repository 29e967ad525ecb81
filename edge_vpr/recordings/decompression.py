"""Decompression with a limit: a few bytes cannot become gigabytes of memory."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

from edge_vpr.errors import MissingExtraError

#: Most bytes that one packet, chunk or message of a recording may expand to.
LIMIT_BYTES = 1 << 26


class DecompressionError(ValueError):
    """Compressed data is damaged, cut off, or expands to more than the limit."""


def lz4(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses LZ4 frames; `what` needs them."""
    try:
        frame = import_module("lz4.frame")
    except ImportError as error:
        raise MissingExtraError(f"{what}, LZ4", "lz4", extra) from error
    return lambda data: expand(frame.LZ4FrameDecompressor, data, (RuntimeError, EOFError))


def zstd(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses Zstandard frames; `what` needs them."""
    try:
        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd
    except ImportError as error:
        raise MissingExtraError(f"{what}, ZSTD", "backports.zstd", extra) from error
    return lambda data: expand(zstd.ZstdDecompressor, data, (zstd.ZstdError, EOFError))


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
        Makes a decompressor with the interface of :class:`bz2.BZ2Decompressor`.
    data : bytes
    errors : tuple of exception types
        What it raises for damaged data.
    limit : int, optional
        Most bytes of the result; by default :data:`LIMIT_BYTES`.

    Raises
    ------
    DecompressionError
        If the data is damaged, cut off, or expands to more than `limit`.
    """
    limit = LIMIT_BYTES if limit is None else limit
    parts, size = [], 0
    rest = bytes(data)
    while rest:
        frame = new()
        while not frame.eof:
            try:
                part = frame.decompress(rest, max_length=limit + 1 - size)
            except errors as error:
                raise DecompressionError(str(error)) from error
            rest = b""  # the decompressor keeps what it has not used
            size += len(part)
            parts.append(part)
            if size > limit:
                raise DecompressionError(f"it expands to more than {limit:,} bytes")
            if not part and not frame.eof:
                raise DecompressionError("the compressed data is cut off")
        rest = frame.unused_data or b""
    return b"".join(parts)
