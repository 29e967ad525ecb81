"""Raw Prophesee words over a line: EVT 2.0, 2.1 and 3.0, without header or frame."""

from __future__ import annotations

from abc import abstractmethod
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError
from edge_vpr.events import Columns, Events, Sensor
from edge_vpr.live.protocols import Clock, Decoder, Encoder, OptionReader
from edge_vpr.live.protocols.words import SEARCH_WORDS, Raw, Reading, WordDecoder, word_at
from edge_vpr.recordings.prophesee import (
    EVT2_KINDS,
    EVT3_KINDS,
    EvtWordDecoder,
    evt2_event_words,
    evt2_time_words,
)

Words = npt.NDArray[Any]
Sent = npt.NDArray[np.bool_]

#: Number of bytes that are copied at once; a multiple of each word size.
_COPIED_BYTES = 4_096
#: Number of words that are checked at once.
_CHECKED = 4_096
#: Cameras send the high bits of the time every 16 us, whether changed or not.
_SLOT_BITS = 4
#: Time between the words of a silence, and the time before its end from which on they are sent.
_SILENT_US, _LONGEST_SILENCE_US = 1 << 15, 1 << 26
#: Existing kinds of words, one bit each.
_KINDS_EVT2 = sum(1 << kind for kind in EVT2_KINDS)
_KINDS_EVT3 = sum(1 << kind for kind in EVT3_KINDS)
#: Words without meaning, with which cameras by Lucid fill their buffers.
_PADDING_EVT3, _PADDING_EVT2 = 0x9999, 0x99999999


