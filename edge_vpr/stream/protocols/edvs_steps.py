"""The eDVS format E1: 3 to 6 bytes an event, with the time since the previous event."""

from __future__ import annotations

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.columns import Columns
from edge_vpr.stream.protocols.layout import NOTICE_WORDS
from edge_vpr.stream.protocols.protocol import Decoder
from edge_vpr.stream.protocols.words import SEARCH_WORDS
from edge_vpr.stream.timestamp_filter import Clock, no_columns

_LONGEST = 6


class StepDecoder(Decoder):
    """Decodes E1, whose events are 3 to 6 bytes long.

    A shifted stream is noticed at the first byte without the expected sync bit, or at the first
    step that does not end.
    """

    def __init__(self, sensor: Sensor, sync: int) -> None:
        super().__init__(sensor, Clock())
        self._sync = sync
        self._now = 0
        self._searching = True
        self._room = no_columns()
        self.resync_bytes = (SEARCH_WORDS + NOTICE_WORDS + 1) * _LONGEST

    def _lose_sync(self) -> None:
        self._searching = True

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        raw = np.frombuffer(data, dtype=np.uint8)
        if raw.size // 3 >= self._room.t.size:
            self._room = no_columns(raw.size // 3 + 1)
        t, x, y, p = self._room
        at, count = 0, 0
        while True:
            if self._searching:
                # a start is judged by the events after it, and by the possible starts next to it
                starts = raw.size - at - (0 if final else (SEARCH_WORDS + 1) * _LONGEST)
                if starts <= 0:
                    break
                skip, found = _search_steps(raw[at:], self._sync, SEARCH_WORDS, starts)
                self.health.skipped_bytes += skip
                at += skip
                if not found:
                    continue
                self._searching = False
            used, n_found, self._now, lost = _take_steps(
                raw[at:], self._sync, self._now, t[count:], x[count:], y[count:], p[count:]
            )
            at, count = at + used, count + n_found
            if not lost:
                break
            self.health.resyncs += 1
            self._searching = True
        return [Columns(t[:count], x[:count], y[:count], p[:count])], data[at:]


@kernel
def _event_at(raw, at, sync):  # type: ignore[no-untyped-def]
    """Return the length of an event and its time step.

    The length is 0 if bytes of the event are still to come, and -1 if this cannot be an event.
    """
    step, end = np.int64(0), at + 2
    if raw[at] >> 7 != sync:
        return -1, step
    while end < raw.size and raw[end] < 128 and end < at + 5:
        step = step << 7 | np.int64(raw[end])
        end += 1
    if end >= raw.size:
        return 0, step
    if raw[end] < 128:
        return -1, step
    return end + 1 - at, step << 7 | (np.int64(raw[end]) & 127)


@kernel
def _take_steps(raw, sync, now, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode whole events; stop at the first bytes that cannot be an event."""
    at, n = 0, 0
    while at < raw.size:
        length, step = _event_at(raw, at, sync)
        if length <= 0:
            return at, n, now, length < 0
        now += step
        t[n], x[n], y[n], p[n] = now, raw[at + 1] & 127, raw[at] & 127, raw[at + 1] >> 7
        n += 1
        at += length
    return at, n, now, False


@kernel
def _search_steps(raw, sync, words, starts):  # type: ignore[no-untyped-def]
    """Find the first byte from which `words` events (or as many as there are) can be read.

    Returns the number of bytes before it, and whether there is one before `starts`. A shifted
    reading takes every row for a part of a step, and time then runs faster. Of the next offsets
    that can be read, the first is therefore right, unless another takes less than half of its time.
    """
    best, best_time, first = starts, np.int64(-1), -1
    for start in range(raw.size):
        if start >= (first + _LONGEST if first >= 0 else starts):
            break
        at, n, time, bad = start, 0, np.int64(0), False
        while n < words and at < raw.size:
            length, step = _event_at(raw, at, sync)
            if length <= 0:
                bad = length < 0
                break
            time += step
            at += length
            n += 1
        if not bad and n > 0:
            if first < 0:
                first = start
            # from a later event, the same reading takes one step less; the right reading takes far
            # less time than a shifted one
            if best_time < 0 or 2 * time < best_time:
                best, best_time = start, time
    return best, first >= 0


def encode_steps(events: Events, since_us: int, sync: int) -> bytes:
    """Encode events; the step of the first event counts from `since_us`."""
    if events.size == 0:
        return b""
    steps = np.diff(events["t"], prepend=since_us)
    # a longer silence than 28 bits can hold is shortened
    steps = np.clip(steps, 0, (1 << 28) - 1)
    groups = (steps[:, None] >> np.array([21, 14, 7, 0])) & 127
    needed = np.maximum.accumulate(groups > 0, axis=1)
    needed[:, 3] = True
    groups[:, 3] |= 128
    y = sync << 7 | events["y"].astype(np.int64)
    x = events["p"].astype(np.int64) << 7 | events["x"]
    rows = np.concatenate([np.stack([y, x], axis=1), groups], axis=1)
    sent = np.concatenate([np.ones((steps.size, 2), dtype=np.bool_), needed], axis=1)
    return rows[sent].astype(np.uint8).tobytes()
