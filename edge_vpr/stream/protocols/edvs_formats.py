"""Recognition of the eDVS format of a device from its bytes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.stream.protocols.layout import Field, Layout, read_words
from edge_vpr.stream.protocols.words import Raw

#: Number of bits of the time for each format; -1 stands for steps, whose size varies.
STEPS = -1
BITS = {
    "new": {"E0": 0, "E1": STEPS, "E2": 16, "E3": 24, "E4": 32},
    "old": {"E0": 0, "E1": 16, "E2": 24, "E3": 32},
}
#: A format fits if more than this share of its words looks right; half of the words of noise do.
FITS = 0.75
#: The same share for formats without a time of fixed size.
FITS_WITHOUT_TIME = 0.9


def layout_of(bits: int, sync: int) -> Layout:
    """Return the layout of an event with `bits` bits of time and the value of the sync bit."""
    return Layout(
        size=2 + bits // 8,
        big=True,
        x=Field(bits, 7),
        p=Field(bits + 7, 1),
        y=Field(bits + 8, 7),
        t=Field(0, bits),
        sync_mask=1 << (bits + 15),
        sync_value=sync << (bits + 15),
    )


def detect(data: bytes, bits: Iterable[int], syncs: Iterable[int]) -> tuple[int, int] | None:
    """Find the bits of the time and the sync bit of a stretch of bytes; None if nothing fits.

    A wrong format may also fit, if one of its bytes hardly changes; time then runs faster. Formats
    with steps or without time are chosen only if no other format fits.

    Parameters
    ----------
    data : bytes
    bits : iterable of int
        Candidates for the number of bits of the time.
    syncs : iterable of {0, 1}
    """
    raw, bits = np.frombuffer(data, dtype=np.uint8), set(bits)
    fits = []
    for sync in syncs:
        for candidate in bits:
            if candidate == STEPS:
                share, pace = _share_of_steps(raw, sync), 0.0
            else:
                share, pace = _share(raw, layout_of(candidate, sync))
            rank = {0: 2, STEPS: 1}.get(candidate, 0)
            if share > (FITS_WITHOUT_TIME if rank else FITS):
                fits.append((rank, pace, -share, candidate, sync))
    if not fits:
        return None
    *_, candidate, sync = min(fits)
    return candidate, sync


def _share(raw: Raw, layout: Layout) -> tuple[float, float]:
    """Return the share of plausible words at the best offset, and how fast time runs there."""
    found = [(0.0, 0.0)]
    if raw.size >= layout.size:
        for offset, reading in enumerate(read_words(raw, raw.size, layout.form())):
            words = (raw.size - offset) // layout.size
            # equal words come from a dead line; of few words, many are plausible by chance
            share = reading.good / words * reading.moves - words**-0.5
            found.append((share, reading.pace))
    best = max(share for share, _ in found)
    return best, min(pace for share, pace in found if share > best - 0.1)


@kernel
def _share_of_steps(raw, sync):  # type: ignore[no-untyped-def]
    """Return the readable events with steps, as a share of these and the unreadable places.

    No device sends a step in more bytes than it needs.
    """
    at, read, breaks = 0, 0, 0
    while at + 2 < raw.size:
        end = at + 2
        while end < raw.size and raw[end] < 128 and end < at + 5:
            end += 1
        if end == raw.size:
            break
        if raw[at] >> 7 != sync or raw[end] < 128 or raw[at + 2] == 0:
            breaks += 1
            at += 1
        else:
            read += 1
            at = end + 1
    return read / max(1, read + breaks)