class EvtDecoder(WordDecoder):
    """Decodes words; a word of an unknown kind, or off the sensor, shows a shifted stream."""

    def __init__(self, name: str, sensor: Sensor) -> None:
        if max(sensor) > 2048:
            raise UsageError(f"{name} holds up to 2048x2048 pixels, and not {sensor}")
        self._words = EvtWordDecoder(name, 1)
        super().__init__(
            sensor, Clock(), self._words.dtype.itemsize,
            search_words=2 * SEARCH_WORDS if name == "evt3" else SEARCH_WORDS,
            notice_words=64 if name == "evt3" else 16,
        )  # fmt: skip
        self._name = name
        self._shift = np.uint64(32 if name == "evt21" else 0)  # to the upper half of a long word

    def _readings(self, raw: Raw, most: int) -> list[Reading]:
        rows = _read(raw, most, self._size, self._name == "evt3", self._shift, *self.sensor)
        return [Reading(*row) for row in rows.tolist()]

    def _take_words(self, raw: Raw) -> tuple[int, Columns, bool]:
        words = raw.view(self._words.dtype)
        if not words.flags.aligned:
            # The kernels would be compiled again for words that are not aligned, or that are
            # writeable. Only a part is copied, so that a fault does not cause all the rest to be
            # copied again.
            words = words[: _COPIED_BYTES // self._size].copy()
            words.flags.writeable = False
        used = int(_whole(words, self._name == "evt3", self._shift, *self.sensor))
        columns = self._words.decode(words[:used])
        self.health.wraps, undated = self._words.take_counts()
        self.health.reject_undated(undated)
        return used, columns, used < words.size

    def _lose_sync(self) -> None:
        super()._lose_sync()
        self._words.lose()


@kernel(inner=True)
def _bad(word, evt3, width, height):  # type: ignore[no-untyped-def]
    """Return whether a word, or the upper half of a longer one, is not valid."""
    if evt3:
        kind, value = word >> 12, word & 2047
        if not (_KINDS_EVT3 >> kind) & 1:
            return word != _PADDING_EVT3
        return value >= (height if kind == 0 else width if kind == 2 or kind == 3 else 2048)
    kind = word >> 28
    if kind < 2:
        return (word >> 11) & 2047 >= width or word & 2047 >= height
    return not (_KINDS_EVT2 >> kind) & 1 and word != _PADDING_EVT2


@kernel
def _whole(words, evt3, shift, width, height):  # type: ignore[no-untyped-def]
    """Return the number of words before the first invalid one."""
    for start in range(0, words.size, _CHECKED):
        block, bad = words[start : start + _CHECKED], np.uint16(0)
        # without a branch, in 16 bits where these suffice, so that the loops vectorise
        for i in range(block.size if evt3 else 0):
            word = np.uint16(block[i])
            kind, value = np.uint16(word >> np.uint16(12)), np.uint16(word & np.uint16(2047))
            off = ((kind == 0) & (value >= height)) | ((kind == 2) | (kind == 3)) & (value >= width)
            strange = (kind == 1) | (kind == 9) | (kind == 11) | (kind == 12) | (kind == 13)
            bad = np.uint16(bad | np.uint16(off | strange))
        for i in range(0 if evt3 else block.size):
            upper = np.uint32(block[i] >> shift)
            sort, row = np.uint32(upper >> np.uint32(28)), np.uint32(upper & np.uint32(2047))
            column = np.uint32(upper >> np.uint32(11) & np.uint32(2047))
            strange = (sort > 1) & (sort != 8) & (sort != 10) & (sort < 14)
            off = (sort < 2) & ((column >= width) | (row >= height))
            bad = np.uint16(bad | np.uint16(off | strange))
        if bad:
            for i in range(block.size):
                if _bad(np.int64(block[i] >> shift), evt3, width, height):
                    return start + i
    return words.size


@kernel
def _read(raw, most, size, evt3, shift, width, height):  # type: ignore[no-untyped-def]
    """Return the number of valid words, and the first of them, for each offset."""
    readings = np.zeros((min(size, raw.size - size + 1), 2))
    for offset in range(len(readings)):
        words = min(most, (raw.size - offset) // size)
        good, first = 0, words
        for i in range(words):
            word = np.int64(word_at(raw, offset + i * size, size, False) >> shift)
            if not _bad(word, evt3, width, height):
                good += 1
                first = min(first, i)
        readings[offset, 0], readings[offset, 1] = good, first
    return readings


class EvtEncoder(Encoder):
    """Decides when the high bits of the time are sent again, as a camera does."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._slot = -1

    def encode(self, events: Events) -> bytes:
        """Encode events."""
        if events.size == 0:
            return b""
        slot = events.t >> _SLOT_BITS
        new = np.diff(slot, prepend=self._slot) != 0
        self._slot = int(slot[-1])
        words, sent = self._words(events, new)
        return np.stack(words, axis=1)[np.stack(sent, axis=1)].tobytes()

    @abstractmethod
    def _words(self, events: Events, new: Sent) -> tuple[list[Words], list[Sent]]:
        """Return the words of events, in the order of sending, and which of them are sent.

        `new` says before which events, at least one, the high bits of the time are sent.
        """


class Evt2Encoder(EvtEncoder):
    """Encodes EVT 2.0: high time bits as often as cameras send them, and a word an event."""

    def _words(self, events: Events, new: Sent) -> tuple[list[Words], list[Sent]]:
        words = [evt2_time_words(events.t), evt2_event_words(events)]
        return words, [new, np.ones_like(new)]


class Evt21Encoder(EvtEncoder):
    """Encodes EVT 2.1 words of one event each."""

    def _words(self, events: Events, new: Sent) -> tuple[list[Words], list[Sent]]:
        # the upper half is a word of EVT 2.0 whose column is a multiple of 32; the lower half has a
        # bit for each of the 32 columns from there on
        x = events.x.astype(np.uint64)
        top = evt2_event_words(events).astype("<u8") & ~np.uint64(31 << 11)
        word = top << np.uint64(32) | np.uint64(1) << (x & np.uint64(31))
        time = evt2_time_words(events.t).astype("<u8") << np.uint64(32)
        return [time, word], [new, np.ones_like(new)]


class Evt3Encoder(EvtEncoder):
    """Encodes EVT 3.0: times, the row when it changes, and a column an event."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._low, self._y = -1, -1

    def encode(self, events: Events) -> bytes:
        """Encode events; silences have words of time, or a wrap within one would be a restart."""
        t = events.t
        before = np.append(t[:1] if self._slot < 0 else self._slot << _SLOT_BITS, t[:-1])
        starts = np.flatnonzero(t - before > _SILENT_US)
        cuts = pairwise([0, *starts.tolist(), len(events)])
        first, *parts = (events[a:b] for a, b in cuts)
        sent = [super().encode(first)]
        for i, part in zip(starts, parts, strict=True):
            begin = max(before[i], t[i] - _LONGEST_SILENCE_US) + _SILENT_US
            high = np.arange(begin, t[i], _SILENT_US) >> 12 & 4095
            sent += [(8 << 12 | high).astype("<u2").tobytes(), super().encode(part)]
        return b"".join(sent)

    def _words(self, events: Events, new: Sent) -> tuple[list[Words], list[Sent]]:
        t, y = events.t, events.y.astype(np.int64)
        low = t & 4095
        new_low = new | (np.diff(low, prepend=self._low) != 0)
        new_y = np.diff(y, prepend=self._y) != 0
        self._low, self._y = int(low[-1]), int(y[-1])
        column = 2 << 12 | events.p.astype(np.int64) << 11 | events.x
        words = [8 << 12 | t >> 12 & 4095, 6 << 12 | low, y, column]
        return [each.astype("<u2") for each in words], [new, new_low, new_y, np.ones_like(new)]


#: Encoders of the words, by the name of the protocol.
ENCODERS: dict[str, type[Encoder]] = {
    "evt2": Evt2Encoder,
    "evt21": Evt21Encoder,
    "evt3": Evt3Encoder,
}


def open_decoder(name: str, sensor: Sensor, options: OptionReader) -> Decoder:
    """Make a decoder."""
    return EvtDecoder(name, sensor)


def open_encoder(name: str, sensor: Sensor, options: OptionReader) -> Encoder:
    """Make an encoder."""
    return ENCODERS[name](sensor)
