"""Progress bars on a terminal, and nothing in a pipe or if quiet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from edge_vpr.descriptors.counting import Removed, WindowSource
from edge_vpr.events import Events
from edge_vpr.settings import Settings
from edge_vpr.simulation import SimulatedRecording
from edge_vpr.warm_up import WarmUpStep, warm_up
from edge_vpr_tools.console import check_interrupted, is_quiet, warning


class Tracked:
    """A recording whose every pass shows a progress bar on standard error.

    Attributes are the recording's own (``sensor``, ``start_us``, ...).
    """

    def __init__(self, recording: Iterable[Events], label: str) -> None:
        self._recording = recording
        self._label = label

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._recording, name)

    def __iter__(self) -> Iterator[Events]:
        console = Console(stderr=True)
        shown = self._recording
        if not is_quiet() and console.is_terminal:
            shown = self._shown(console)
        for events in shown:
            check_interrupted()
            yield events

    def _shown(self, console: Console) -> Iterator[Events]:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[events]}"),
            TimeElapsedColumn(),
            TextColumn("left:"),
            TimeRemainingColumn(),
        )
        # transient: the bar disappears when the pass ends, and the lines of the command stay
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task(self._label, total=None, events="")
            n = 0
            for events in self._recording:
                yield events
                n += events.size
                position = getattr(self._recording, "position", None)
                progress.update(
                    task,
                    events=f"{n:,} events",
                    total=None if position is None else 1.0,
                    completed=0.0 if position is None else position,
                )


def tracked(recording: Any, label: str) -> Any:
    """Wrap a recording so that each pass over it shows its progress under `label`.

    Published windows, which are not iterated, pass through as they are.

    Returns
    -------
    Tracked
        Typed as `Any`, because it stands in for the recording.
    """
    return recording if isinstance(recording, WindowSource) else Tracked(recording, label)


def keep_shown(recording: SimulatedRecording, label: str) -> SimulatedRecording:
    """Simulate a drive with a progress bar, and keep its events in memory."""
    return recording.keep(partial(tracked, label=label))


@contextmanager
def status(text: str) -> Iterator[Callable[[str], None]]:
    """Show the present stage on a terminal; yield a function that shows the next one."""
    with Console(stderr=True, quiet=is_quiet()).status(text) as shown:
        yield shown.update


def warmed_up(steps: Sequence[WarmUpStep]) -> None:
    """Compile kernels, or load them, before the work; show the present one on a terminal."""
    with status("kernels") as show:
        warm_up(steps, show)
    check_interrupted()


# Texts on what cleaning removed from a recording, with a warning if it was much.


#: share of events that a few bursts of a sensor do not reach
MUCH = 0.05


def describe_removed(removed: Removed, settings: Settings) -> str:
    """Return what was removed as bursts, as the end of a sentence."""
    if not settings.remove_bursts:
        return "; bursts kept"
    return f"; {removed.burst_events:,} events ({removed.burst_share:.1%}) removed as bursts"


def warn_if_much(removed: Removed, path: str, remedy: str) -> None:
    """Warn if bursts were more than `MUCH` of a recording."""
    if removed.burst_share > MUCH:
        warning(
            f"{removed.burst_share:.0%} of the events of {path} were removed as bursts, moments "
            f"when most pixels fire: if that is the scene's or the camera's motion, {remedy}"
        )
