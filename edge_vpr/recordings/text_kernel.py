"""Kernel that parses lines of decimal numbers."""

from __future__ import annotations

from edge_vpr.compiling import kernel

#: status of a line: an event, an event with a fraction in its time, blank, or unknown to the kernel
GOOD, FRACTION, BLANK, STRANGE = range(4)


@kernel
def parse_lines(buffer, order, digits_to_us, out, begins, status):  # type: ignore[no-untyped-def]
    """Parse whole lines into ``out[field, line]``, and set where each line begins and its status.

    ``order[c]`` is the field of column ``c``: 0 to 3 for t, x, y, p; -1 to skip it.
    """
    line, i = 0, 0
    while i < buffer.size:
        begins[line] = i
        column, state = 0, GOOD
        while buffer[i] != 10:
            c = int(buffer[i])
            if c == 32 or c == 9 or c == 44 or c == 59 or c == 13:  # blank tab , ; CR
                i += 1
                continue
            negative = c == 45
            if c == 45 or c == 43:
                i += 1
            value, digits, decimals = 0, 0, -1
            seen = False  # whether a digit was read
            residue = False  # whether digits beyond the 18th are not 0
            while True:
                c = int(buffer[i])
                if 48 <= c <= 57:
                    if digits < 18:
                        value = value * 10 + (c - 48)
                        if decimals >= 0:
                            decimals += 1
                        if value > 0:
                            digits += 1
                    elif decimals < 0:
                        state = STRANGE
                    elif c != 48:
                        residue = True
                    seen = True
                elif c == 46 and decimals < 0:
                    decimals = 0
                else:
                    break
                i += 1
            c = int(buffer[i])
            if not seen or not (c == 10 or c == 32 or c == 9 or c == 44 or c == 59 or c == 13):
                state = STRANGE
            if state == STRANGE:
                break
            field = order[column] if column < order.size else -1
            if column >= order.size:
                state = STRANGE
                break
            decimals = max(decimals, 0)
            if field == 0:
                shift = digits_to_us - decimals
                if decimals > 0:
                    state = FRACTION
                while shift > 0:
                    if value > 922337203685477579:
                        state = STRANGE
                        break
                    value *= 10
                    shift -= 1
                if shift < 0:
                    unit = 1
                    while shift < 0 and unit < 1000000000000000000:
                        unit *= 10
                        shift += 1
                    rest = value % unit
                    value //= unit
                    # round to the nearest, ties to even, as Decimal does
                    if 2 * rest > unit or (2 * rest == unit and (residue or value % 2)):
                        value += 1
            elif field > 0 and decimals > 0:
                state = STRANGE  # includes 12.0, which is read slowly
            if state == STRANGE:
                break
            if field >= 0:
                out[field, line] = -value if negative else value
            column += 1
        while buffer[i] != 10:
            i += 1
        if state != STRANGE and column != order.size:
            state = STRANGE  # includes blank lines, which the slow reader recognises
        status[line] = state
        line += 1
        i += 1
