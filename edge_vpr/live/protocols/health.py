"""Health: counts of delivered, dropped and lost bytes and events of a stream."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

#: How exactly a protocol can know the number of lost events.
EXACT, UNKNOWN = "exact", "unknown"


def _no_fault(first: Any = 0) -> Any:
    """Return a field that is no fault, or that other counts include."""
    return field(default=first, metadata={"fault": False})


def _loss() -> Any:
    """Return a count of faults of which each makes a window incomplete, see `Health.losses`."""
    return field(default=0, metadata={"loss": True})


@dataclass
class Health:
    """Counts since the stream began. Two sums hold at any time, whatever the line does.

    - ``bytes = decoded_bytes + skipped_bytes + pending_bytes``: all bytes are accounted for
    - ``decoded = events + rejected + held``: all decoded events are accounted for

    and a third one between the device and the host, as far as the protocol allows (`accounting`):
    ``made by the device = decoded + lost + device_dropped``.
    """

    #: {"exact", "unknown"}: whether `lost` is the number of events that were sent and never
    #: decoded, or only of the losses that happened to be noticed.
    accounting: str = _no_fault(UNKNOWN)
    bytes: int = _no_fault()  #: Received.
    #: Part of whole, undamaged events or frames (or of words that say something else).
    decoded_bytes: int = _no_fault()
    skipped_bytes: int = 0  #: Damaged, or not of this protocol.
    pending_bytes: int = _no_fault()  #: Beginnings whose end has not arrived.
    frames: int = _no_fault()  #: Undamaged frames, where the protocol has frames.
    repeats: int = 0  #: Undamaged frames that came a second time, and were left out.
    resyncs: int = _loss()  #: How often the decoder had to look for the next event or frame.
    crc_errors: int = _loss()  #: Frames dropped because a checksum or their length was wrong.
    sequence_gaps: int = _loss()  #: How often a sequence number showed that something is missing.
    decoded: int = _no_fault()  #: Events taken out of the bytes.
    events: int = _no_fault()  #: Events delivered.
    held: int = _no_fault()  #: Events whose odd time awaits what comes after them.
    #: late, leaps, off_sensor, undated: events rejected: a little earlier than one before them;
    #: with a time far off, which those after them did not confirm; at a pixel that does not exist;
    #: before the first time word.
    late: int = _loss()
    leaps: int = _loss()
    off_sensor: int = _loss()
    undated: int = _loss()
    lost: int = 0  #: Events sent and never decoded, as far as known.
    device_dropped: int = _loss()  #: Events that the device says it had to drop.
    #: Restarts of the device; what it lost between its last frame and the restart is unknown.
    device_resets: int = _loss()
    #: overruns, overrun_bytes: how often, and how many bytes, the host dropped because it fell
    #: behind.
    overruns: int = _loss()
    overrun_bytes: int = 0
    #: Characters with a wrong frame or parity, or dropped by the serial port or its driver, as far
    #: as the system counts them.
    line_errors: int = _loss()
    wraps: int = _no_fault()  #: Wraps of the device's clock.
    #: How often the clock restarted, which keeps the order of events but not their distance.
    clock_resets: int = _loss()
    #: Steps of the clock over so many ticks that one match was given for all of them.
    clock_jumps: int = _loss()
    reopened: int = _loss()  #: How often the link was disconnected and opened again.
    stalls: int = 0  #: Silences of more than a second after the first byte.
    odometer_leaps: int = 0  #: Readings left out: leaps that are too fast for a robot.
    #: Metres by the odometer since its first reading; None without one.
    odometer_m: float | None = _no_fault(None)
    misfits: int = 0  #: Matches in another place or light than the map's, by their misfit.
    #: lag_us, longest_lag_us: how much later than the quickest events the newest ones were matched,
    #: and the latest ones, by the clocks of camera and host. It includes bytes that waited in the
    #: system for a host that was busy.
    lag_us: int = _no_fault()
    longest_lag_us: int = _no_fault()
    silent_s: float = _no_fault(0.0)  #: Seconds since the newest bytes.
    #: Whether the link is disconnected and has not returned, such as that of a camera which has
    #: come back under another name. What is sent meanwhile is in no count: `accounting` and `lost`
    #: are of what came before.
    cut_off: bool = _no_fault(False)

    @property
    def rejected(self) -> int:
        """Events that were decoded and not delivered."""
        return sum(getattr(self, name) for name in _REJECTED)

    @property
    def losses(self) -> int:
        """Number that grows whenever a loss becomes known; a window with a loss is incomplete."""
        return sum(getattr(self, name) for name in _LOSSES)

    @property
    def faults(self) -> dict[str, int]:
        """Counts of the faults that occurred, by their names."""
        return {name: count for name in _FAULTS if (count := getattr(self, name))}

    def reject_undated(self, n: int) -> None:
        """Count `n` decoded events that have no time."""
        self.undated += n
        self.decoded += n

    def __str__(self) -> str:
        """Return every fault that occurred, with its count."""
        parts = []
        for name, count in self.faults.items():
            name = name.replace("_", " ").replace("crc", "CRC")
            if count == 1:
                name = name.removesuffix("s")
            parts.append(f"{count:,} {name}")
        return ", ".join(parts) or "no faults"

    def describe_losses(self) -> str:
        """Return the number of lost events as text, how exactly it is known, and those rejected."""
        until = "; what was sent after that is not known" if self.cut_off else ""
        came = [
            f"{count:,} {name.replace('_', ' ')}"
            for name in _REJECTED
            if (count := getattr(self, name))
        ]
        rejected = f"; of those that came, left out: {', '.join(came)}" if came else ""
        return self._lost_events() + rejected + until

    def _lost_events(self) -> str:
        dropped = f", {self.device_dropped:,} dropped by the device" if self.device_dropped else ""
        restarts = "at least " if self.device_resets else ""
        before = " before the link was lost" if self.cut_off else ""
        if self.accounting == EXACT and not self.frames and self.skipped_bytes:
            return "no frame came whole, so that nothing is known of the events lost"
        if self.accounting == EXACT:
            return f"{restarts}{self.lost:,} events lost on the way{before}{dropped}"
        return (
            f"{self.skipped_bytes + self.overrun_bytes:,} bytes lost or unreadable{before}; events "
            "lost before they arrived are unknown to this protocol"
        )


_FAULTS = tuple(one.name for one in fields(Health) if one.metadata.get("fault", True))
_REJECTED = ("late", "leaps", "off_sensor", "undated")
_LOSSES = tuple(one.name for one in fields(Health) if one.metadata.get("loss"))
