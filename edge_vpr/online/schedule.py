"""Schedule of matches: after a number of events, at times, or when the place changes."""

from __future__ import annotations

from dataclasses import dataclass

from edge_vpr.descriptors.windows import MAX_WINDOWS
from edge_vpr.errors import UsageError, expect
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.settings import Settings, duration_us


@dataclass(frozen=True)
class MatchSchedule:
    """Schedule of matches or descriptors, by events, by time, or by both.

    >>> MatchSchedule(interval_us=50_000)
    MatchSchedule(events=0, interval_us=50000, change=False)
    >>> MatchSchedule.parse("50ms", Settings()) == MatchSchedule(interval_us=50_000)
    True

    Parameters
    ----------
    events : int
        Number of events at the selected pixels after which to match; 0: not by events.
    interval_us : int
        Match at every multiple of this time, before the events of that time; 0: not by time.
    change : bool
        Whether to report only matches whose place differs from the last reported one.
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
        """Return the schedule with a match at the end of each non-overlapping window."""
        if settings.window == "time":
            return cls(interval_us=settings.tau_us)
        return cls(events=settings.events_per_window)

    @classmethod
    def parse(
        cls, when: str | MatchSchedule | None, settings: Settings, default: str = "50ms"
    ) -> MatchSchedule:
        """Return the schedule of live matches with a map.

        Parameters
        ----------
        when : str, MatchSchedule or None
            ``event``, a number of events, a time such as ``10ms``, ``window``, or ``change``; None:
            the default.
        settings : Settings
            Settings of the map.
        """
        if isinstance(when, MatchSchedule):
            return when
        text = default if when is None else when
        expect(text, str, "every", "a text such as '50ms' or 'window'")
        if text == "window":
            return cls.window(settings)
        if text in ("event", "change"):
            return cls(events=1, change=text == "change")
        if text.isascii() and text.isdigit() and int(text) > 0:
            return cls(events=int(text))
        try:
            return cls(interval_us=duration_us(text))
        except UsageError:
            raise UsageError(
                f"every={text!r}: expected event, a number of events, a time such as 10ms, window, "
                "or change"
            ) from None

    def check_ticks(self, from_us: int, until_us: int) -> None:
        """Raise UsageError if time jumps over more than a million intervals."""
        if self.interval_us and (until_us - from_us) // self.interval_us > MAX_WINDOWS:
            raise UsageError(
                f"time jumps to {until_us} us, over more than {MAX_WINDOWS} times every "
                f"{self.interval_us} us: check the recording's clock, whose times count from the "
                "first event in microseconds, or ask less often"
            )
