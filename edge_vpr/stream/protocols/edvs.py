"""EDVS: 128 x 128 pixels, formats E0 to E4, no checksum and no sequence number.

Byte 0 is a sync bit and the row, byte 1 polarity and column, then the time: none (E0), the step
since the event before in 7-bit groups (E1), or 16, 24, 32 bits (E2, E3, E4). Firmware before
steps were introduced calls 16, 24 and 32 bits E1, E2 and E3; and there are drivers and firmware
with the sync bit inverted. What a device sends is therefore found from its bytes, unless given.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import njit

from edge_vpr.errors import UsageError
from edge_vpr.events import EVENT_DTYPE, Events, Sensor
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.gate import Clock, no_columns
from edge_vpr.stream.protocols.layout import (
    NOTICE_WORDS,
    Field,
    Layout,
    LayoutDecoder,
    LayoutEncoder,
    read_words,
)
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader, made_up_events
from edge_vpr.stream.protocols.words import SEARCH_WORDS, Raw

SENSOR = Sensor(128, 128)
#: Bits of the time, by format; steps are not of fixed size.
STEPS = -1
_BITS = {
    "new": {"E0": 0, "E1": STEPS, "E2": 16, "E3": 24, "E4": 32},
    "old": {"E0": 0, "E1": 16, "E2": 24, "E3": 32},
}
#: Bytes from which the format is found, and the longest event.
DETECT_BYTES = 1_024
#: A format found is looked for again if most of so many bytes do not fit it.
DOUBT_BYTES = 16_384
#: A reading fits if more than this share of a stretch looks right; half of any noise does.
FITS = 0.75
#: The same where no time of full length speaks for it.
FITS_WITHOUT_TIME = 0.9
_LONGEST = 6


def layout_of(bits: int, sync: int) -> Layout:
    """Lay out an event of fixed size: `bits` of time, and the value of the sync bit."""
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


class StepDecoder(Decoder):
    """Decodes E1, whose events are 3 to 6 bytes long.

    A shifted stream is noticed at the first byte that should have a sync bit and has none, or
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
            self._room = _room(raw.size)
        t, x, y, p = self._room
        at, count = 0, 0
        while True:
            if self._searching:
                # a start is judged by the events after it, and by the starts next to it
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


