"""Decoders take any bytes at all; `fuzz_decoders.py` feeds them for hours."""

from __future__ import annotations

import numpy as np
import pytest

from edge_vpr.errors import UsageError
from edge_vpr.live.protocols import PROTOCOLS, open_decoder
from tests.live.fuzz_decoders import PAIRS, SENSOR, one_input


def test_every_protocol_is_fed_hostile_streams():
    assert {host.partition(":")[0] for host, _ in PAIRS} == set(PROTOCOLS)


@pytest.mark.parametrize("number", range(len(PAIRS)), ids=[f"{a}-{b}" for a, b in PAIRS])
def test_no_stream_breaks_a_decoder(number):
    """Books balance, times run forward, pixels exist, memory and time are bounded."""
    for seed in range(60):
        one_input(PAIRS[number], np.random.default_rng([number, seed, 1]))


@pytest.mark.parametrize(
    "text",
    [
        "bytes = " + "9" * 5_000,
        "x = " + "[" * 5_000,
        'endian = "\\u001b[2J"',
        '"\\u001b]0;a\\u0007" = 1',
        "bytes = 0x" + "f" * 5_000,
        "bytes = 4\nendian = 'big'\nx = [0x" + "f" * 5_000 + "]",
        "\x1b = 1",
    ],
)
def test_a_layout_that_is_hostile_is_one_short_line(text, tmp_path):
    path = tmp_path / "layout.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        open_decoder(f"aer:layout={path}", SENSOR)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1_000
