"""Common parts of all protocols: counts of losses, checks of decoded events, the interface.

One registry is behind all of them: ``open_decoder("edvs:format=E3", sensor)``.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import SharedState, kernel
from edge_vpr.errors import UsageError
from edge_vpr.events import EVENT_DTYPE, Events, Sensor, join_events
from edge_vpr.plugins import Registry
from edge_vpr.recordings.reading import Columns
from edge_vpr.warm_up import synthetic_events

__all__ = [
    "PROTOCOLS",
    "Clock",
    "Decoder",
    "Encoder",
    "Health",
    "OptionReader",
    "damaged_sample",
    "open_decoder",
    "open_encoder",
    "parse_protocol",
    "protocol_names",
]

# Health: counts of delivered and lost bytes and events of a stream.


#: How exactly a protocol can know the number of lost events.
EXACT, BOUND, UNKNOWN = "exact", "bound", "unknown"
# counts that are no faults, or are included in other counts
_NO_FAULTS = {"accounting", "bytes", "decoded_bytes", "pending_bytes", "frames", "decoded"}
_NO_FAULTS |= {"events", "held", "wraps", "lag_us", "longest_lag_us", "silent_s", "cut_off"}


@dataclass
class Health:
    """Counts since the stream began. Two sums hold at any time, whatever the line does.

    - ``bytes = decoded_bytes + skipped_bytes + pending_bytes``: all bytes are accounted for
    - ``decoded = events + rejected + held``: all decoded events are accounted for

    and a third one between the device and the host, as far as the protocol allows (`accounting`):
    ``made by the device = decoded + lost + device_dropped``.
    """

    #: {"exact", "bound", "unknown"}: whether `lost` is the number of events that were sent and
    #: never decoded; a bound, such that the number lies between `lost` and `lost_at_most`; or only
    #: the losses that happened to be noticed.
    accounting: str = UNKNOWN
    bytes: int = 0  #: Received.
    #: Part of whole, undamaged events or frames (or of words that say something else).
    decoded_bytes: int = 0
    skipped_bytes: int = 0  #: Damaged, or not of this protocol.
    pending_bytes: int = 0  #: Beginnings whose end has not arrived.
    frames: int = 0  #: Undamaged frames, where the protocol has frames.
    repeats: int = 0  #: Undamaged frames that came a second time, and were left out.
    resyncs: int = 0  #: How often the decoder had to look for the next event or frame.
    crc_errors: int = 0  #: Frames dropped because a checksum or their length was wrong.
    sequence_gaps: int = 0  #: How often a sequence number showed that something is missing.
    decoded: int = 0  #: Events taken out of the bytes.
    events: int = 0  #: Events delivered.
    held: int = 0  #: Events whose odd time awaits what comes after them.
    #: late, leaps, off_sensor, undated: events rejected: a little earlier than one before them;
    #: with a time far off, which those after them did not confirm; at a pixel that does not exist;
    #: before the first time word.
    late: int = 0
    leaps: int = 0
    off_sensor: int = 0
    undated: int = 0
    lost: int = 0  #: Events sent and never decoded, as far as known.
    lost_at_most: int = 0  #: Upper bound of these, where `accounting` is a bound.
    device_dropped: int = 0  #: Events that the device says it had to drop.
    #: Restarts of the device; what it lost between its last frame and the restart is unknown.
    device_resets: int = 0
    #: overruns, overrun_bytes: how often, and how many bytes, the host dropped because it fell
    #: behind.
    overruns: int = 0
    overrun_bytes: int = 0
    #: Characters with a wrong frame or parity, or dropped by the serial port or its driver, as far
    #: as the system counts them.
    line_errors: int = 0
    wraps: int = 0  #: Wraps of the device's clock.
    #: How often the clock restarted, which keeps the order of events but not their distance.
    clock_resets: int = 0
    #: Steps of the clock over so many ticks that one match was given for all of them.
    clock_jumps: int = 0
    reopened: int = 0  #: How often the link was disconnected and opened again.
    stalls: int = 0  #: Silences of more than a second after the first byte.
    retries: int = 0  #: How often an answer of the device did not come, so that it was asked again.
    odometer_leaps: int = 0  #: Leaps of the odometer that are too fast for a robot.
    odometer_unused: int = 0  #: Readings of an odometer that could not be right, left out.
    misfits: int = 0  #: Matches in another place or light than the map's, by their misfit.
    #: lag_us, longest_lag_us: how much later than the quickest events the newest ones were matched,
    #: and the latest ones, by the clocks of camera and host. It includes bytes that waited in the
    #: system for a host that was busy.
    lag_us: int = 0
    longest_lag_us: int = 0
    silent_s: float = 0.0  #: Seconds since the newest bytes.
    #: Whether the link is disconnected and has not returned, such as that of a camera which has
    #: come back under another name. What is sent meanwhile is in no count.
    cut_off: bool = False

    @property
    def rejected(self) -> int:
        """Events that were decoded and not delivered."""
        return self.late + self.leaps + self.off_sensor + self.undated

    @property
    def losses(self) -> int:
        """Number that grows whenever a loss becomes known; a window with a loss is incomplete."""
        return (
            self.resyncs
            + self.crc_errors
            + self.sequence_gaps
            + self.late
            + self.leaps
            + self.off_sensor
            + self.undated
            + self.device_dropped
            + self.device_resets
            + self.overruns
            + self.line_errors
            + self.clock_resets
            + self.clock_jumps
            + self.reopened
            + self.retries
        )

    def reject_undated(self, n: int) -> None:
        """Count `n` decoded events that have no time."""
        self.undated += n
        self.decoded += n

    def balanced(self) -> bool:
        """Return whether both sums hold."""
        return (
            self.bytes == self.decoded_bytes + self.skipped_bytes + self.pending_bytes
            and self.decoded == self.events + self.rejected + self.held
        )

    def __str__(self) -> str:
        """Return every fault that occurred, with its count."""
        parts = []
        for field in fields(self):
            count = getattr(self, field.name)
            if field.name in _NO_FAULTS or not count:
                continue
            if field.name == "lost_at_most" and count == self.lost:
                continue
            name = field.name.replace("_", " ").replace("crc", "CRC")
            if count == 1:
                name = "retry" if name == "retries" else name.removesuffix("s")
            parts.append(f"{count:,} {name}")
        return ", ".join(parts) or "no faults"

    def describe_losses(self) -> str:
        """Return the number of lost events as text, and how exactly it is known."""
        until = "; what was sent after the link was lost is not known" if self.cut_off else ""
        return self._known_losses() + until

    def _known_losses(self) -> str:
        dropped = f", {self.device_dropped:,} dropped by the device" if self.device_dropped else ""
        restarts = "at least " if self.device_resets or self.cut_off else ""
        whole = self.frames if self.accounting == EXACT else self.decoded_bytes
        if self.accounting in (EXACT, BOUND) and not whole and self.skipped_bytes:
            return "no frame came whole, so that nothing is known of the events lost"
        if self.accounting == EXACT:
            return f"{restarts}{self.lost:,} events lost on the way{dropped}"
        if self.accounting == BOUND:
            most = f" to {self.lost_at_most:,}" if self.lost_at_most > self.lost else ""
            return (
                f"{self.lost:,}{most} events lost on the way; what the device dropped before is "
                "unknown to this protocol"
            )
        return (
            f"{self.skipped_bytes + self.overrun_bytes:,} bytes lost or unreadable; events lost "
            "before they arrived are unknown to this protocol"
        )


# Filter of decoded events: on the sensor, in time order, on a clock that never wraps.
#
# Most protocols of cameras have no checksum, so that a time may be wrong, and a camera may restart
# while the rover drives. An unusual step of time is therefore accepted only when the events after
# it agree. Until then these are held, and dropped if they do not agree.


#: A step forward of up to this is accepted at once.
STEP_US = 1_000_000
#: A longer step of up to this is accepted once confirmed; beyond it, the clock has restarted.
SILENCE_US = 60_000_000
#: The same for times with a checksum; limited because each tick of a silence gives a match.
VOUCHED_SILENCE_US = 600_000_000
#: On a clock that wraps, an event up to this much earlier than the newest is late; else it is
#: later.
LATE_US = 100_000
#: On a live line the clock may be ahead of the host's by this much; steps of more than a
#: millisecond that would bring it further ahead are refused. The right time after a damaged one can
#: look like a wrap, so that a damaged line would make the clock run many times too fast.
AHEAD_US, SURE_STEP_US = 500_000, 1_000
#: Number of successive events that must agree to confirm a step.
CONFIRM = 8

# State from chunk to chunk, with times in ticks of the device.
_STATE = np.dtype(
    [
        ("dated", "<i8"),  # whether a time is known
        ("last", "<i8"),  # newest time of the device
        ("now", "<i8"),  # the same without wraps, from time 0 on
        ("held", "<i8"),  # number of events in `_FilterState.held`
        ("allowed", "<i8"),  # time by which the host's clock allows this one to advance
        ("heard_us", "<i8"),  # newest time of the host; -1: not held against it
        # counts, see `Health`
        ("off_sensor", "<i8"),
        ("late", "<i8"),
        ("leaps", "<i8"),
        ("wraps", "<i8"),
        ("clock_resets", "<i8"),
    ]
)


#: What of it another run goes on from.
_KEPT = ("dated", "last", "now")
#: A clock that has gone on is expected so much before the host's clock says.
EARLY_US = 200_000


class _FilterState(NamedTuple):
    """State of the kernel, held events, and limits, with times in ticks."""

    state: npt.NDArray[np.void]
    held: Events
    width: int
    height: int
    period: int
    late: int
    sure: int
    step_limit: int
    silence: int
    tick: int
    confirm: int


@dataclass(frozen=True)
class Clock:
    """Description of a device's clock."""

    bits: int = 0  #: It wraps after ``2**bits`` ticks; 0: it never does.
    tick_us: int = 1  #: Microseconds a tick.
    confirm: int = CONFIRM  #: Events that confirm an odd step; 1 where a checksum vouches for each.


