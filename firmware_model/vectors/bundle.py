"""One file of all cases, which ``c/vectors_main.c`` runs in one process."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

from firmware_model.errors import DesignError, VectorError
from firmware_model.image import image, ram_bytes
from firmware_model.vectors.case import Case, in_order, records, to_binary
from firmware_model.vectors.images import ImageCase


def bundle(images: Sequence[ImageCase], cases: Iterable[Case]) -> bytes:
    """Pack images and cases for the program ``vectors_main.c``.

    Parameters
    ----------
    images : sequence of ImageCase
    cases : iterable of Case
        Cases beyond the reference firmware's limits are left out.
    """
    parts = [struct.pack("<I", len(images))]
    for one in images:
        parts += [struct.pack("<I", one.opens), packed_block(one.image)]
    packed = [data for case in cases if (data := _case(case)) is not None]
    return b"".join([*parts, struct.pack("<I", len(packed)), *packed])


def _case(case: Case) -> bytes | None:
    try:
        flash, events = image(case.memories), case.event_bytes()
    except (DesignError, VectorError):
        return None
    expected = to_binary(records(in_order(case.trace())))
    start = case.start % (1 << 32)
    head = struct.pack("<II", start, ram_bytes(case.design))
    return head + packed_block(flash) + packed_block(events) + packed_block(expected)


def packed_block(data: bytes) -> bytes:
    """Return the length of the data, the data, and zeros up to a whole word."""
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)
