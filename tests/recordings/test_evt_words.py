"""Decoders of Prophesee's words against one that goes word by word, in plain Python."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.events import Sensor
from edge_vpr.live.protocols import open_decoder
from edge_vpr.recordings.prophesee import EVT2_KINDS, EVT3_KINDS, EvtWordDecoder

ENCODINGS = {"evt2": "<u4", "evt21": "<u8", "evt3": "<u2"}


class PlainDecoder:
    """The meaning of the words, one after another."""

    def __init__(self, encoding):
        self.encoding, self.undated = encoding, 0
        self.base = self.stride = self.polarity = 0
        self.before = -1
        self.lose()

    def lose(self):
        self.high = self.low = self.row = self.first = -1

    def decode(self, words):
        step = self._evt3 if self.encoding == "evt3" else self._evt2
        return [event for word in words.tolist() for event in step(word)]

    def _evt2(self, word):
        columns = [0]
        if self.encoding == "evt21":
            columns = [bit for bit in range(32) if word >> bit & 1]
            word >>= 32
        kind = word >> 28
        if kind == 8:
            high = word & 0xFFFFFFF
            step = (high - self.before + (1 << 27)) % (1 << 28) - (1 << 27)
            self.base = high if self.before < 0 else self.base + step
            self.high = self.before = high
        if kind > 1 or self.high < 0:
            self.undated += len(columns) * (kind < 2)
            return []
        time, x, y = self.base * 64 + (word >> 22 & 63), word >> 11 & 2047, word & 2047
        return [(time, x + column, y, kind == 1) for column in columns]

    def _evt3(self, word):
        kind, value = word >> 12, word & 4095
        events, x = [], value & 2047
        if kind == 0:
            self.row = value & 2047
        elif kind == 2:
            events = [(x, value > 2047)]
        elif kind == 3:
            self.first, self.polarity = x, value > 2047
        elif kind in (4, 5):
            width = 12 if kind == 4 else 8
            on = [bit for bit in range(width) if value >> bit & 1]
            events = [(self.first + bit, self.polarity) for bit in on]
            if self.first < 0:
                self.undated += len(events)
                return []
            self.first = min(self.first + width, 2048)
        elif kind == 6 and self.high >= 0:
            self.low = value
        elif kind == 8 and value != self.high:
            self._turn(value)
            self.high = self.before = value
            self.low = min(self.low, 0)
        if self.high < 0 or self.low < 0 or self.row < 0:
            self.undated += len(events)
            return []
        return [(self.base * 4096 + self.low, x, self.row, bool(p)) for x, p in events]

    def _turn(self, high):
        if self.before < 0:
            self.base, self.stride = high, 1024
            return
        step = high - self.before
        if step >= 4086:
            step -= 4096
        elif step <= max(10, 2 * self.stride) - 4096:
            step += 4096
        self.base += step
        step = min(step, 2 * self.stride + 16, 1024)
        self.stride = max(step, self.stride - (self.stride + 15) // 16)


def random_words(encoding, rng, n):
    """Words of every kind, with times that stand, rise, wrap, or are any."""
    kinds = EVT3_KINDS if encoding == "evt3" else EVT2_KINDS
    kind = rng.choice([*kinds, *(k for k in kinds if k < 9), 9], n).astype(np.uint64)
    bits = 12 if encoding == "evt3" else 28
    value = rng.integers(0, 1 << bits, n)
    high = {
        "stands": np.full(n, 7),
        "rises": np.cumsum(rng.integers(0, 3, n)),
        "wraps": (1 << bits) - n // 2 + np.cumsum(rng.integers(0, 3, n)),
        "any": value,
    }[rng.choice(["stands", "rises", "wraps", "any"])]
    value = np.where(kind == 8, high % (1 << bits), value).astype(np.uint64)
    word = kind << np.uint64(bits) | value
    if encoding == "evt21":
        valid = rng.integers(0, 1 << 32, n) & rng.integers(0, 1 << 32, n)
        word = word << np.uint64(32) | valid.astype(np.uint64)
    return word.astype(ENCODINGS[encoding])


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(seed=st.integers(0, 1 << 32), n=st.sampled_from([1, 5, 60, 3_000]))
def test_any_words_have_the_meaning_that_plain_python_gives_them(encoding, seed, n):
    """However they are cut, also behind a loss, and over more words than a block has."""
    rng = np.random.default_rng(seed)
    words = random_words(encoding, rng, n)
    decoder, plain = EvtWordDecoder(encoding, 1), PlainDecoder(encoding)
    for part in np.split(words, np.sort(rng.integers(0, n + 1, 3))):
        if rng.random() < 0.2:
            decoder.lose()
            plain.lose()
        columns = decoder.decode(part)
        expected = plain.decode(part)
        assert list(zip(*(column.tolist() for column in columns), strict=True)) == expected
        assert decoder.take_undated() == plain.undated
        plain.undated = 0


def is_whole(encoding, word, sensor):
    """Whether a word may come from a camera of this size."""
    if encoding == "evt3":
        kind, value = word >> 12, word & 2047
        most = {0: sensor.height, 2: sensor.width, 3: sensor.width}.get(kind, 2048)
        return word == 0x9999 or (kind in EVT3_KINDS and value < most)
    word >>= 32 if encoding == "evt21" else 0
    inside = word >> 11 & 2047 < sensor.width and word & 2047 < sensor.height
    kind = word >> 28
    return word == 0x99999999 or (inside if kind < 2 else kind in EVT2_KINDS)


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(seed=st.integers(0, 1 << 32), n=st.sampled_from([200, 9_000]))
def test_a_line_is_decoded_up_to_the_first_word_that_no_camera_sends(encoding, seed, n):
    rng = np.random.default_rng(seed)
    sensor = Sensor(*rng.integers(1, 2049, 2).tolist())
    words = random_words(encoding, rng, n)
    good = np.array([is_whole(encoding, word, sensor) for word in words.tolist()])
    words = np.concatenate([words[good], words[~good][:1], words[good]])
    decoder = open_decoder(encoding, sensor)
    used, _, out_of_sync = decoder._take_words(words.view(np.uint8))
    assert used == np.count_nonzero(good)
    assert out_of_sync == (used < len(words))
