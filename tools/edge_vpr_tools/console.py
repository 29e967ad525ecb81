"""The terminal: messages, the present stage and progress, tables, and interrupts."""

from __future__ import annotations

import re
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from edge_vpr.errors import escaped, printable
from edge_vpr.run_log import log_warning, logged_run

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console
    from rich.text import Text

    from edge_vpr.descriptors.counting import Removed
    from edge_vpr.descriptors.published import PublishedWindows
    from edge_vpr.events import Events
    from edge_vpr.recordings import Recording
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.settings import Settings
    from edge_vpr.simulation import SimulatedRecording

# Notes on standard error and summaries on standard output, depending on ``-q`` and ``-v``.


class _Output(NamedTuple):
    """What the command that runs prints; see `running`."""

    flags: Collection[str] = ()
    quiet: bool = False
    verbose: bool = False
    json: bool = False


#: of a command that runs another one, the other one's last
_outputs = [_Output()]


@contextmanager
def running(
    command: Sequence[str],
    flags: Collection[str] = (),
    *,
    quiet: bool = False,
    verbose: bool = False,
    json: bool = False,
) -> Iterator[None]:
    """Print as much as is asked for while a command runs, which has its own list of warnings.

    Parameters
    ----------
    flags : collection of str
        Of the command; messages name them, see `in_flags`.
    quiet, verbose : bool
        Print errors only; print details.
    json : bool
        Leave standard output to one JSON object: no summary, table or paragraph is printed.
    """
    _outputs.append(_Output(flags, quiet, verbose, json))
    try:
        with logged_run(command):
            yield
    finally:
        _outputs.pop()


#: Flags of arguments that have another name.
_FLAGS_OF = {
    "max_gap_s": ["--longest-gap"],
    "reference": ["--map"],
    "Track.shifted": ["--offset", "--track-offset"],
}
#: Flags that are named as those of map where the command has none, since the map is to be made
#: in another way.
_OF_MAP = ("--track", "--odometry", "--tau", "--hot-pixels", "--places-per-window")
#: An argument as messages of the library name it: ``sensor=``, ``sensor='9x7'``, ``exclusion=0``.
_ARGUMENT = re.compile(
    r"(?<![\w/.-])([a-z][a-z_]*)=(?:'([^']*)'|(True|False|[0-9]+))?(?=[\s,;:)]|$)|(Track\.shifted)\b"
)


def in_flags(text: str) -> str:
    """Return a message of the library with the flags of the command in place of its arguments."""
    of_command = _outputs[-1].flags

    def flag(argument: re.Match[str]) -> str:
        name, quoted, plain, method = argument.groups()
        name = name or method
        possible = _FLAGS_OF.get(name, ["--" + name.replace("_", "-")])
        flags = [each for each in possible if each in of_command]
        if not flags and of_command:
            flags = [f"edge-vpr map {each}" for each in possible if each in _OF_MAP]
        if not flags:
            return argument[0]
        if plain == "False":
            return flags[0].replace("--", "--no-", 1)
        value = quoted if plain in (None, "True") else plain
        if not value:
            return flags[0]
        return flags[0] + ("=" if value.startswith("-") else " ") + value

    return _ARGUMENT.sub(flag, text)


def is_quiet() -> bool:
    """Return whether everything but errors is off."""
    return _outputs[-1].quiet


def summary(text: str) -> None:
    """Print a line of a command's result on standard output; not if quiet, or with ``--json``."""
    if not (is_quiet() or _outputs[-1].json):
        print(escaped(in_flags(text)), flush=True)


def print_facts(lines: Mapping[str, str]) -> None:
    """Print facts by their topics, as a summary."""
    width = max(map(len, lines), default=0)
    for heading, text in lines.items():
        summary(f"{heading:<{width}}  {text}")


def note(text: str) -> None:
    """Print a line on standard error; not if quiet."""
    if not is_quiet():
        error_line(text)


def detail_settings(settings: Settings) -> None:
    """Print each setting in effect if verbose."""
    if not _outputs[-1].verbose:
        return
    from edge_vpr.settings import setting_words

    for key, word in setting_words(settings.to_dict()).items():
        error_line(f"setting {key} = {word}")


def warning(text: str) -> None:
    """Print a warning on standard error, unless quiet, and keep it for the record of the run."""
    text = in_flags(text)
    log_warning(text)
    if not is_quiet():
        error_line(f"warning: {text}")


def error_line(text: str) -> None:
    """Print a line on standard error."""
    print("edge-vpr:", printable(in_flags(text)), file=sys.stderr, flush=True)


def number_of(count: int, word: str) -> str:
    """Return a number of things.

    Examples
    --------
    >>> number_of(1, "match"), number_of(2, "match"), number_of(1_000, "bin")
    ('1 match', '2 matches', '1,000 bins')
    """
    plural = "es" if word.endswith("ch") else "s"
    return f"{count:,} {word}{plural * (count != 1)}"


def places_text(reference: ReferenceMap) -> str:
    """Return the number of places of a map, and where they are if not at whole windows."""
    half = " (at half windows)" * (reference.settings.window_parts == 2)
    return f"{len(reference):,} places{half}"


