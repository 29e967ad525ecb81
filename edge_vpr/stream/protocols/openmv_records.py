"""Contents of the channels of an OpenMV camera with a GENX320: consecutive records of one size."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.evt import Decoder as WordsDecoder
from edge_vpr.stream.health import Health
from edge_vpr.stream.protocols.evt import ENCODERS
from edge_vpr.stream.timestamp_filter import Clock

Raw = npt.NDArray[np.uint8]

#: The seconds of the channel `events` have 16 bits, so that its clock wraps after 18.2 hours.
PERIOD_US = 65_536 * 1_000_000


class Records(ABC):
    """Decodes the records of one channel.

    Attributes
    ----------
    name : str
        One of `FORMATS`.
    size : int
        Bytes of one record.
    most : int
        Largest number of events in one record.
    clock : Clock
    """

    name: str
    size: int
    most: int
    clock: Clock

    @abstractmethod
    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """Decode the whole records of one reply or a part of it."""

    def lose(self) -> None:  # noqa: B027, not every kind remembers anything
        """Handle the loss of records before the next ones."""


class EventRecords(Records):
    """Decodes ``events``: type, seconds, milliseconds, microseconds, column, row, as u16.

    Type 0 is OFF, 1 is ON; 2 to 5 are edges of the trigger inputs, which are not events.
    """

    name, size, most = "events", 12, 1
    clock = Clock(confirm=1)

    def __init__(self) -> None:
        # last time on the device's clock, the same time without wraps, and number of wraps
        self._state = np.array([-1, 0, 0], dtype=np.int64)

    @property
    def wraps(self) -> int:
        """Number of wraps of the clock."""
        return int(self._state[2])

    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """See `Records.decode`; an invalid record is counted as undated."""
        rows = raw.view("<u2").reshape(-1, 6)
        t = np.empty(len(rows), dtype=np.int64)
        x, y = np.empty(len(rows), dtype=np.uint16), np.empty(len(rows), dtype=np.uint16)
        p = np.empty(len(rows), dtype=np.bool_)
        n, odd = _events(rows, t, x, y, p, self._state)
        health.reject_undated(odd)
        return Columns(t[:n], x[:n], y[:n], p[:n])


@kernel
def _events(rows, t, x, y, p, state):  # type: ignore[no-untyped-def]
    half = PERIOD_US // 2
    last, now = state[0], state[1]
    n = odd = 0
    for i in range(rows.shape[0]):
        kind = rows[i, 0]
        if kind > 5 or rows[i, 2] > 999 or rows[i, 3] > 999:
            odd += 1
            continue
        if kind > 1:
            continue
        time = np.int64(rows[i, 1]) * 1_000_000 + np.int64(rows[i, 2]) * 1_000 + rows[i, 3]
        if last < 0:
            last = now = time
        step = time - last
        if step < -half:
            step += PERIOD_US
            state[2] += 1
        elif step >= half:
            step -= PERIOD_US
            state[2] -= 1
        now += step
        last = time
        t[n], x[n], y[n], p[n] = now, rows[i, 4], rows[i, 5], kind == 1
        n += 1
    state[0], state[1] = last, now
    return n, odd


class EvtRecords(Records):
    """Decodes ``raw_events`` as Prophesee words, whose state is kept between replies."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._words = words = WordsDecoder(name, 1)
        self.size, self.most = words.dtype.itemsize, words.per_word
        # a checksum protects each word
        self.clock = Clock(words.clock_bits, confirm=1)

    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """See `Records.decode`."""
        columns = self._words.decode(raw.view(self._words.dtype))
        health.reject_undated(self._words.take_undated())
        # the decoder's columns are valid until its next call, but a reply may come in two parts
        return Columns(*(np.array(column) for column in columns))

    def lose(self) -> None:
        """See `Records.lose`; time and place of the missing words are not known."""
        self._words = WordsDecoder(self.name, 1)


class AerRecords(Records):
    """Decodes ``raw_events`` as 19 bits in three bytes, without a time of their own."""

    name, size, most = "aer", 3, 1
    clock = Clock(confirm=1)

    def decode(self, raw: Raw, health: Health, host_us: int) -> Columns:
        """See `Records.decode`."""
        low, middle, high = raw.reshape(-1, 3).T.astype(np.uint16)
        y = low | (middle & 1) << 8
        x = middle >> 1 | (high & 3) << 7
        return Columns(np.full(y.size, host_us, dtype=np.int64), x, y, high & 4 != 0)


FORMATS = ("events", "evt2", "evt21", "evt3", "aer")


def open_records(records_format: str) -> Records:
    """Make a decoder of one of `FORMATS`."""
    if records_format == "events":
        return EventRecords()
    return AerRecords() if records_format == "aer" else EvtRecords(records_format)


def open_maker(records_format: str, sensor: Sensor) -> Callable[[Events], bytes]:
    """Make an encoder of one of `FORMATS`."""
    if records_format == "events":
        return _event_rows
    if records_format == "aer":
        return _aer_bytes
    return ENCODERS[records_format](sensor).encode


def _event_rows(events: Events) -> bytes:
    t = events["t"] % PERIOD_US
    rows = np.empty((events.size, 6), dtype="<u2")
    rows[:, 0], rows[:, 1], rows[:, 2] = events["p"], t // 1_000_000, t // 1_000 % 1_000
    rows[:, 3], rows[:, 4], rows[:, 5] = t % 1_000, events["x"], events["y"]
    return rows.tobytes()


def _aer_bytes(events: Events) -> bytes:
    word = events["y"].astype(np.uint32) | events["x"].astype(np.uint32) << 9
    word |= events["p"].astype(np.uint32) << 18
    return word.astype("<u4").view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
