"""OpenMV's protocol: the host asks, the camera answers, and nothing is lost unsaid."""

from __future__ import annotations

from edge_vpr.stream.protocols.openmv_packets import crc


def test_the_checksums_are_those_that_were_published():
    assert (crc(b"123456789", 16), crc(b"123456789", 32)) == (0xE541, 0x41B403D3)