class TimestampFilter:
    """Converts decoded columns to event arrays from time 0 on, and counts rejected events.

    Parameters
    ----------
    health : Health
        Where the counts go.

    Attributes
    ----------
    shared : SharedState
        State for kernels, after which `report` is to be called.
    """

    def __init__(self, sensor: Sensor, clock: Clock, health: Health) -> None:
        self.health = health
        # in ticks, so that a wrap is a bit mask
        self._tick = tick = clock.tick_us
        period, late = 0, max(1, LATE_US // tick)
        step_limit = max(1, STEP_US // tick)
        sure = max(1, SURE_STEP_US // tick)
        if clock.bits:
            # late only by a small part of the period, else a silence would look like a late event
            period = 1 << clock.bits
            late = min(late, period // 64)
        self._period = period
        silence = VOUCHED_SILENCE_US if clock.confirm == 1 else SILENCE_US
        self.longest_silence_us = silence
        self._state = np.zeros(1, dtype=_STATE)
        self._state["allowed"], self._state["heard_us"] = 1 << 62, -1
        self._held = np.empty(max(1, clock.confirm), dtype=EVENT_DTYPE)
        self.shared = SharedState(
            _FilterState(
                self._state, self._held, sensor.width, sensor.height, period, late,
                sure, step_limit, max(1, silence // tick), tick, clock.confirm,
            )
        )  # fmt: skip

    @property
    def reached_us(self) -> int:
        """Time of the newest event or of a later `reach`; no following event is earlier."""
        return int(self._state["now"].item()) * self._tick

    def hold_to(self, host_us: int) -> None:
        """Let the clock advance up to this time of the host; vouched times do so by themselves."""
        state = self._state[0]
        if self._held.size == 1:
            return
        allowed_us = AHEAD_US
        if state["heard_us"] >= 0:
            passed_us = max(0, host_us - int(state["heard_us"]))
            allowed_us = min(int(state["allowed"]) * self._tick + passed_us, SILENCE_US)
        state["allowed"], state["heard_us"] = allowed_us // self._tick, host_us

    def admit(self, columns: Columns) -> Events:
        """Filter decoded events, in the order of the stream.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            Those that are good, and those held before that have been confirmed.
        """
        t, x, y, p = columns
        out = np.empty(t.size + self._held.size, dtype=EVENT_DTYPE)
        n = admit_columns(self.shared.kernel_state, t, x, y, p, out)
        self.report(t.size, n)
        return out[:n]

    def to_values(self) -> dict[str, int]:
        """Return the values that `resume` needs, of JSON."""
        return {name: int(self._state[name][0]) for name in _KEPT}

    def resume(self, values: dict[str, int], passed_us: int) -> None:
        """Go on from the values of `to_values`, as much later as the host's clock says.

        A clock that has gone on is exact all the same; any other begins at about the right time.
        """
        passed = max(0, passed_us - EARLY_US) // self._tick
        self._state["dated"] = values["dated"]
        self._state["last"], self._state["now"] = values["last"] + passed, values["now"] + passed

    def take_over_from(self, other: TimestampFilter) -> None:
        """Continue after `other`, which had another clock, in order of time."""
        other.finish()
        self._state[:] = other._state
        state = self._state[0]
        state["clock_resets"] += state["dated"]
        state["now"] += state["dated"]
        state["dated"] = 0
        self.report(0, 0)

    def finish(self) -> None:
        """End the stream; events that are still held were not confirmed and are dropped."""
        state = self._state[0]
        state["leaps"] += state["held"]
        state["held"] = 0
        self.report(0, 0)

    def report(self, decoded: int, delivered: int) -> None:
        """Add the events of a chunk, and the counts of the kernel, to the health."""
        health = self.health
        _, _, _, held, _, _, off_sensor, late, leaps, wraps, clock_resets = self._state.item()
        health.decoded += decoded
        health.events += delivered
        health.held, health.off_sensor, health.late, health.leaps = held, off_sensor, late, leaps
        health.clock_resets = clock_resets
        if self._period:  # else the decoder has continued the clock, and counts its wraps
            health.wraps = wraps


@kernel
def _step(earlier, later, period, late):  # type: ignore[no-untyped-def]
    """Return the time between two events; on a clock that wraps, forward or slightly late."""
    step = later - earlier
    return ((step + late) & (period - 1)) - late if period else step


@kernel
def _drop(state, last, first, held, period, late):  # type: ignore[no-untyped-def]
    """Count dropped events that were held: as late if the first is slightly late, else as leaps."""
    if -late <= _step(last, first, period, late) < 0:
        state["late"] += held
    else:
        state["leaps"] += held


@kernel
def _wrapped(earlier, later, period):  # type: ignore[no-untyped-def]
    return period > 0 and (later & (period - 1)) < (earlier & (period - 1))


@kernel
def start_clock(kernel_state, time):  # type: ignore[no-untyped-def]
    """Set time 0 to the device's `time`, unless there were events before."""
    s = _FilterState(*kernel_state.value).state[0]
    if not s["dated"]:
        s["dated"], s["last"] = 1, time


@kernel
def reach(kernel_state, time):  # type: ignore[no-untyped-def]
    """Advance the clock to the device's `time` without an event."""
    kept = _FilterState(*kernel_state.value)
    s = kept.state[0]
    if s["dated"] and not kept.period and 0 < time - s["last"] <= kept.silence:
        s["now"] += time - s["last"]
        s["last"] = time


@kernel
def empty_events(kernel_state, n):  # type: ignore[no-untyped-def]
    """Return an array for `n` events and those that are held."""
    return np.empty(n + _FilterState(*kernel_state.value).held.size, EVENT_DTYPE)


@kernel
def admit_columns(kernel_state, t, x, y, p, out):  # type: ignore[no-untyped-def]
    """Do the work of `TimestampFilter.admit`; return how many events are in `out`."""
    state, held, width, height, period, late, sure, step_limit, silence, tick, confirm = (
        kernel_state.value
    )
    s = state[0]
    dated, last, now, n_held = s["dated"], s["last"], s["now"], s["held"]
    allowed = s["allowed"]
    n = 0
    for i in range(t.size):
        if x[i] >= width or y[i] >= height:
            s["off_sensor"] += 1
            continue
        time = np.int64(t[i])
        if not dated:
            dated, last = 1, time
        step = _step(last, time, period, late)
        if 0 <= step <= step_limit and (step <= sure or step <= allowed):
            if n_held:  # a good event after held ones: their times were wrong
                _drop(s, last, held[0]["t"], n_held, period, late)
                n_held = 0
            s["wraps"] += _wrapped(last, time, period)
            now += step
            allowed -= step
            last = time
        else:
            if n_held:
                follows = _step(held[n_held - 1]["t"], time, period, late)
                if not 0 <= follows <= step_limit:
                    _drop(s, last, held[0]["t"], n_held, period, late)
                    n_held = 0
            held[n_held]["t"], held[n_held]["x"], held[n_held]["y"] = time, x[i], y[i]
            held[n_held]["p"] = p[i] != 0
            n_held += 1
            if n_held == confirm:
                first = held[0]["t"]
                step = _step(last, first, period, late)
                if 0 <= step <= silence and step <= allowed:
                    s["wraps"] += _wrapped(last, first, period)
                    now += step
                    allowed -= step
                else:
                    s["clock_resets"] += 1
                    now += 1
                last = first
                for k in range(n_held):
                    step = _step(last, held[k]["t"], period, late)
                    if step <= sure or step <= allowed:
                        now += step
                        allowed -= step
                    last = held[k]["t"]
                    out[n]["t"], out[n]["x"], out[n]["y"] = now * tick, held[k]["x"], held[k]["y"]
                    out[n]["p"] = held[k]["p"]
                    n += 1
                n_held = 0
            continue
        out[n]["t"], out[n]["x"], out[n]["y"], out[n]["p"] = now * tick, x[i], y[i], p[i] != 0
        n += 1
    s["dated"], s["last"], s["now"], s["held"] = dated, last, now, n_held
    s["allowed"] = max(-silence, allowed)
    return n


# Interface of protocols: decoders from pieces of bytes of any size to events, and encoders.


class Decoder:
    """Decodes the bytes of one stream as they arrive.

    Parameters
    ----------
    accounting : {"exact", "bound", "unknown"}
        How well the number of events that never arrived is known.

    Attributes
    ----------
    resync_bytes : int
        Number of undamaged bytes after a fault that suffice to find the next event.
    baud : int
        Rate of a serial port, unless the user gives one.
    tick_s : float
        Seconds after which `to_send` is to be called again while no bytes arrive.
    remark : str
        Current message for the user, if any.
    """

    resync_bytes: int = 0
    baud: int = 115_200
    tick_s: float = 0.1
    remark: str = ""

    def __init__(self, sensor: Sensor, clock: Clock, accounting: str = UNKNOWN) -> None:
        self.sensor = sensor
        self.health = Health(accounting)
        self._pending = b""
        self._host_us = 0
        #: Whether the bytes come as they are sent, so that the clock cannot be ahead of the host's.
        self.live = False
        self._timestamps = TimestampFilter(sensor, clock, self.health)

    def adopt(self, health: Health) -> None:
        """Count in the `health` of another decoder from now on."""
        self.health = self._timestamps.health = health

    @property
    def reached_us(self) -> int:
        """Time up to which the stream is known: no later event is earlier than this."""
        return self._timestamps.reached_us

    @property
    def longest_silence_us(self) -> int:
        """Step of the clock that is still one, and no restart."""
        return self._timestamps.longest_silence_us

    def clock_values(self) -> dict[str, int]:
        """Return the state of the clock, of JSON."""
        return self._timestamps.to_values()

    def resume_clock(self, values: dict[str, int], passed_us: int) -> None:
        """Go on from the clock of another decoder; see `TimestampFilter.resume`."""
        self._timestamps.resume(values, passed_us)

    def warm_up(self) -> None:
        """Compile the kernels for decoding before the first bytes arrive, which can take seconds.

        Neither the decoder's state nor its health changes.
        """
        for sample in self._samples():
            scratch = copy.deepcopy(self)
            scratch.feed(sample)
            scratch.gap(1)
            scratch.finish()

    def _samples(self) -> Iterable[bytes]:
        """Return streams that together use all of this decoder's kernels."""
        return ()

    def setup(self) -> bytes:
        """Return the commands to send when the link opens."""
        return b""

    def greeting(self) -> bytes:
        """Return what to send again and again while nothing comes.

        A device that starts, or restarts, after the link was opened has not seen `setup`.
        """
        return self.setup()

    def teardown(self) -> bytes:
        """Return the commands to send before the link closes."""
        return b""

    def to_send(self, now_s: float) -> bytes:
        """Return the bytes to send to the device now; called after each chunk, and during silence.

        Parameters
        ----------
        now_s : float
            Time on a clock that never goes back.
        """
        return b""

    def feed(self, data: bytes, host_us: int = 0) -> Events:
        """Decode the next bytes.

        Parameters
        ----------
        data : bytes
            Of any number.
        host_us : int
            Arrival time on the host's clock; also the time of events that have none themselves.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            In time order, on the sensor, and not earlier than those returned before; n may be 0.
        """
        self._host_us = host_us
        if self.live:
            self._timestamps.hold_to(host_us)
        self.health.bytes += len(data)
        return self._take(self._pending + data if self._pending else data, final=False)

    def gap(self, dropped_bytes: int = 0) -> Events:
        """Handle missing bytes before the next ones: an overrun, or a link that was disconnected.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            Whole events that were waiting for bytes that will not come.
        """
        events = self._take(self._pending, final=True)
        self.health.skipped_bytes += len(self._pending)
        self._pending = b""
        self.health.pending_bytes = 0
        if dropped_bytes:
            self.health.overruns += 1
            self.health.overrun_bytes += dropped_bytes
        self._lose_sync()
        return events

    def finish(self) -> Events:
        """End the stream.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            Whole events that were waiting for bytes that will not come.
        """
        events = self._take(self._pending, final=True)
        self._timestamps.finish()
        return events

    def _take(self, data: bytes, *, final: bool) -> Events:
        before = self.health.skipped_bytes
        events, rest = self._decode_events(data, final=final)
        self._account_bytes(data, rest, before)
        return join_events(events)

    def _account_bytes(self, data: bytes, rest: bytes, skipped_before: int) -> None:
        """Keep the `rest` of the bytes, and count those before it as decoded or skipped."""
        health = self.health
        self._pending, health.pending_bytes = rest, len(rest)
        skipped = health.skipped_bytes - skipped_before
        health.decoded_bytes += len(data) - len(rest) - skipped

    def _decode_events(self, data: bytes, *, final: bool) -> tuple[list[Events], bytes]:
        """Decode as `_decode` does, and filter the events."""
        parts, rest = self._decode(data, final=final)
        return [self._timestamps.admit(part) for part in parts], rest

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        """Decode as much as possible; return the events and the bytes to decode again later.

        All other bytes are counted in ``health.skipped_bytes``. With `final`, no bytes follow.
        """
        raise NotImplementedError

    def _lose_sync(self) -> None:
        """Search for the beginning of the next event."""


class Encoder(ABC):
    """Encodes events as the bytes of a device; for tests, bridges and firmware authors.

    Attributes
    ----------
    host_needs_options : bool
        Whether the bytes do not show the options of the protocol, so that a host is given them too.
    waits_for_host : bool
        Whether the device is silent until the host has sent something.
    held, capacity : int
        Number of events that wait for the host, and its limit; a device drops further events.
    """

    host_needs_options: bool = False
    waits_for_host: bool = False
    held: int = 0
    capacity: int = 0

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    def start(self) -> bytes:
        """Return the bytes that begin a stream."""
        return b""

    @abstractmethod
    def encode(self, events: Events) -> bytes:
        """Encode events, which are in time order and not earlier than those before."""

    def idle(self, now_us: int) -> bytes:
        """Return bytes that report a silence until `now_us`, if the protocol has such."""
        return b""

    def respond(self, command: bytes) -> bytes:
        """Return the answer to bytes that the host sent."""
        return b""

    def to_send(self, now_s: float) -> bytes:
        """Return the bytes to send now without a request; called repeatedly."""
        return b""


def damaged_sample(encoder: Encoder) -> bytes:
    """Encode the synthetic events, without a byte in the middle."""
    words = encoder.encode(synthetic_events())
    return words[: len(words) // 2] + words[len(words) // 2 + 1 :]


class OptionReader:
    """Reads the options of a protocol, each once; options that remain are errors."""

    def __init__(self, protocol: str, options: dict[str, str]) -> None:
        self._protocol, self._left = protocol, options
        self._known: list[str] = []

    def choice(self, name: str, allowed: tuple[str, ...]) -> str:
        """Read one of `allowed`; the first one if the option is absent."""
        self._known.append(name)
        value = self._left.pop(name, allowed[0])
        if value not in allowed:
            raise UsageError(
                f"{self._protocol}: {name}={value}: expected one of {', '.join(allowed)}"
            )
        return value

    def text(self, name: str) -> str | None:
        """Read any text; None if the option is absent."""
        self._known.append(name)
        return self._left.pop(name, None)

    def integer(self, name: str, default: int, low: int, high: int) -> int:
        """Read a whole number from `low` to `high`."""
        value = self.text(name)
        if value is None:
            return default
        if not value.isdigit() or not low <= int(value) <= high:
            raise UsageError(f"{self._protocol}: {name}={value}: expected {low} to {high}")
        return int(value)

    def done(self) -> None:
        """Raise UsageError for options that were not read."""
        if self._left:
            known = ", ".join(self._known) or "none"
            raise UsageError(
                f"{self._protocol} has no option {', '.join(self._left)}: it has {known}"
            )


# Protocols by name: built-in ones, and those that other packages register.


#: An entry point of this group names a module with ``open_decoder(name, sensor, options)`` and
#: ``open_encoder(name, sensor, options)``; both functions take an `OptionReader`.
GROUP = "edge_vpr.protocols"

#: The protocols of this package, by the name that ``--protocol`` takes, and their modules.
PROTOCOLS: dict[str, str] = {
    "evpr": "edge_vpr.live.protocols.evpr",  # this project's frames: numbers, drop counts, CRC-32
    "edvs": "edge_vpr.live.protocols.edvs",  # eDVS E0 to E4
    "evt2": "edge_vpr.live.protocols.evt",  # raw Prophesee words
    "evt21": "edge_vpr.live.protocols.evt",
    "evt3": "edge_vpr.live.protocols.evt",
    "openmv": "edge_vpr.live.protocols.openmv",  # OpenMV protocol v2
    "aer": "edge_vpr.live.protocols.aer",  # address-event words, described by a TOML layout
}
_REGISTRY = Registry(GROUP, PROTOCOLS)


def parse_protocol(text: str) -> tuple[str, dict[str, str]]:
    """Split text such as ``edvs`` or ``edvs:format=E3,sync=1`` into a name and options."""
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
    return _REGISTRY.names()


def open_decoder(protocol: str, sensor: Sensor) -> Decoder:
    """Make the decoder of a protocol.

    Parameters
    ----------
    protocol : str
        Name, with options after a colon: ``edvs:format=E3,sync=1``.
    """
    decoder: Decoder = _open("open_decoder", protocol, sensor)
    return decoder


def open_encoder(protocol: str, sensor: Sensor) -> Encoder:
    """Make the encoder of a protocol; see `open_decoder`."""
    encoder: Encoder = _open("open_encoder", protocol, sensor)
    return encoder


def _open(function: str, protocol: str, sensor: Sensor) -> Any:
    name, options = parse_protocol(protocol)
    module = _REGISTRY.load(name)
    if module is None:
        raise UsageError(
            f"protocol {name!r} is unknown: choose one of {', '.join(protocol_names())}"
        )
    reader = OptionReader(name, options)
    opened = getattr(module, function)(name, sensor, reader)
    reader.done()
    return opened
