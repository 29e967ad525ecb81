"""Filter of decoded events: on the sensor, in time order, on a clock that never wraps.

Most protocols of cameras have no checksum, so that a time may be wrong, and a camera may restart
while the rover drives. An unusual step of time is therefore accepted only when the events after it
agree. Until then these are held, and dropped if they do not agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel, shared_state
from edge_vpr.events import Columns, Events, Sensor, empty_events
from edge_vpr.live.protocols.health import Health
from edge_vpr.recordings.decoding import clock_step

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
#: What passed at a restart of a device that vouches for its times, where no clock of the host tells
#: it: long enough that the robot may be anywhere further on. Of others, damage may look the same.
UNKNOWN_US = 60_000_000
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
        ("passed", "<i8"),  # by the host's clock, since this one has last advanced
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
    held: tuple[npt.NDArray[Any], ...]
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
    vouched: bool = False  #: Whether a checksum protects times: one event confirms an odd step.


class TimestampFilter:
    """Converts decoded columns to events from time 0 on, and counts rejected ones.

    Parameters
    ----------
    health : Health
        Where the counts go.

    Attributes
    ----------
    kernel_state : KernelState
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
        silence = VOUCHED_SILENCE_US if clock.vouched else SILENCE_US
        self.longest_silence_us = silence
        self._state = np.zeros(1, dtype=_STATE)
        self._state["allowed"], self._state["heard_us"] = 1 << 62, -1
        self._state["passed"] = max(1, UNKNOWN_US // tick) if clock.vouched else 1
        # host's times of the newest bytes, and of those that last advanced this clock, to `_then`
        self._host_us: int | None = None
        self._advanced_us = self._then = 0
        self._vouched, self._held = clock.vouched, self._state["held"]
        confirm = 1 if clock.vouched else CONFIRM
        self.kernel_state = shared_state(
            _FilterState(
                self._state, empty_events(confirm).columns, sensor.width, sensor.height,
                period, late, sure, step_limit, max(1, silence // tick), tick, confirm,
            )
        )  # fmt: skip

    @property
    def reached_us(self) -> int:
        """Time of the newest event or of a later `reach`; no following event is earlier."""
        return int(self._state["now"].item()) * self._tick

    def hear(self, host_us: int) -> None:
        """Note when the next bytes came, by the host's clock.

        A restart among them lasted no longer than the time since this clock has last advanced.
        Device times up to the host's are accepted. Times protected by a checksum need no limit.
        """
        state = self._state[0]
        if self._host_us is None or state["now"] != self._then:
            self._advanced_us = host_us if self._host_us is None else self._host_us
        self._host_us, self._then = host_us, int(state["now"])
        state["passed"] = max(1, (host_us - self._advanced_us) // self._tick)
        if self._vouched:
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
        Events
            Those that are good, and those held before that have been confirmed.
        """
        decoded = columns.t.size
        if not Events(*columns).packed:  # of a decoder of another package
            columns = self._narrowed(columns)
        # all that can come out, which is what does unless there is a fault
        out = empty_events(columns.t.size + self._held.item())
        n = admit_columns(self.kernel_state, *columns, *out.columns)
        self.report(decoded, n)
        return out if n == out.size else out[:n]

    def _narrowed(self, columns: Columns) -> Columns:
        """Return columns of the types of `Events`; pixels beyond these are off the sensor."""
        inside = (columns.x >= 0) & (columns.x <= 0xFFFF) & (columns.y >= 0) & (columns.y <= 0xFFFF)
        self._state["off_sensor"] += np.count_nonzero(~inside)
        t, x, y, p = (column[inside] for column in columns)
        return Columns(t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p != 0)

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
        self._state["passed"] = 1  # more is not known of it

    def finish(self) -> None:
        """End the stream; events that are still held were not confirmed and are dropped."""
        state = self._state[0]
        state["leaps"] += state["held"]
        state["held"] = 0
        self.report(0, 0)

    def report(self, decoded: int, delivered: int) -> None:
        """Add the events of a chunk, and the counts of the kernel, to the health."""
        health = self.health
        _, _, _, held, _, _, _, off_sensor, late, leaps, wraps, clock_resets = self._state.item()
        health.decoded += decoded
        health.events += delivered
        health.held, health.off_sensor, health.late, health.leaps = held, off_sensor, late, leaps
        health.clock_resets = clock_resets
        if self._period:  # else the decoder has continued the clock, and counts its wraps
            health.wraps = wraps


_clock_step = kernel(inner=True)(clock_step)


@kernel(inner=True)
def _drop(state, last, first, held, period, late):  # type: ignore[no-untyped-def]
    """Count dropped events that were held: as late if the first is slightly late, else as leaps."""
    if -late <= _clock_step(first - last, period, late) < 0:
        state["late"] += held
    else:
        state["leaps"] += held


@kernel(inner=True)
def _has_wrapped(earlier, later, period):  # type: ignore[no-untyped-def]
    return period > 0 and (later & (period - 1)) < (earlier & (period - 1))


@kernel
def start_clock(kernel_state, time):  # type: ignore[no-untyped-def]
    """Set time 0 to the device's `time`, unless there were events before."""
    s = _FilterState(*kernel_state.value).state[0]
    if not s["dated"]:
        s["dated"], s["last"] = 1, time


@kernel
def restart_clock(kernel_state, time):  # type: ignore[no-untyped-def]
    """Go on after a restart of the device, whose new clock shows `time`."""
    s = _FilterState(*kernel_state.value).state[0]
    if s["dated"]:
        s["leaps"] += s["held"]
        s["held"] = 0
        s["now"] += s["passed"]
        s["clock_resets"] += 1
        s["last"] = time


@kernel
def reach(kernel_state, time):  # type: ignore[no-untyped-def]
    """Advance the clock to the device's `time` without an event."""
    kept = _FilterState(*kernel_state.value)
    s = kept.state[0]
    if s["dated"] and not kept.period and 0 < time - s["last"] <= kept.silence:
        s["now"] += time - s["last"]
        s["last"] = time


#: Events that are filtered at once, so that they stay in a core's first-level cache.
_BLOCK = 1_024


@kernel
def admit_columns(kernel_state, t, x, y, p, t_out, x_out, y_out, p_out):  # type: ignore[no-untyped-def]
    """Do the work of `TimestampFilter.admit`; return how many events are in the last columns."""
    n = 0
    for start in range(0, t.size, _BLOCK):
        end = start + _BLOCK
        n += _admit(
            kernel_state, t[start:end], x[start:end], y[start:end], p[start:end],
            t_out[n:], x_out[n:], y_out[n:], p_out[n:],
        )  # fmt: skip
    return n


@kernel(inner=True)
def _is_usual(t, x, y, width, height, most):  # type: ignore[no-untyped-def]
    """Return whether all events are on the sensor, and steps of time small and forward."""
    x_max, y_max, bad = np.uint16(0), np.uint16(0), False
    for i in range(t.size):  # these loops vectorise
        x_max, y_max = np.uint16(max(x_max, x[i])), np.uint16(max(y_max, y[i]))
    earlier, later = t[:-1], t[1:]
    for i in range(earlier.size):
        step = later[i] - earlier[i]
        bad |= (step < 0) | (step > most)
    return not bad and x_max < width and y_max < height


@kernel(inner=True)
def _admit(kernel_state, t, x, y, p, t_out, x_out, y_out, p_out):  # type: ignore[no-untyped-def]
    """Filter a block: all events at once if they are as usual, else one by one."""
    state, held, width, height, period, late, sure, step_limit, silence, tick, confirm = (
        kernel_state.value
    )
    held_t, held_x, held_y, held_p = held
    s = state[0]
    dated, last, now, n_held = s["dated"], s["last"], s["now"], s["held"]
    allowed = s["allowed"]
    # a longer step on a clock that wraps would be a late event
    most = min(sure, period - 1 - late) if period else sure
    step = _clock_step(np.int64(t[0]) - last, period, late)
    if dated and not n_held and 0 <= step <= most and _is_usual(t, x, y, width, height, most):
        s["wraps"] += _has_wrapped(last, np.int64(t[0]), period)
        shift = now + step - t[0]
        for i in range(t.size):
            t_out[i] = t[i] + shift
            x_out[i] = x[i]
            y_out[i] = y[i]
            p_out[i] = p[i]
        if tick != 1:
            for i in range(t.size):
                t_out[i] *= tick
        s["last"], s["now"] = t[-1], t[-1] + shift
        s["allowed"] = max(-silence, allowed - (s["now"] - now))
        return t.size
    n = 0
    for i in range(t.size):
        if x[i] >= width or y[i] >= height:
            s["off_sensor"] += 1
            continue
        time = np.int64(t[i])
        if not dated:
            dated, last = 1, time
        step = _clock_step(time - last, period, late)
        if 0 <= step <= step_limit and (step <= sure or step <= allowed):
            if n_held:  # a good event after held ones: their times were wrong
                _drop(s, last, held_t[0], n_held, period, late)
                n_held = 0
            s["wraps"] += _has_wrapped(last, time, period)
            now += step
            allowed -= step
            last = time
        else:
            if n_held:
                follows = _clock_step(time - held_t[n_held - 1], period, late)
                if not 0 <= follows <= step_limit:
                    _drop(s, last, held_t[0], n_held, period, late)
                    n_held = 0
            held_t[n_held], held_x[n_held], held_y[n_held] = time, x[i], y[i]
            held_p[n_held] = p[i]
            n_held += 1
            if n_held == confirm:
                first = held_t[0]
                step = _clock_step(first - last, period, late)
                if 0 <= step <= silence and step <= allowed:
                    s["wraps"] += _has_wrapped(last, first, period)
                    now += step
                    allowed -= step
                else:
                    s["clock_resets"] += 1
                    step = max(1, min(s["passed"], allowed))
                    now += step
                    allowed -= step
                last = first
                for k in range(n_held):
                    step = _clock_step(held_t[k] - last, period, late)
                    if step <= sure or step <= allowed:
                        now += step
                        allowed -= step
                    last = held_t[k]
                    t_out[n], x_out[n], y_out[n] = now * tick, held_x[k], held_y[k]
                    p_out[n] = held_p[k]
                    n += 1
                n_held = 0
            continue
        t_out[n], x_out[n], y_out[n], p_out[n] = now * tick, x[i], y[i], p[i]
        n += 1
    s["dated"], s["last"], s["now"], s["held"] = dated, last, now, n_held
    s["allowed"] = max(-silence, allowed)
    return n
