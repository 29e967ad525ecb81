"""The CSV file of a sweep: a row for each trial and tolerance, appended when the trial ends."""

from __future__ import annotations

import csv
import fcntl
import io
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import edge_vpr
from edge_vpr.errors import UsageError
from edge_vpr.files import open_input
from edge_vpr.settings import SETTING_FIELDS, setting_words
from edge_vpr_tools.report.spreadsheets import spreadsheet_cell, write_spreadsheet
from edge_vpr_tools.sweep import MEASURES
from edge_vpr_tools.sweep.trial import Measured, Trial

#: columns of what a trial is, and of its settings but the seed
NAMES = ("variant", "drives", "tolerance", "seed")
SETTINGS = tuple(field.key for name, field in SETTING_FIELDS.items() if name != "seed")
COLUMNS = (*NAMES, *SETTINGS, *MEASURES, "version")
_NUMBERS = ("seed", *MEASURES)

#: cells by column
Line = Mapping[str, str]
#: appends the rows of a trial
Append = Callable[[Trial, Sequence[Measured]], None]


def read_lines(path: Path) -> Sequence[Line]:
    """Read the rows of a sweep.

    Raises
    ------
    UsageError
        If the file cannot be read, is no sweep's, or has a row without all its numbers.
    """
    try:
        with io.TextIOWrapper(open_input(path), newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path} cannot be read ({reason}): check the path") from error
    if rows[:1] != [list(COLUMNS)]:
        raise UsageError(
            f"{path} is not the file of a sweep of edge-vpr {edge_vpr.__version__}, whose columns "
            f"are {', '.join(COLUMNS[:5])}, ...: name one that edge-vpr sweep wrote"
        )
    lines = [dict(zip(COLUMNS, row, strict=False)) for row in rows[1:]]
    for number, (row, line) in enumerate(zip(rows[1:], lines, strict=True), 2):
        if len(row) != len(COLUMNS) or not all(_is_number(line[name]) for name in _NUMBERS):
            raise UsageError(
                f"{path}, row {number} lacks a column or a number: delete the row, and run the "
                "sweep with --resume"
            )
    return lines


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


@contextmanager
def appending(path: Path) -> Iterator[Append]:
    """Open the file of a sweep for one process, with a heading if it is new or empty.

    Raises
    ------
    UsageError
        If another sweep writes to it.
    """
    with path.open("a", newline="", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(
                f"another sweep writes to {path}: wait for it, or name another file"
            ) from None

        def write(rows: Iterable[Sequence[str | float]]) -> None:
            # in one piece, so that a killed sweep leaves a trial whole or not at all
            text = io.StringIO(newline="")
            csv.writer(text).writerows(map(spreadsheet_cell, row) for row in rows)
            file.write(text.getvalue())
            file.flush()

        def append(trial: Trial, measured: Sequence[Measured]) -> None:
            write(
                [
                    trial.variant, trial.drives, one["tolerance"], trial.settings.seed,
                    *words_of(trial).values(), *(float(one[name]) for name in MEASURES),
                    one["version"],
                ]
                for one in measured
            )  # fmt: skip

        if os.fstat(file.fileno()).st_size == 0:
            write([COLUMNS])
        yield append


def words_of(trial: Trial) -> dict[str, str]:
    """Return the settings of a trial by their keys, but the seed."""
    words = setting_words(trial.settings.to_dict())
    return {key: words[key] for key in SETTINGS}


def remaining(trials: Sequence[Trial], path: Path) -> list[Trial]:
    """Return the trials of which a file has no row yet.

    Raises
    ------
    UsageError
        If it has a row of the same variant, drives and seed by other settings or another version.
    """
    rows = {_name(line): line for line in read_lines(path)}
    left = []
    for trial in trials:
        line = rows.get(_name_in_file(trial))
        if line is None:
            left.append(trial)
            continue
        for key, word in {**words_of(trial), "version": edge_vpr.__version__}.items():
            if line[key] != str(spreadsheet_cell(word)):
                raise UsageError(
                    f"{path} has {trial.variant} on {trial.drives} with {key} = {line[key]}, and "
                    f"it is {word} now: name another file, or --overwrite this one"
                )
    return left


def put_in_order(path: Path, trials: Sequence[Trial]) -> None:
    """Write the rows anew in the order of the trials; a comparison is with the first variant."""
    places = {_name_in_file(trial): number for number, trial in enumerate(trials)}
    lines = sorted(read_lines(path), key=lambda line: places.get(_name(line), len(places)))
    cells = [
        [float(line[name]) if name in MEASURES else line[name] for name in COLUMNS]
        for line in lines
    ]
    write_spreadsheet(path, COLUMNS, cells)


def _name(line: Line) -> tuple[str, str, str]:
    return line["variant"], line["drives"], line["seed"]


def _name_in_file(trial: Trial) -> tuple[str, str, str]:
    variant, drives = (str(spreadsheet_cell(name)) for name in (trial.variant, trial.drives))
    return variant, drives, str(trial.settings.seed)
