"""Decoder of this project's own frames, which `docs/protocol_evpr.md` specifies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np

from edge_vpr.boxed import Box
from edge_vpr.events import Events, Sensor
from edge_vpr.online.followed import FEW
from edge_vpr.stream.following import Follower, Step
from edge_vpr.stream.health import EXACT
from edge_vpr.stream.protocols.evpr_encoder import EvprEncoder
from edge_vpr.stream.protocols.evpr_frames import FRAME_END, MAX_FRAME, MAX_STUFFED
from edge_vpr.stream.protocols.evpr_kernels import MEMORY, FrameRoom, decode_frames, follow_frames
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader, synthetic_events
from edge_vpr.stream.timestamp_filter import Clock


class EvprDecoder(Decoder):
    """Decodes frames; a frame is delivered whole and undamaged, or not at all."""

    resync_bytes = MAX_STUFFED + 1

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor, Clock(confirm=1), EXACT)
        self._endless = False  # within a frame that is already too long
        self._room = Box(FrameRoom.of(3 * FEW, np.array([(-1, 0, 0, 0)], dtype=MEMORY)))

    def _samples(self) -> Iterable[bytes]:
        yield EvprEncoder(Sensor(1, 1)).encode(synthetic_events())

    def setup(self) -> bytes:
        """Return an empty frame, which reports the host's presence."""
        return FRAME_END

    def _decode_events(self, data: bytes, *, final: bool) -> tuple[list[Events], bytes]:
        frames, rest = self._cut(data, final=final)
        return [self._take_frames(frames)] if frames else [], rest

    def _cut(self, data: bytes, *, final: bool = False) -> tuple[bytes, bytes]:
        """Return the frames of these bytes, each with the zero at its end, and the rest."""
        if data.endswith(FRAME_END) and not self._endless:
            return data, b""
        end = data.rfind(FRAME_END) + 1
        start, rest = 0, data[end:]
        if end and self._endless:
            start = data.index(FRAME_END) + 1
            self.health.skipped_bytes += start
            self._endless = False
        if self._endless or len(rest) > MAX_STUFFED or (final and rest):
            self.health.skipped_bytes += len(rest)
            if not self._endless:
                self.health.crc_errors += 1
                self.health.resyncs += 1
                self._endless = True
            rest = b""
        self._endless = self._endless and not final
        return data[start:end], rest

    def _take_frames(self, frames: bytes) -> Events:
        room = self._room.value
        if len(frames) // 3 > room.columns.t.size:
            self._room = Box(FrameRoom.of(len(frames), room.memory))
        return self._account(*decode_frames(self._room.boxed, self._timestamps.box.boxed, frames))

    def decode_and_follow(
        self, data: bytes, host_us: int, follower: Follower
    ) -> tuple[Events, Step]:
        """See `Decoder.decode_and_follow`."""
        health = self.health
        health.bytes += len(data)
        before = health.skipped_bytes
        data = self._pending + data
        frames, rest = self._cut(data)
        if len(frames) > 3 * FEW:
            events = self._take_frames(frames)
            step = follower.follow(events, self.reached_us)
        else:
            room, clock = self._room.boxed, self._timestamps.box.boxed
            decoded, result = follower.bound(follow_frames, frames, room, clock)(frames)
            events = self._account(*decoded)
            step = follower.go_on(events, decoded[-1], *result)
        self._account_bytes(data, rest, before)
        return events, step

    def _account(
        self, events: Events, frames: int, decoded: int, same: bool, reached_us: int
    ) -> Events:
        """Add the counts of frames to the health, and return their events."""
        health, delivered = self.health, len(events)
        health.frames += frames
        if same:
            health.decoded += decoded
            health.events += delivered
            return events
        self._timestamps.report(decoded, delivered)
        brought = cast("tuple[int, ...]", self._room.value.brought.item())
        _, damaged, skipped, repeats, gaps, lost, dropped, resets, _, _ = brought
        health.crc_errors += damaged
        health.resyncs += damaged
        health.skipped_bytes += skipped
        health.repeats += repeats
        health.sequence_gaps += gaps
        health.lost += lost
        health.lost_at_most = health.lost
        health.device_dropped += dropped
        health.device_resets += resets
        return events


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
