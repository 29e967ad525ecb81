"""Protocols by name: built-in ones, and those that other packages register."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.plugins import load_plugin, names_with_plugins
from edge_vpr.stream.protocols.protocol import Decoder, Encoder, OptionReader

#: An entry point of this group names a module with ``open_decoder(name, sensor, options)`` and
#: ``open_encoder(name, sensor, options)``; both functions take an `OptionReader`.
GROUP = "edge_vpr.protocols"


@dataclass(frozen=True)
class Protocol:
    """A protocol and its module, which is imported when first used."""

    name: str
    title: str
    module: str


#: The protocols of this package, by the name that ``--protocol`` takes.
PROTOCOLS: dict[str, Protocol] = {
    entry.name: entry
    for entry in (
        Protocol("evpr", "this project's frames: sequence numbers, drop counts, CRC-32", "evpr"),
        Protocol("edvs", "eDVS E0 to E4", "edvs"),
        Protocol("evt2", "raw Prophesee EVT 2.0 words", "evt"),
        Protocol("evt21", "raw Prophesee EVT 2.1 words", "evt"),
        Protocol("evt3", "raw Prophesee EVT 3.0 words", "evt"),
        Protocol("openmv", "OpenMV protocol v2", "openmv"),
        Protocol("aer", "address-event words, described by a TOML layout", "aer"),
    )
}


def parse_protocol(text: str) -> tuple[str, dict[str, str]]:
    """Split text such as ``edvs`` or ``edvs:format=E3,sync=1`` into a name and options.

    Raises
    ------
    UsageError
        If an option has no value.
    """
    name, _, rest = text.partition(":")
    options = {}
    for item in filter(None, rest.split(",")):
        key, equals, value = item.partition("=")
        if not (key and equals and value):
            raise UsageError(
                f"protocol {text!r}: option {item!r} is not NAME=VALUE: write for example "
                "edvs:format=E3"
            )
        options[key] = value
    return name, options


def protocol_names() -> list[str]:
    """Return the names of all protocols, those of other packages last."""
    return names_with_plugins(PROTOCOLS, GROUP)


def open_decoder(protocol: str, sensor: Sensor) -> Decoder:
    """Make the decoder of a protocol.

    Parameters
    ----------
    protocol : str
        Name, with options after a colon: ``edvs:format=E3,sync=1``.
    sensor : Sensor

    Raises
    ------
    UsageError
        If the protocol or an option is unknown, or the sensor is too large for it.
    """
    name, options = parse_protocol(protocol)
    reader = OptionReader(name, options)
    decoder: Decoder = _module(name).open_decoder(name, sensor, reader)
    reader.done()
    return decoder


def open_encoder(protocol: str, sensor: Sensor) -> Encoder:
    """Make the encoder of a protocol; see `open_decoder`."""
    name, options = parse_protocol(protocol)
    reader = OptionReader(name, options)
    encoder: Encoder = _module(name).open_encoder(name, sensor, reader)
    reader.done()
    return encoder


def _module(name: str) -> ModuleType:
    if name in PROTOCOLS:
        return import_module(f"edge_vpr.stream.protocols.{PROTOCOLS[name].module}")
    module: ModuleType | None = load_plugin(name, GROUP)
    if module is None:
        raise UsageError(
            f"protocol {name!r} is unknown: choose one of {', '.join(protocol_names())}"
        )
    return module
