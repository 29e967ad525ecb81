"""Schedule of matches: after a number of events, at times, or when the place changes."""

from __future__ import annotations

from dataclasses import dataclass

from edge_vpr.descriptors.windows import MAX_WINDOWS
from edge_vpr.errors import UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.settings import Settings


@dataclass(frozen=True)
class MatchSchedule:
    """Schedule of matches or descriptors, by events, by time, or by both.

    Parameters
    ----------
    events : int
        After so many events at the selected pixels; 1 is after each. 0: not by events.
    interval_us : int
        At every multiple of so many microseconds, before the events of that time. 0: not by time.
    change : bool
        Of what the others ask for, only matches whose place differs from the one said before.
    """

    events: int = 0
    interval_us: int = 0
    change: bool = False

    def __post_init__(self) -> None:
        for name, kind in (("events", int), ("interval_us", int), ("change", bool)):
            value = getattr(self, name)
            if type(value) is not kind or value > TIME_LIMIT_US:
                raise UsageError(
                    f"matches with {name} = {value!r}: expected {kind.__name__}, at most "
                    f"{TIME_LIMIT_US}"
                )
        if self.events < 0 or self.interval_us < 0 or not (self.events or self.interval_us):
            raise UsageError(
                f"a match every {self.events} events and every {self.interval_us} us: "
                "expected a positive number of one of them"
            )

    @classmethod
    def window(cls, settings: Settings) -> MatchSchedule:
        """Return the schedule of a match at the end of every non-overlapping window."""
        if settings.window == "time":
            return cls(interval_us=settings.tau_us)
        return cls(events=settings.events_per_window)

    def check_ticks(self, from_us: int, until_us: int) -> None:
        """Raise UsageError if time jumps over more than a million intervals."""
        if self.interval_us and (until_us - from_us) // self.interval_us > MAX_WINDOWS:
            raise UsageError(
                f"time jumps to {until_us} us, over more than {MAX_WINDOWS} times every "
                f"{self.interval_us} us: check the recording's clock, or ask less often"
            )
