"""EDVS: 128 x 128 pixels, formats E0 to E4, no checksum and no sequence number.

Byte 0 holds a sync bit and the row, byte 1 polarity and column. The time follows: none (E0), the
step since the previous event in 7-bit groups (E1), or 16, 24, 32 bits (E2, E3, E4). Firmware older
than the format with steps calls 16, 24 and 32 bits E1, E2 and E3. Some drivers and firmware invert
the sync bit. The format of a device is therefore found from its bytes, unless given.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor, join_events
from edge_vpr.recordings.columns import Columns
from edge_vpr.stream.protocols.edvs_formats import BITS, STEPS, detect, layout_of
from edge_vpr.stream.protocols.edvs_steps import StepDecoder, encode_steps
from edge_vpr.stream.protocols.layout import LayoutDecoder, LayoutEncoder
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader, damaged_sample
from edge_vpr.stream.timestamp_filter import Clock

SENSOR = Sensor(128, 128)
#: Number of bytes from which the format is found.
DETECT_BYTES = 1_024
#: The format is searched for again if most of this number of bytes do not fit it.
DOUBT_BYTES = 16_384


class EdvsDecoder(Decoder):
    """Finds the format from the first bytes, sends the set-up commands, and decodes.

    Parameters
    ----------
    sensor : Sensor
    bits : sequence of int
        Candidates for the number of bits of the time, longest first.
    syncs : sequence of {0, 1}
        Candidates for the sync bit.
    command : str
        Format to request from the device.
    """

    def __init__(
        self, sensor: Sensor, bits: tuple[int, ...], syncs: tuple[int, ...], command: str
    ) -> None:
        if max(sensor) > 128:
            raise UsageError(f"edvs has 128x128 pixels, and not {sensor}: pass --sensor 128x128")
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
        """Return commands: stop events, echo off, set the format, clock to zero, start events."""
        return f"E-\n!U0\n!{self._command}\n!ET0\nE+\n".encode("ascii")

    def teardown(self) -> bytes:
        """Return the command that stops events."""
        return b"E-\n"

    def feed(self, data: bytes, host_us: int = 0) -> Events:
        """Decode the next bytes; see `Decoder.feed`."""
        if self._given and self._inner is not None:
            return self._inner.feed(data, host_us)
        events = []
        while data:
            if self._inner is None:
                data = self._find_format(data)
                continue
            # the format is checked after the same bytes, whatever the sizes of the pieces
            left = DOUBT_BYTES - (self.health.bytes - self._since[0])
            events.append(self._inner.feed(data[:left], host_us))
            data = data[left:]
            self._doubt()
        return join_events(events)

    def gap(self, lost_bytes: int = 0) -> Events:
        """Handle missing bytes; see `Decoder.gap`."""
        return super().gap(lost_bytes) if self._inner is None else self._inner.gap(lost_bytes)

    def finish(self) -> Events:
        """End the stream; see `Decoder.finish`."""
        events = []
        if self._inner is None and (early := self._find_format(b"", last=True)):
            events.append(self.feed(early))
        events.append(super().finish() if self._inner is None else self._inner.finish())
        return join_events(events)

    def warm_up(self) -> None:
        """Compile the kernels for decoding; see `Decoder.warm_up`."""
        if self._given:
            super().warm_up()
            return
        for bits in {32, STEPS} & set(self._bits) or self._bits:
            given = EdvsDecoder(self.sensor, (bits,), self._syncs[:1], self._command)
            given.warm_up()
            for sample in given._samples():
                detect(sample, self._bits, self._syncs)

    def _samples(self) -> Iterable[bytes]:
        yield damaged_sample(
            EdvsEncoder(self.sensor, self._bits[0], self._syncs[0], "new", echo=False)
        )

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        return [], data

    def _find_format(self, data: bytes, *, last: bool = False) -> bytes:
        """Collect bytes until their format is found, then return the bytes to decode."""
        health = self.health
        health.bytes += len(data)
        early = self._pending + data
        found = None
        while found is None and len(early) >= (1 if last else DETECT_BYTES):
            found = detect(early[:DETECT_BYTES], self._bits, self._syncs)
            if found is None:
                # only noise so far: half of it is dropped to make room for later bytes
                health.skipped_bytes += len(early[: DETECT_BYTES // 2])
                early = early[DETECT_BYTES // 2 :]
        if found is None:
            self._pending = early
            health.pending_bytes = len(early)
            return b""
        self._pending = b""
        health.bytes -= len(early)  # counted when they are decoded
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
        inner._timestamps.take_over_from(self._timestamps)
        self._inner, self._timestamps = inner, inner._timestamps
        self._since = self._so_far()
        self.resync_bytes = inner.resync_bytes

    def _so_far(self) -> tuple[int, int, int, int]:
        health = self.health
        return health.bytes, health.skipped_bytes, health.decoded, health.rejected

    def _doubt(self) -> None:
        """Search for the format again if most bytes or times do not fit it."""
        now = self._so_far()
        received, skipped, decoded, rejected = np.subtract(now, self._since).tolist()
        if received < DOUBT_BYTES or self._inner is None:
            return
        self._since = now
        if 4 * skipped > 3 * received or 4 * rejected > 3 * decoded:
            self.health.resyncs += 1
            self._pending, self._inner = self._inner._pending, None


class EdvsEncoder(Encoder):
    """Device that starts on ``E+``, and answers commands as the maker's firmware does."""

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
        data = encode_steps(events, self._last, self._sync)
        self._last = int(events["t"][-1]) if events.size else self._last
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


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder; format, dialect and sync bit are found from the bytes unless given."""
    wanted = options.choice("format", ("auto", "E0", "E1", "E2", "E3", "E4"))
    dialect = options.choice("dialect", ("auto", "new", "old"))
    sync = options.choice("sync", ("auto", "1", "0"))
    dialects = ("new", "old") if dialect == "auto" else (dialect,)
    if wanted == "auto":
        # any bytes look like events without time, so that this format is not searched for
        bits = {32, 24, 16, STEPS}
    else:
        bits = {BITS[each][wanted] for each in dialects if wanted in BITS[each]}
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
    if wanted not in BITS[dialect]:
        raise UsageError("edvs: the old dialect has no E4: its E3 has 32 bits")
    return EdvsEncoder(
        sensor,
        BITS[dialect][wanted],
        int(options.choice("sync", ("1", "0"))),
        dialect,
        echo=options.choice("echo", ("on", "off")) == "on",
    )
