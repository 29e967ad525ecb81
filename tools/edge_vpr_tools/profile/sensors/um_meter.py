"""RDTech's USB power meters UM24C, UM25C and UM34C, by their serial line (Bluetooth or USB).

The host sends one byte, and the meter answers with 130. The layout was found by users; the sources
sigrok.org/wiki/RDTech_UM_series, libsigrok's src/hardware/rdtech-um and rfinnie/rdserialtool agree.
This module was not tested with a meter.
"""

from __future__ import annotations

import struct
import threading
import time
from dataclasses import dataclass

from edge_vpr.live.links import Link, LinkError, open_link
from edge_vpr_tools.profile.sensors.sensor import About, Sensor, SensorError, plausible

FRAME_BYTES = 130
_ASK = b"\xf0"
# model, volts and amperes in steps of the model, milliwatts
_HEAD = struct.Struct(">HHHI")
#: the meter measures about twice a second
_PERIOD_S = 0.5
#: longest time of an answer, and longest time without any answer
_ANSWER_S, _PATIENCE_S = 0.4, 3.0
#: assumed, since no accuracy was found in a primary source
_GAIN_ERROR = 0.01


@dataclass(frozen=True)
class Model:
    """Model of the meters."""

    name: str
    #: volts, amperes: steps of its numbers.
    volts: float
    amperes: float
    #: Last bytes of a frame; empty if there is a checksum instead. The checksum is not needed,
    #: since `decode` compares power with volts times amperes.
    end: bytes


#: models by the first two bytes of a frame
MODELS = {
    0x0963: Model("UM24C", 1e-2, 1e-3, b"\xff\xf1"),
    0x09C9: Model("UM25C", 1e-3, 1e-4, b"\xff\xf1"),
    0x0D4C: Model("UM34C", 1e-2, 1e-3, b""),
}
_HEADS = tuple(number.to_bytes(2, "big") for number in MODELS)


def decode(frame: bytes) -> tuple[Model, float]:
    """Return the model and the watts of a frame.

    Returns
    -------
    watts : float
        Volts times amperes, which have finer steps than the meter's own product.

    Raises
    ------
    SensorError
        If the frame has another length, model or end, or its power is not the product.
    """
    if len(frame) != FRAME_BYTES:
        raise SensorError(f"{len(frame)} bytes of {FRAME_BYTES}")
    number, volts, amperes, milliwatts = _HEAD.unpack_from(frame)
    model = MODELS.get(number)
    if model is None:
        raise SensorError(f"the unknown model 0x{number:04x}")
    if not frame.endswith(model.end):
        raise SensorError(f"a frame that ends with {frame[-2:].hex()}")
    watts = volts * model.volts * amperes * model.amperes
    # far wider than any rounding error, to detect noise on the line
    if abs(watts - milliwatts * 1e-3) > 0.1 + 0.1 * watts:
        raise SensorError(f"{watts:g} W by volts and amperes, and {milliwatts * 1e-3:g} W told")
    return model, watts


class UmMeter(Sensor):
    """Meter that is read by a thread of its own, so that a reading never waits.

    Parameters
    ----------
    address : str
        Serial port, for example ``/dev/rfcomm0``; see `edge_vpr.live.links.open_link`.

    Raises
    ------
    SensorError
        If the port cannot be opened, or no reading arrives within seconds.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        try:
            # Bluetooth has no baud rate; a wired line of these meters has this one
            self._link: Link = open_link(address, baud=9_600)
        except LinkError as error:
            raise SensorError(f"power meter: {error}") from error
        self._buffer = b""
        self._fault = "no byte"
        self._latest: tuple[float, float] | None = None
        self._lost = ""
        self._model: Model | None = None
        self._stop, self._first = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        self._first.wait(_PATIENCE_S)
        if self._model is None:
            self.close()
            raise SensorError(
                f"{address} gives no reading of a UM24C, UM25C or UM34C "
                f"({self._lost or self._fault}): check that it is this port, and that no other "
                "program has it"
            )
        self.about = About(
            name=f"{self._model.name}@{address}",
            kind="power",
            scope="what the meter feeds",
            period_s=_PERIOD_S,
            resolution=5.0 * self._model.amperes,  # at 5 V
            gain_error=_GAIN_ERROR,
            detail=f"{_GAIN_ERROR:.0%} of gain error is an assumption: no primary source was found",
        )

    def read(self) -> float:
        """Return the watts of the latest reading."""
        return self.sample()[1]

    def sample(self) -> tuple[float, float]:
        """See `Sensor.sample`: the time is halfway between request and answer."""
        latest = self._latest
        assert latest is not None
        if self._lost:
            raise SensorError(f"{self._lost}: is the power meter still plugged in?")
        silent = time.monotonic() - latest[0]
        if silent > _PATIENCE_S:
            raise SensorError(
                f"{self._address} gave no whole reading for {silent:.1f} s (last: {self._fault}): "
                "bring the meter nearer, or check its cable"
            )
        return latest

    def close(self) -> None:
        """Stop reading, and close the port."""
        self._stop.set()
        self._thread.join(2 * _PATIENCE_S)
        self._link.close()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._link.read(0.0)  # a late answer must not be taken for that to the next request
                asked = time.monotonic()
                self._link.write(_ASK, 1.0)
                self._take_answer(asked)
                self._stop.wait(max(0.0, asked + _PERIOD_S - time.monotonic()))
        except LinkError as error:
            self._lost = str(error)
            self._first.set()

    def _take_answer(self, asked: float) -> None:
        self._buffer = b""
        while (left := asked + _ANSWER_S - time.monotonic()) > 0 and not self._stop.is_set():
            self._buffer = from_head(self._buffer + self._link.read(left))
            if len(self._buffer) < FRAME_BYTES:
                continue
            try:
                self._model, watts = decode(self._buffer[:FRAME_BYTES])
                now = time.monotonic()
                self._latest = ((asked + now) / 2, plausible(watts, self._address))
                self._first.set()
                return  # noqa: TRY300
            except SensorError as error:
                self._fault, self._buffer = str(error), self._buffer[1:]
        if self._buffer:
            self._fault = f"{len(self._buffer)} bytes of {FRAME_BYTES}"


def from_head(data: bytes) -> bytes:
    """Remove bytes that cannot be the beginning of a frame."""
    for i in range(len(data)):
        if data[i : i + 2] in _HEADS or (
            i == len(data) - 1 and any(head[:1] == data[i:] for head in _HEADS)
        ):
            return data[i:]
    return b""
