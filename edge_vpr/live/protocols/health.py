"""Health: counts of delivered, dropped and lost bytes and events of a stream."""

from __future__ import annotations

from dataclasses import dataclass, fields

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