@njit(cache=True, nogil=True)
def _take_steps(raw, sync, now, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode whole events; stop at the first that cannot be one."""
    at, n = 0, 0
    while at < raw.size:
        if raw[at] >> 7 != sync:
            return at, n, now, True
        step, end = np.int64(0), at + 2
        while end < raw.size and raw[end] < 128 and end < at + 5:
            step = step << 7 | np.int64(raw[end])
            end += 1
        if end >= raw.size:
            break
        if raw[end] < 128:
            return at, n, now, True
        now += step << 7 | (np.int64(raw[end]) & 127)
        t[n], x[n], y[n], p[n] = now, raw[at + 1] & 127, raw[at] & 127, raw[at + 1] >> 7
        n += 1
        at = end + 1
    return at, n, now, False


@njit(cache=True, nogil=True)
def _search_steps(raw, sync, words, starts):  # type: ignore[no-untyped-def]
    """Find the first byte from which `words` events (or as many as there are) can be read.

    Returns how many bytes lie before it, and whether there is one before `starts`. A shifted
    reading takes every row for a step and so runs through time faster: of the next offsets that can
    be read, the first is right, unless another takes less than half its time.
    """
    best, best_time, first = starts, np.int64(-1), -1
    for start in range(raw.size):
        if start >= (first + _LONGEST if first >= 0 else starts):
            break
        at, n, time, bad = start, 0, np.int64(0), False
        while n < words and at < raw.size and not bad:
            if raw[at] >> 7 != sync:
                bad = True
                break
            step, end = np.int64(0), at + 2
            while end < raw.size and raw[end] < 128 and end < at + 5:
                step = step << 7 | np.int64(raw[end])
                end += 1
            if end >= raw.size:
                break
            bad = raw[end] < 128
            time += step << 7 | (np.int64(raw[end]) & 127)
            at = end + 1
            n += 1
        if not bad and n > 0:
            if first < 0:
                first = start
            # a later event of the same reading leaves out a step; a shifted reading, most of all
            if best_time < 0 or 2 * time < best_time:
                best, best_time = start, time
    return best, first >= 0


def _room(size: int) -> Columns:
    """Columns for the events that `size` bytes of steps can hold."""
    return no_columns(size // 3 + 1)


def detect(data: bytes, bits: Iterable[int], syncs: Iterable[int]) -> tuple[int, int] | None:
    """Find bits of time and sync bit of a stretch of a stream; None if nothing fits.

    A wrong reading may fit as well, where a byte of it hardly changes; time then runs faster.
    Events of steps, and events without time, are what remains if no other reading fits.

    Parameters
    ----------
    data : bytes
    bits : iterable of int
        Candidates.
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
    """Share of words that look right from the best offset, and how fast time runs there."""
    found = [(0.0, 0.0)]
    if raw.size >= layout.size:
        for offset, reading in enumerate(read_words(raw, raw.size, layout.form())):
            words = (raw.size - offset) // layout.size
            # the same again and again is a dead line; of few words many look right by chance
            share = reading.good / words * reading.moves - words**-0.5
            found.append((share, reading.pace))
    best = max(share for share, _ in found)
    return best, min(pace for share, pace in found if share > best - 0.1)


@njit(cache=True, nogil=True)
def _share_of_steps(raw, sync):  # type: ignore[no-untyped-def]
    """Share of events of steps that can be read, of these and the places where none can.

    No device says a step in more bytes than it needs.
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


class EdvsDecoder(Decoder):
    """Finds the format from the first bytes, sends the set-up, and decodes.

    Parameters
    ----------
    sensor : Sensor
    bits : sequence of int
        Candidates for the bits of the time, longest first.
    syncs : sequence of {0, 1}
        Candidates for the sync bit.
    command : str
        Format to ask the device for.
    """

    def __init__(
        self, sensor: Sensor, bits: tuple[int, ...], syncs: tuple[int, ...], command: str
    ) -> None:
        if max(sensor) > 128:
            raise UsageError(f"edvs has 128x128 pixels, and not {sensor}: leave --sensor out")
        super().__init__(sensor, Clock())
        self._bits, self._syncs, self._command = bits, syncs, command
        self._given = len(bits) == 1 and len(syncs) == 1
        self._inner: Decoder | None = None
        self._since = self._so_far()
        if self._given:
            self._settle(bits[0], syncs[0])
        else:
            self.resync_bytes = 2 * (DOUBT_BYTES + DETECT_BYTES)

    def setup(self) -> bytes:
        """Stop events, echo off, set the format, clock to zero, start events."""
        return f"E-\n!U0\n!{self._command}\n!ET0\nE+\n".encode("ascii")

    def teardown(self) -> bytes:
        """Stop events."""
        return b"E-\n"

    def feed(self, data: bytes, host_us: int = 0) -> Events:
        """Take the next bytes; see `Decoder.feed`."""
        if self._given and self._inner is not None:
            return self._inner.feed(data, host_us)
        events = []
        while data:
            if self._inner is None:
                data = self._find_format(data)
                continue
            # doubted at the same bytes, however they are cut
            left = DOUBT_BYTES - (self.health.bytes - self._since[0])
            events.append(self._inner.feed(data[:left], host_us))
            data = data[left:]
            self._doubt()
        return _joined(events) if events else self._gate.admit(no_columns())

    def gap(self, lost_bytes: int = 0) -> Events:
        """Learn that bytes are missing; see `Decoder.gap`."""
        return super().gap(lost_bytes) if self._inner is None else self._inner.gap(lost_bytes)

    def finish(self) -> Events:
        """End the stream; see `Decoder.finish`."""
        events = []
        if self._inner is None and (early := self._find_format(b"", last=True)):
            events.append(self.feed(early))
        events.append(super().finish() if self._inner is None else self._inner.finish())
        return _joined(events)

    def warm_up(self) -> None:
        """Compile what decoding needs; see `Decoder.warm_up`."""
        if self._given:
            super().warm_up()
            return
        for bits in {32, STEPS} & set(self._bits) or self._bits:
            given = EdvsDecoder(self.sensor, (bits,), self._syncs[:1], self._command)
            given.warm_up()
            for sample in given._samples():
                detect(sample, self._bits, self._syncs)

    def _samples(self) -> Iterable[bytes]:
        encoder = EdvsEncoder(self.sensor, self._bits[0], self._syncs[0], "new", echo=False)
        words = encoder.encode(made_up_events())
        # a byte is lost in the midst of them
        yield words[: len(words) // 2] + words[len(words) // 2 + 1 :]

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        return [], data

    def _find_format(self, data: bytes, *, last: bool = False) -> bytes:
        """Take bytes until their format shows; give back those that are to be decoded then."""
        health = self.health
        health.bytes += len(data)
        early = self._pending + data
        found = None
        while found is None and len(early) >= (1 if last else DETECT_BYTES):
            found = detect(early[:DETECT_BYTES], self._bits, self._syncs)
            if found is None:
                # noise so far: half of it makes room for what comes
                health.skipped_bytes += len(early[: DETECT_BYTES // 2])
                early = early[DETECT_BYTES // 2 :]
        if found is None:
            self._pending = early
            health.pending_bytes = len(early)
            return b""
        self._pending = b""
        health.bytes -= len(early)  # they are counted when they are decoded
        health.pending_bytes = 0
        self._settle(*found)
        return early

    def _settle(self, bits: int, sync: int) -> None:
        inner: Decoder
        if bits == STEPS:
            inner = StepDecoder(self.sensor, sync)
        else:
            inner = LayoutDecoder("edvs", layout_of(bits, sync), self.sensor)
        inner.adopt(self.health)
        inner._gate.succeed(self._gate)
        self._inner, self._gate = inner, inner._gate
        self._since = self._so_far()
        self.resync_bytes = inner.resync_bytes

    def _so_far(self) -> tuple[int, int, int, int]:
        health = self.health
        return health.bytes, health.skipped_bytes, health.decoded, health.rejected

    def _doubt(self) -> None:
        """Find the format anew if most bytes or times do not fit it: noise may have looked so."""
        now = self._so_far()
        received, skipped, decoded, rejected = np.subtract(now, self._since).tolist()
        if received < DOUBT_BYTES or self._inner is None:
            return
        self._since = now
        if 4 * skipped > 3 * received or 4 * rejected > 3 * decoded:
            self.health.resyncs += 1
            self._pending, self._inner = self._inner._pending, None


def _joined(events: list[Events]) -> Events:
    if len(events) == 1:
        return events[0]
    # as plain bytes, which is many times faster than field by field
    return np.concatenate([part.view(np.uint8) for part in events]).view(EVENT_DTYPE)


class EdvsEncoder(Encoder):
    """A device that starts on ``E+``, and answers commands as the maker's firmware does."""

    waits_for_host = True

    def __init__(self, sensor: Sensor, bits: int, sync: int, dialect: str, *, echo: bool) -> None:
        if max(sensor) > 128:
            raise UsageError(f"edvs has 128x128 pixels, and not {sensor}: crop the recording")
        super().__init__(sensor)
        self._sync, self._dialect, self._echo = sync, dialect, echo
        self._last = 0
        self._commands = b""
        self._set(bits)

    def _set(self, bits: int) -> None:
        self._bits = bits
        if bits != STEPS:
            self._words = LayoutEncoder("edvs", layout_of(bits, self._sync), self.sensor)

    def encode(self, events: Events) -> bytes:
        """Encode events."""
        if self._bits != STEPS:
            return self._words.encode(events)
        if events.size == 0:
            return b""
        steps = np.diff(events["t"], prepend=self._last)
        self._last = int(events["t"][-1])
        # a silence of more than 28 bits cannot be said
        steps = np.clip(steps, 0, (1 << 28) - 1)
        groups = (steps[:, None] >> np.array([21, 14, 7, 0])) & 127
        needed = np.maximum.accumulate(groups > 0, axis=1)
        needed[:, 3] = True
        groups[:, 3] |= 128
        y = self._sync << 7 | events["y"].astype(np.int64)
        x = events["p"].astype(np.int64) << 7 | events["x"]
        rows = np.concatenate([np.stack([y, x], axis=1), groups], axis=1)
        sent = np.concatenate([np.ones((steps.size, 2), dtype=np.bool_), needed], axis=1)
        return rows[sent].astype(np.uint8).tobytes()

    def respond(self, command: bytes) -> bytes:
        """Take commands; a new format counts from the next event on."""
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
            elif word.startswith("!E") and word[1:] in _BITS[self._dialect]:
                self._set(_BITS[self._dialect][word[1:]])
                answer.append(f"-{word}")
        return "".join(f"{text}\n" for text in answer).encode("ascii")


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder; the format, its dialect and its sync bit are found unless given."""
    wanted = options.choice("format", ("auto", "E0", "E1", "E2", "E3", "E4"))
    dialect = options.choice("dialect", ("auto", "new", "old"))
    sync = options.choice("sync", ("auto", "1", "0"))
    dialects = ("new", "old") if dialect == "auto" else (dialect,)
    if wanted == "auto":
        # any bytes look like events without time: these are not looked for
        bits = {32, 24, 16, STEPS}
    else:
        bits = {_BITS[each][wanted] for each in dialects if wanted in _BITS[each]}
    if not bits:
        raise UsageError("edvs: the old dialect has no E4: its E3 has 32 bits")
    return EdvsDecoder(
        sensor,
        tuple(sorted(bits, reverse=True)),
        (1, 0) if sync == "auto" else (int(sync),),
        "E3" if wanted == "auto" else wanted,
    )


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    wanted = options.choice("format", ("E3", "E0", "E1", "E2", "E4"))
    dialect = options.choice("dialect", ("new", "old"))
    if wanted not in _BITS[dialect]:
        raise UsageError("edvs: the old dialect has no E4: its E3 has 32 bits")
    return EdvsEncoder(
        sensor,
        _BITS[dialect][wanted],
        int(options.choice("sync", ("1", "0"))),
        dialect,
        echo=options.choice("echo", ("on", "off")) == "on",
    )
