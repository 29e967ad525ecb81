"""eDVS: 128 x 128 pixels, formats E0 to E4, no checksum and no sequence number."""

from __future__ import annotations

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError
from edge_vpr.events import Columns, Events, Sensor, empty_columns
from edge_vpr.live.protocols import Clock, Decoder, Encoder, OptionReader
from edge_vpr.live.protocols.aer import (
    NOTICE_WORDS,
    Field,
    Layout,
    LayoutDecoder,
    LayoutEncoder,
)
from edge_vpr.live.protocols.words import SEARCH_WORDS

# Formats.
#
# Byte 0 holds a sync bit and the row, byte 1 polarity and column. The time follows: none (E0), the
# step since the previous event in 7-bit groups (E1), or 16, 24, 32 bits (E2, E3, E4). Firmware
# older than the format with steps calls 16, 24 and 32 bits E1, E2 and E3. Some drivers and
# firmware invert the sync bit. Format, dialect and sync bit are stated by the user; by default they
# are E3, new and 1.


#: Number of bits of the time for each format; -1 stands for steps, whose size varies.
STEPS = -1
BITS = {
    "new": {"E0": 0, "E1": STEPS, "E2": 16, "E3": 24, "E4": 32},
    "old": {"E0": 0, "E1": 16, "E2": 24, "E3": 32},
}


def _layout_of(bits: int, sync: int) -> Layout:
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


# Commands to the device.


class _Commands(Decoder):
    """Commands that make a device send the format which its decoder expects."""

    command = ""  #: Of the format.

    def setup(self) -> bytes:
        """Return commands: stop events, echo off, set the format, clock to zero, start events."""
        return f"E-\n!U0\n!{self.command}\n!ET0\nE+\n".encode("ascii")

    def greeting(self) -> bytes:
        """Return the commands that leave a running device as it is, and start another one."""
        return f"!U0\n!{self.command}\nE+\n".encode("ascii")

    def teardown(self) -> bytes:
        """Return the command that stops events."""
        return b"E-\n"


# The eDVS format E1: 3 to 6 bytes an event, with the time since the previous event.


_LONGEST = 6


class EdvsStepDecoder(_Commands):
    """Decodes E1, whose events are 3 to 6 bytes long.

    A shifted stream is noticed at the first byte without the expected sync bit, or at the first
    step that does not end.
    """

    def __init__(self, sensor: Sensor, sync: int) -> None:
        super().__init__(sensor, Clock())
        self._sync = sync
        self._now = 0
        self._searching = True
        self._columns = empty_columns(0)
        self.resync_bytes = (SEARCH_WORDS + NOTICE_WORDS + 1) * _LONGEST

    def _lose_sync(self) -> None:
        self._searching = True

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        raw = np.frombuffer(data, dtype=np.uint8)
        if raw.size // 3 >= self._columns.t.size:
            self._columns = empty_columns(raw.size // 3 + 1)
        t, x, y, p = self._columns
        at, count = 0, 0
        while True:
            if self._searching:
                # a start is judged by the events after it, and by the possible starts next to it
                starts = raw.size - at - (0 if final else (SEARCH_WORDS + 1) * _LONGEST)
                if starts <= 0:
                    break
                skip, synced = _search_steps(raw[at:], self._sync, SEARCH_WORDS, starts)
                self.health.skipped_bytes += skip
                at += skip
                if not synced:
                    continue
                self._searching = False
            used, n_events, self._now, out_of_sync = _take_steps(
                raw[at:], self._sync, self._now, t[count:], x[count:], y[count:], p[count:]
            )
            at, count = at + used, count + n_events
            if not out_of_sync:
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


def _encode_steps(events: Events, since_us: int, sync: int) -> bytes:
    """Encode events; the step of the first event counts from `since_us`."""
    if events.size == 0:
        return b""
    steps = np.diff(events.t, prepend=since_us)
    # a longer silence than 28 bits can hold is shortened
    steps = np.clip(steps, 0, (1 << 28) - 1)
    groups = (steps[:, None] >> np.array([21, 14, 7, 0])) & 127
    needed = np.maximum.accumulate(groups > 0, axis=1)
    needed[:, 3] = True
    groups[:, 3] |= 128
    y = sync << 7 | events.y.astype(np.int64)
    x = events.p.astype(np.int64) << 7 | events.x
    rows = np.concatenate([np.stack([y, x], axis=1), groups], axis=1)
    sent = np.concatenate([np.ones((steps.size, 2), dtype=np.bool_), needed], axis=1)
    return rows[sent].astype(np.uint8).tobytes()


# The stream of a device.


class EdvsDecoder(_Commands, LayoutDecoder):
    """Decodes the other formats."""


class EdvsEncoder(Encoder):
    """Device that starts on ``E+``, and answers commands as the maker's firmware does."""

    waits_for_host = True

    def __init__(self, sensor: Sensor, bits: int, sync: int, dialect: str) -> None:
        if max(sensor) > 128:
            raise UsageError(f"edvs has 128x128 pixels, and not {sensor}: crop the recording")
        super().__init__(sensor)
        self._sync, self._dialect, self._echo = sync, dialect, True
        self._last = 0
        self._commands = b""
        self._set(bits)

    def _set(self, bits: int) -> None:
        self._bits = bits
        if bits != STEPS:
            self._words = LayoutEncoder("edvs", _layout_of(bits, self._sync), self.sensor)

    def encode(self, events: Events) -> bytes:
        """Encode events."""
        if self._bits != STEPS:
            return self._words.encode(events)
        data = _encode_steps(events, self._last, self._sync)
        self._last = int(events.t[-1]) if events.size else self._last
        return data

    def respond(self, command: bytes) -> bytes:
        """Answer commands; a new format applies from the next event on."""
        *lines, self._commands = (self._commands + command).split(b"\n")
        self._commands = self._commands[-64:]
        answer = []
        for line in lines:
            word = line.strip().decode("ascii", "replace")
            if self._echo and word:
                answer.append(word)
            if word == "!U0":
                self._echo = False
            elif word == "?V":
                answer.append("EDVS128 V2.3")
            elif word.startswith("!E") and word[1:] in BITS[self._dialect]:
                self._set(BITS[self._dialect][word[1:]])
                answer.append(f"-{word}")
        return "".join(f"{text}\n" for text in answer).encode("ascii")


def _stated(options: OptionReader) -> tuple[str, str, int]:
    """Return format, dialect and sync bit."""
    wanted = options.choice("format", ("E3", "E0", "E1", "E2", "E4"))
    dialect = options.choice("dialect", ("new", "old"))
    if wanted not in BITS[dialect]:
        raise UsageError("edvs: the old dialect has no E4: its E3 has 32 bits")
    return wanted, dialect, int(options.choice("sync", ("1", "0")))


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder."""
    wanted, dialect, sync = _stated(options)
    if max(sensor) > 128:
        raise UsageError(f"edvs has 128x128 pixels, and not {sensor}: pass sensor='128x128'")
    bits = BITS[dialect][wanted]
    decoder = (
        EdvsStepDecoder(sensor, sync)
        if bits == STEPS
        else EdvsDecoder("edvs", _layout_of(bits, sync), sensor)
    )
    decoder.command = wanted
    return decoder


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    wanted, dialect, sync = _stated(options)
    return EdvsEncoder(sensor, BITS[dialect][wanted], sync, dialect)