def describe_faults(recording: Recording | PublishedWindows) -> str:
    """Return the end of a sentence on the events that were dropped; empty if there were none."""
    return f"; dropped as faulty: {recording.faults}" if recording.faults.total else ""


def describe_removed(removed: Removed, settings: Settings) -> str:
    """Return what was removed as bursts, as the end of a sentence."""
    if not settings.remove_bursts:
        return "; bursts kept"
    return f"; {removed.burst_events:,} events ({removed.burst_share:.1%}) removed as bursts"


#: With fewer places, hardly any lies outside the exclusion zone of a wrong match, so that its trust
#: is high: of a map of 18 places, fewer than half of the matches accepted at 0.99 were correct.
_FEW_PLACES = 50


def warn_of_few_places(path: str | Path, reference: ReferenceMap) -> None:
    """Warn if a map is so short that the shipped probabilities do not hold for it."""
    settings = reference.settings
    if len(reference) < _FEW_PLACES and settings.matching == "filter" and not reference.confidence:
        warning(
            f"{path} has {len(reference)} places: with fewer than {_FEW_PLACES}, probabilities are "
            "too high, and --precision accepts wrong matches; map a longer drive"
        )


@contextmanager
def status(text: str) -> Iterator[Callable[[str], None]]:
    """Show the present stage on a terminal; yield a function that shows the next one."""
    from rich.console import Console

    with Console(stderr=True, quiet=is_quiet()).status(text) as shown:
        yield shown.update


AnyDrive = TypeVar("AnyDrive", "Recording", "Recording | PublishedWindows")


def watched(recording: AnyDrive, label: str) -> AnyDrive:
    """Show the progress of each pass over the events of a recording under `label`."""
    from edge_vpr.recordings import Recording

    if isinstance(recording, Recording) and _takes_bar():
        recording.watch = lambda events: with_progress(recording, label, events)
    return recording


def _takes_bar() -> bool:
    """Return whether a progress bar is shown."""
    from rich.console import Console  # slow to load, as all of rich

    return not is_quiet() and Console(stderr=True).is_terminal


def with_progress(
    recording: Recording | SimulatedRecording, label: str, events: Iterable[Events] | None = None
) -> Iterator[Events]:
    """Yield the events, and show a progress bar on standard error if it is a terminal.

    Parameters
    ----------
    events : iterable of Events, optional
        A pass over the recording; by default a new one.
    """
    events = recording if events is None else events
    if not _takes_bar():
        yield from events
        return
    from rich import progress as rich
    from rich.console import Console

    columns = (
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.TextColumn("{task.fields[events]}"),
        rich.TimeElapsedColumn(),
        rich.TextColumn("left:"),
        rich.TimeRemainingColumn(),
    )
    # transient: the bar disappears when the pass ends, and the lines of the command stay
    with rich.Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(label, total=None, events="")
        n = 0
        for some in events:
            yield some
            n += some.size
            share = recording.position
            progress.update(
                task,
                events=f"{n:,} events",
                total=None if share is None else 1.0,
                completed=share or 0.0,
            )


# Orderly end, with files and summary, on Ctrl-C, SIGTERM and a closed terminal.


@contextmanager
def stopped_by_signals(stopping: threading.Event) -> Iterator[None]:
    """Set `stopping` at the first signal; a second one interrupts as usual."""
    caught = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # `nohup` wants the run to continue
        caught.append(signal.SIGHUP)

    def stop(number: int, frame: FrameType | None) -> None:
        if stopping.is_set():
            raise KeyboardInterrupt
        stopping.set()

    with handled(caught, stop):
        yield


@contextmanager
def handled(
    caught: Iterable[signal.Signals], handler: Callable[[int, FrameType | None], None]
) -> Iterator[None]:
    """Handle signals within the block; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in caught}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


# Tables and lines on the terminal, with a fixed width if the output is a file.


#: width of a table in a file, in characters
WIDTH = 118


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str | None = None,
    width: int = WIDTH,
) -> None:
    """Print a table: the first column to the left, numbers to the right; not if quiet.

    Parameters
    ----------
    width : int
        In columns, where the output is no terminal.
    """
    from rich.table import Table  # slow to load, as all of rich

    shown = Table(title=None if title is None else _plain(title))
    for i, name in enumerate(header):
        shown.add_column(_plain(name), justify="left" if i == 0 else "right", overflow="fold")
    for row in rows:
        shown.add_row(*map(_plain, row))
    _console(width).print(shown)


def say(text: str, *, width: int = WIDTH) -> None:
    """Print a paragraph, see `table`."""
    _console(width).print(_plain(text))


def _plain(text: str) -> Text:
    """Return text without the mark-up and escapes that names of files and devices can contain."""
    from rich.text import Text

    return Text("\n".join(map(escaped, text.split("\n"))))


def _console(width: int) -> Console:
    from rich.console import Console

    silent = is_quiet() or _outputs[-1].json
    return Console(width=None if Console().is_terminal else width, quiet=silent)
