"""Our own frames, decoded; `docs/protocol_evpr.md` is their specification."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Any, cast

import numpy as np

from edge_vpr.events import Sensor
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.health import EXACT
from edge_vpr.stream.protocols.cobs import Bytes
from edge_vpr.stream.protocols.evpr_encoder import EvprEncoder
from edge_vpr.stream.protocols.evpr_frames import FRAME_END, MAX_FRAME, MAX_STUFFED
from edge_vpr.stream.protocols.evpr_kernels import BROUGHT, MEMORY, take_frames, unstuff_frames
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader, synthetic_events
from edge_vpr.stream.timestamp_filter import Clock, no_columns


class EvprDecoder(Decoder):
    """Decodes frames; a frame is delivered whole and undamaged, or not at all."""

    resync_bytes = MAX_STUFFED + 1

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor, Clock(confirm=1), EXACT)
        self._memory = np.array([(-1, 0, 0, 0)], dtype=MEMORY)
        self._endless = False  # within a frame that is too long already
        self._reserve(1 << 12)

    def _samples(self) -> Iterable[bytes]:
        yield EvprEncoder(Sensor(1, 1)).encode(synthetic_events())

    def setup(self) -> bytes:
        """Say that the host is there, by an empty frame."""
        return FRAME_END

    def _reserve(self, size: int) -> None:
        """Make room for what frames of `size` bytes together can hold."""
        self._plain = np.empty(size, dtype=np.uint8)
        self._spans = np.empty((size // 2 + 1, 3), dtype=np.int64)
        self._room = no_columns(size // 3)

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        end = data.rfind(FRAME_END) + 1
        parts, rest = [], data[end:]
        if end:
            start = 0
            if self._endless:
                start = data.index(FRAME_END) + 1
                self.health.skipped_bytes += start
                self._endless = False
            parts.append(self._take_frames(np.frombuffer(data, dtype=np.uint8)[start:end]))
        if self._endless or len(rest) > MAX_STUFFED or (final and rest):
            self.health.skipped_bytes += len(rest)
            if not self._endless:
                self.health.crc_errors += 1
                self.health.resyncs += 1
                self._endless = True
            rest = b""
        self._endless = self._endless and not final
        return parts, rest

    def _take_frames(self, raw: Bytes) -> Columns:
        """Decode frames, each with the zero at its end."""
        if raw.size > self._plain.size:
            self._reserve(raw.size)
        n = unstuff_frames(raw, self._plain, self._spans)
        spans, plain = self._spans[:n], self._plain.data
        # zlib's checksum is several times faster than a compiled one of our own
        checks = np.array(
            [zlib.crc32(plain[at : at + size]) for at, size, _ in spans.tolist()], dtype=np.int64
        )
        brought = np.zeros(1, dtype=BROUGHT)
        t, x, y, p = columns = self._room
        events = take_frames(self._plain, spans, checks, self._memory, brought, columns)
        self._account(cast("tuple[int, ...]", brought.item()))
        return Columns(t[:events], x[:events], y[:events], p[:events])

    def _account(self, brought: Any) -> None:
        health = self.health
        frames, damaged, skipped, repeats, gaps, lost, dropped, resets, base, idle_at = brought
        health.frames += frames
        health.crc_errors += damaged
        health.resyncs += damaged
        health.skipped_bytes += skipped
        health.repeats += repeats
        health.sequence_gaps += gaps
        health.lost += lost
        health.lost_at_most = health.lost
        health.device_dropped += dropped
        health.device_resets += resets
        if frames:
            self._timestamps.start_at(base)
            self._idle_at = idle_at


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder; widths are in each frame, so that it has no options."""
    return EvprDecoder(sensor)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    return EvprEncoder(
        sensor,
        width=int(options.choice("width", ("4", "3"))),
        boot=options.integer("boot", 0, 0, 0xFFFF),
        frame_bytes=options.integer("frame", 2_048, 64, MAX_FRAME),
    )
