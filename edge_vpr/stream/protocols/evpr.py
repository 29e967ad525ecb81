"""Decoder of this project's own frames, which `docs/protocol_evpr.md` specifies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

import numpy as np

from edge_vpr.boxed import Box
from edge_vpr.events import EVENT_DTYPE, Events, Sensor
from edge_vpr.stream.health import EXACT
from edge_vpr.stream.protocols.cobs import Bytes
from edge_vpr.stream.protocols.evpr_encoder import EvprEncoder
from edge_vpr.stream.protocols.evpr_frames import FRAME_END, MAX_FRAME, MAX_STUFFED
from edge_vpr.stream.protocols.evpr_kernels import MEMORY, FrameRoom, decode_frames
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader, synthetic_events
from edge_vpr.stream.timestamp_filter import Clock


class EvprDecoder(Decoder):
    """Decodes frames; a frame is delivered whole and undamaged, or not at all."""

    resync_bytes = MAX_STUFFED + 1

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor, Clock(confirm=1), EXACT)
        self._endless = False  # within a frame that is already too long
        self._room = Box(FrameRoom.of(1 << 12, np.array([(-1, 0, 0, 0)], dtype=MEMORY)))

    def _samples(self) -> Iterable[bytes]:
        yield EvprEncoder(Sensor(1, 1)).encode(synthetic_events())

    def setup(self) -> bytes:
        """Return an empty frame, which reports the host's presence."""
        return FRAME_END

    def _decode_events(self, data: bytes, *, final: bool) -> tuple[list[Events], bytes]:
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

    def _take_frames(self, raw: Bytes) -> Events:
        """Decode frames, each with the zero at its end."""
        room = self._room.value
        if raw.size // 3 > room.columns.t.size:
            self._room = Box(FrameRoom.of(raw.size, room.memory))
            room = self._room.value
        clock = self._timestamps
        out = np.empty(raw.size // 3 + clock.most_held, dtype=EVENT_DTYPE)
        decoded, delivered = decode_frames(self._room.boxed, clock.boxed, raw, out)
        clock.report(decoded, delivered)
        self._account(cast("tuple[int, ...]", room.brought.item()))
        return out[:delivered]

    def _account(self, brought: Any) -> None:
        health = self.health
        frames, damaged, skipped, repeats, gaps, lost, dropped, resets, _, idle_at = brought
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
            self._idle_at = idle_at


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder; it has no options, since each frame states its widths."""
    return EvprDecoder(sensor)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    return EvprEncoder(
        sensor,
        width=int(options.choice("width", ("4", "3"))),
        boot=options.integer("boot", 0, 0, 0xFFFF),
        frame_bytes=options.integer("frame", 2_048, 64, MAX_FRAME),
    )
