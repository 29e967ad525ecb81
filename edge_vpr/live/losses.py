"""What is missing of a match: the share of its events that is known to be lost."""

from __future__ import annotations

from bisect import bisect_right

from edge_vpr.live.protocols.health import EXACT, Health

#: Interval at which losses are remembered, and for how many intervals.
LOSS_STEP_US, MOST_LOSS_STEPS = 10_000, 16_384


class LossWatch:
    """Keep counts of received and lost events over time, to find the losses within a window.

    Parameters
    ----------
    health : Health
        Of the stream.
    """

    def __init__(self, health: Health) -> None:
        self._health = health
        # noticed losses, bytes without events so far, and an estimate of the events in them
        self._losses = self._bytes = self._of_bytes = 0
        self._in_loss = False  # whether no event has come since a loss was noticed
        self._decoded = 0
        self._reopened = 0  # of the gaps that were noted
        # time, events received, events lost, and losses of unknown size, each of them until then
        self._seen: list[tuple[int, int, int, int]] = [(-1, 0, 0, 0)]

    def note(self, reached_us: int, oldest_us: int) -> None:
        """Take the counts of the present time; those from before `oldest_us` are not needed."""
        seen, counts = self._seen, (reached_us, *self._counts())
        self._reopened = self._health.reopened
        if len(seen) > MOST_LOSS_STEPS or seen[len(seen) // 2][0] < oldest_us:
            del seen[: len(seen) // 2]
        if len(seen) > 1 and reached_us - seen[-2][0] < LOSS_STEP_US:
            seen[-1] = counts
        else:
            seen.append(counts)

    def gap(self, end_us: int) -> None:
        """Note that what precedes `end_us` is missing, before the counts of later bytes are taken.

        One piece of bytes may hold much that came after the gap, of which nothing is missing.
        """
        _, received, lost, unknown = self._seen[-1]
        unknown += self._health.reopened - self._reopened
        self._reopened = self._health.reopened
        self._seen.append((end_us, received, lost, unknown))

    def missing(self, begin_us: int) -> float:
        """Return the share of events that is known to be lost from a time on.

        Returns
        -------
        float
            0 to 1; 1 if something of unknown size is missing, such as the time before the camera
            started again.
        """
        seen = self._seen
        _, received, lost, unknown = seen[max(bisect_right(seen, (begin_us,)) - 1, 0)]
        _, now, lost_now, unknown_now = seen[-1]
        if unknown_now != unknown:
            return 1.0
        lost = lost_now - lost
        return lost / (lost + max(now - received, 0)) if lost > 0 else 0.0

    def _counts(self) -> tuple[int, int, int]:
        health, lost = self._health, self._health.lost
        if health.accounting != EXACT:
            before = self._bytes
            self._bytes = health.skipped_bytes + health.overrun_bytes + health.line_errors
            # a device may send other things than events, but not before a loss is over
            noticed = health.losses != self._losses
            if noticed or self._in_loss:
                events = (self._bytes - before) * health.decoded
                self._of_bytes += -(-events // max(health.decoded_bytes, 1))
            self._in_loss = noticed or (self._in_loss and health.decoded == self._decoded)
            self._decoded = health.decoded
            self._losses = health.losses
            lost = max(lost, self._of_bytes)
        lost += health.device_dropped + health.rejected
        breaks = health.reopened + health.device_resets + health.clock_resets + health.clock_jumps
        return health.events, lost, breaks
