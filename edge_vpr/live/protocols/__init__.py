"""Protocols of serial cameras behind one registry: ``open_decoder("edvs:format=E3", sensor)``."""

from edge_vpr.live.protocols.protocol import (
    PROTOCOLS,
    Decoder,
    Encoder,
    OptionReader,
    open_decoder,
    open_encoder,
    parse_protocol,
    protocol_names,
)

__all__ = [
    "PROTOCOLS",
    "Decoder",
    "Encoder",
    "OptionReader",
    "open_decoder",
    "open_encoder",
    "parse_protocol",
    "protocol_names",
]
