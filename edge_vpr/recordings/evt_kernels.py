"""Kernels that decode the words of Prophesee's EVT 2.0, 2.1 and 3.0."""

from __future__ import annotations

import numpy as np

from edge_vpr.compiling import kernel

#: State between two calls: time base and its last raw value; row; first column and polarity of a
#: vector; low bits of the time (-1 before the first word that states them); and number of events
#: before the first words of time and place.
STATE = np.dtype(
    [
        ("time_base", "<i8"),
        ("high", "<i8"),
        ("row", "<i8"),
        ("first", "<i8"),
        ("polarity", "<i8"),
        ("low", "<i8"),
        ("undated", "<i8"),
    ]
)


@kernel
def _advance(s, high, bits):  # type: ignore[no-untyped-def]
    """Advance the unwrapped time base to a new value of the high time bits.

    The shorter direction decides between a wrap and a step back; a step back is kept.
    """
    if s.high < 0:
        s.time_base = high
    else:
        half = 1 << (bits - 1)
        s.time_base += ((high - s.high + half) & ((1 << bits) - 1)) - half
    s.high = high


@kernel
def decode_evt2(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode 32-bit words: 4 bits type, 6 bits time, 11 bits column, 11 bits row."""
    s, n = state[0], 0
    for word32 in words:
        word = np.int64(word32)
        kind = word >> 28
        if kind < 2:
            if s.high < 0:
                s.undated += 1
                continue
            t[n] = (s.time_base << 6) | ((word >> 22) & 63)
            x[n] = (word >> 11) & 2047
            y[n] = word & 2047
            p[n] = kind == 1
            n += 1
        elif kind == 8:
            _advance(s, word & 0xFFFFFFF, 28)
    return n


@kernel
def decode_evt21(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode 64-bit words: 4 bits type, 6 time, 11 column, 11 row, 32 for one column each."""
    s, n = state[0], 0
    for word64 in words:
        top = np.int64(word64 >> np.uint64(32))
        kind = top >> 28
        if kind < 2:
            valid = np.int64(word64 & np.uint64(0xFFFFFFFF))
            first = (top >> 11) & 2047
            time = (s.time_base << 6) | ((top >> 22) & 63)
            while valid:
                bit = valid & -valid
                if s.high < 0:
                    s.undated += 1
                else:
                    t[n] = time
                    column = first
                    while bit > 1:
                        bit >>= 1
                        column += 1
                    x[n] = column
                    y[n] = top & 2047
                    p[n] = kind == 1
                    n += 1
                valid &= valid - 1
        elif kind == 8:
            _advance(s, top & 0xFFFFFFF, 28)
    return n


@kernel
def decode_evt3(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode 16-bit words, each of which changes a part of the state or holds events.

    A new value of the high time bits sets the low ones to 0; the sensor sends the low bits next.
    Parts of the state that no word has stated yet are -1.
    """
    s, n = state[0], 0
    base, low, row, first, polarity = s.time_base, s.low, s.row, s.first, s.polarity
    time = (base << 12) | low
    dated = s.high >= 0 and low >= 0
    for word16 in words:
        word = np.int64(word16)
        kind = word >> 12
        if kind == 2:  # one event
            if dated and row >= 0:
                t[n] = time
                x[n] = word & 2047
                y[n] = row
                p[n] = word & 2048 != 0
                n += 1
            else:
                s.undated += 1
        elif kind == 6 and s.high >= 0:  # low time bits; useless without high ones
            low = word & 4095
            time = (base << 12) | low
            dated = True
        elif kind == 0:  # row
            row = word & 2047
        elif kind == 4 or kind == 5:  # 12 or 8 columns, one bit each
            width = 12 if kind == 4 else 8
            valid = word & ((1 << width) - 1)
            column = first
            while valid:
                if valid & 1:
                    if dated and row >= 0 and first >= 0:
                        t[n] = time
                        x[n] = column
                        y[n] = row
                        p[n] = polarity != 0
                        n += 1
                    else:
                        s.undated += 1
                valid >>= 1
                column += 1
            # a column beyond the last one stays at 2048
            first = min(first + width, 2048) if first >= 0 else first
        elif kind == 8:  # high time bits
            high = word & 4095
            if high != s.high:
                _advance(s, high, 12)
                base, low = s.time_base, min(low, 0)
                time = base << 12
        elif kind == 3:  # first column of the vectors that follow
            first = word & 2047
            polarity = word & 2048
    s.low, s.row, s.first, s.polarity = low, row, first, polarity
    return n
