"""Health of a stream: counts of what it delivered and lost, and the filter of decoded events."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import KernelState, kernel
from edge_vpr.events import EVENT_DTYPE, Events, Sensor
from edge_vpr.recordings.reading import Columns

#: How exactly a protocol can know the number of lost events.
EXACT, BOUND, UNKNOWN = "exact", "bound", "unknown"
# counts that are no faults, or are included in other counts
_NO_FAULTS = {"accounting", "bytes", "decoded_bytes", "pending_bytes", "frames", "decoded"}
_NO_FAULTS |= {"events", "held", "wraps", "lag_us", "longest_lag_us"}


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
    #: what showed by chance.
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
    #: How often the clock started anew, which keeps the order of events but not their distance.
    clock_resets: int = 0
    #: Steps of the clock over so many ticks that one match was given for all of them.
    clock_jumps: int = 0
    reopened: int = 0  #: How often the link was lost and opened again.
    stalls: int = 0  #: Silences of more than a second.
    retries: int = 0  #: How often an answer of the device did not come, so that it was asked anew.
    #: lag_us, longest_lag_us: how much later than the quickest events the newest ones were matched,
    #: and the latest ones, by the clocks of camera and host. It includes bytes that waited in the
    #: system for a host that was busy.
    lag_us: int = 0
    longest_lag_us: int = 0

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
        dropped = f", {self.device_dropped:,} dropped by the device" if self.device_dropped else ""
        restarts = "at least " if self.device_resets else ""
        if self.accounting == EXACT and not self.frames and self.skipped_bytes:
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
#: Number of successive events that must agree to confirm a step.
CONFIRM = 8

# State from chunk to chunk, with times in ticks of the device.
_STATE = np.dtype(
    [
        ("dated", "<i8"),  # whether a time is known
        ("last", "<i8"),  # newest time of the device
        ("now", "<i8"),  # the same without wraps, from time 0 on
        ("held", "<i8"),  # number of events in `_Kept.held`
        # counts, see `Health`
        ("off_sensor", "<i8"),
        ("late", "<i8"),
        ("leaps", "<i8"),
        ("wraps", "<i8"),
        ("clock_resets", "<i8"),
    ]
)


class _Kept(NamedTuple):
    """State of the kernel, held events, and limits, with times in ticks."""

    state: npt.NDArray[np.void]
    held: Events
    width: int
    height: int
    period: int
    late: int
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
    box : Box
        State for kernels, after which `report` is to be called.
    """

    def __init__(self, sensor: Sensor, clock: Clock, health: Health) -> None:
        self.health = health
        # in ticks, so that a wrap is a bit mask
        self._tick = clock.tick_us
        self._period = 1 << clock.bits if clock.bits else 0
        # events may be late only by a small part of the period, else a silence would look like one
        late = max(1, LATE_US // self._tick)
        self._late = min(late, self._period // 64) if clock.bits else late
        silence = VOUCHED_SILENCE_US if clock.confirm == 1 else SILENCE_US
        self._silence = max(1, silence // self._tick)
        self._state = np.zeros(1, dtype=_STATE)
        self._held = np.empty(max(1, clock.confirm), dtype=EVENT_DTYPE)
        self.box = KernelState(
            _Kept(
                self._state, self._held, sensor.width, sensor.height, self._period, self._late,
                max(1, STEP_US // self._tick), self._silence, self._tick, clock.confirm,
            )
        )  # fmt: skip

    @property
    def reached_us(self) -> int:
        """Time of the newest event or of a later `reach`; no following event is earlier."""
        return int(self._state["now"].item()) * self._tick

    def admit(self, columns: Columns) -> Events:
        """Filter decoded events, in the order of the stream.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            Those that are good, and those held before that have been confirmed.
        """
        t, x, y, p = columns
        out = np.empty(t.size + self._held.size, dtype=EVENT_DTYPE)
        n = admit_columns(self.box.boxed, t, x, y, p, out)
        self.report(t.size, n)
        return out[:n]

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
        _, _, _, held, off_sensor, late, leaps, wraps, clock_resets = self._state.item()
        health.decoded += decoded
        health.events += delivered
        health.held, health.off_sensor, health.late, health.leaps = held, off_sensor, late, leaps
        health.wraps, health.clock_resets = wraps, clock_resets


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
def start_clock(box, time):  # type: ignore[no-untyped-def]
    """Set time 0 to the device's `time`, unless there were events before."""
    s = _Kept(*box.value).state[0]
    if not s["dated"]:
        s["dated"], s["last"] = 1, time


@kernel
def reach(box, time):  # type: ignore[no-untyped-def]
    """Advance the clock to the device's `time`, unless that is -1, without an event.

    Returns the time from time 0 on, in microseconds.
    """
    kept = _Kept(*box.value)
    s = kept.state[0]
    known = s["dated"] and not kept.period and time >= 0
    if known and 0 < time - s["last"] <= kept.silence:
        s["now"] += time - s["last"]
        s["last"] = time
    return s["now"] * kept.tick


@kernel
def room_for(box, n):  # type: ignore[no-untyped-def]
    """Return an array for `n` events and those that are held."""
    return np.empty(n + _Kept(*box.value).held.size, EVENT_DTYPE)


@kernel
def counts_of(box):  # type: ignore[no-untyped-def]
    """Return the counts that `TimestampFilter.report` adds to the health."""
    s = _Kept(*box.value).state[0]
    return s["held"], s["off_sensor"], s["late"], s["leaps"], s["wraps"], s["clock_resets"]


@kernel
def admit_columns(box, t, x, y, p, out):  # type: ignore[no-untyped-def]
    """Do the work of `TimestampFilter.admit`; return how many events are in `out`."""
    state, held, width, height, period, late, step_limit, silence, tick, confirm = box.value
    s = state[0]
    dated, last, now, n_held = s["dated"], s["last"], s["now"], s["held"]
    n = 0
    for i in range(t.size):
        if x[i] >= width or y[i] >= height:
            s["off_sensor"] += 1
            continue
        time = np.int64(t[i])
        if not dated:
            dated, last = 1, time
        step = _step(last, time, period, late)
        if 0 <= step <= step_limit:
            if n_held:  # a good event after held ones: their times were wrong
                _drop(s, last, held[0]["t"], n_held, period, late)
                n_held = 0
            s["wraps"] += _wrapped(last, time, period)
            now += step
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
                if 0 <= step <= silence:
                    s["wraps"] += _wrapped(last, first, period)
                    now += step
                else:
                    s["clock_resets"] += 1
                    now += 1
                last = first
                for k in range(n_held):
                    now += _step(last, held[k]["t"], period, late)
                    last = held[k]["t"]
                    out[n]["t"], out[n]["x"], out[n]["y"] = now * tick, held[k]["x"], held[k]["y"]
                    out[n]["p"] = held[k]["p"]
                    n += 1
                n_held = 0
            continue
        out[n]["t"], out[n]["x"], out[n]["y"], out[n]["p"] = now * tick, x[i], y[i], p[i] != 0
        n += 1
    s["dated"], s["last"], s["now"], s["held"] = dated, last, now, n_held
    return n


def no_columns(n: int = 0) -> Columns:
    """Room for `n` events, as columns."""
    return Columns(
        np.empty(n, np.int64), np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.bool_)
    )
