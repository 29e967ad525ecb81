"""Decoders of Prophesee's words against one that goes word by word, in plain Python."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.events import Sensor
from edge_vpr.live.protocols import open_decoder
from edge_vpr.recordings.prophesee import EVT2_KINDS, EVT3_KINDS, EvtWordDecoder
from tests.recordings.recording_files import EVT_WORDS, PlainDecoder


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
    return word.astype(EVT_WORDS[encoding])


@pytest.mark.parametrize("encoding", EVT_WORDS)
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
        assert decoder.take_counts()[1] == plain.undated
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


@pytest.mark.parametrize("encoding", EVT_WORDS)
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
