"""Cases on a board over its serial port, where `vpr_replay_line` of ``c/replay.c`` runs them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from firmware_model.errors import BoardError, VectorError
from firmware_model.specification import MatchResult
from firmware_model.vectors.case import KINDS, Record
from firmware_model.vectors.manifest import CaseEntry, load_manifest, read_case_file

#: of ``c/replay.h``: the word with which a case begins, and records of the line alone
MAGIC, READY, REFUSED = 0x43525056, 4, 5
#: bytes that one reading or writing waits for, so that a slow line is no silent one
_PIECE = 1_024


class Line(Protocol):
    """What is used of a `serial.Serial` with time limits."""

    def read(self, size: int, /) -> bytes:
        """Return so many bytes, or fewer when the time is over."""

    def write(self, data: Any, /) -> Any:
        """Send bytes; raise OSError if the board takes none until the time is over."""


@dataclass
class Returned:
    """What a board returned.

    Attributes
    ----------
    records : list
        As `verify` takes them.
    too_large : dict of str to int
        Cases for which the board has too little memory, and the bytes that they need.
    """

    records: list[Record] = field(default_factory=list)
    too_large: dict[str, int] = field(default_factory=dict)


def run_on_board(
    line: Line,
    folder: str | Path,
    case: str | None = None,
    show: Callable[[str], None] = lambda text: None,
) -> Returned:
    """Send cases to a board, and return its records.

    Cases beyond the reference firmware's limits are left out.

    Parameters
    ----------
    line : serial.Serial
        Open, with time limits for reading and for writing.
    folder : path
        Folder of the vectors.
    case : str, optional
        The only case to run, as ``suite/name``.
    show : callable, optional
        Called with the present case, and with how much of it is sent whenever the board takes more.

    Raises
    ------
    BoardError
        If the board is silent, sends what is no record, or refuses an image.
    VectorError
        If there is no such case.
    """
    cases = dict(load_manifest(folder).cases())
    if case is not None and case not in cases:
        raise VectorError(
            f"{folder} has no case {case!r}: it has for example {next(iter(cases), 'none')!r}"
        )
    chosen = {
        name: entry for name, entry in cases.items()
        if case in (None, name) and "image.bin" in entry.files
    }  # fmt: skip
    returned = Returned()
    for number, (name, entry) in enumerate(chosen.items(), 1):
        counted = f"case {number} of {len(chosen)}, {name}"
        show(counted)
        for sent in _run(line, Path(folder), name, entry, returned):
            show(f"{counted}: {sent:.0%} sent")
    return returned


def _run(
    line: Line, folder: Path, name: str, entry: CaseEntry, returned: Returned
) -> Iterator[float]:
    """Run a case; yield the share that is sent, whenever the board takes more."""
    image, events = (
        read_case_file(folder, name, entry, file) for file in ("image.bin", "events.bin")
    )
    number = entry.number, entry.start % (1 << 32)
    _write(line, struct.pack("<5I", MAGIC, *number, len(image), len(events) // 8), name)
    longest = _longest(entry)
    left = data = image + events
    records: list[Record] = []
    # a device may return too many, but not without end
    most = 2 * (1 + entry.events + entry.windows + entry.matches) + 16
    while True:
        kind, count = struct.unpack("<2I", _read(line, 8, name))
        if kind > REFUSED or not 0 < count <= longest[kind]:
            of_kind = "" if kind > REFUSED else f" of its kind, which has {longest[kind]} values"
            raise BoardError(
                f"{name}: the board sent {kind:#x} and {count:#x}, which begin no record{of_kind}: "
                "reset it, and check --baud"
            )
        values = struct.unpack(f"<{count}I", _read(line, 4 * count, name))
        if (kind == 0) == bool(records) or (not records and values != (entry.number,)):
            raise BoardError(
                f"{name}: the board does not begin with the number of the case, {entry.number}, "
                f"or begins twice (kind {kind}, {values[0]}): reset it, and check the line"
            )
        if len(records) > most or (kind == READY and values[0] > len(left)):
            raise BoardError(
                f"{name}: the board sends more records or asks for more bytes than the case has: "
                "reset it, and check the line"
            )
        if kind == REFUSED and values != (0,):
            returned.too_large[name] = values[0]
            return
        if kind == REFUSED:
            raise BoardError(
                f"{name}: the board refuses the image: it came damaged over the line, or the "
                "firmware is of another version than the vectors"
            )
        if kind == READY and values == (0,):
            returned.records += records
            return
        if kind == READY:
            yield 1 - len(left) / len(data)
            _write(line, left[: values[0]], name)
            left = left[values[0] :]
        else:
            records.append((KINDS[kind], values))


def _longest(entry: CaseEntry) -> tuple[int, ...]:
    """Return the most values of a record of the line, by its kind."""
    event, window = 3, 2 + entry.design.slots
    match = len(MatchResult._fields) - (not entry.design.filters)
    return 1, event, window, match, 1, 1


def _read(line: Line, size: int, name: str) -> bytes:
    data = b""
    while len(data) < size:
        piece = min(size - len(data), _PIECE)
        data += (came := line.read(piece))
        if len(came) < piece:
            raise BoardError(
                f"{name}: the board is silent: reset it, as after every run that was ended before "
                "its end, check that it runs vpr_replay_line, and check --baud"
            )
    return data


def _write(line: Line, data: bytes, name: str) -> None:
    for at in range(0, len(data), _PIECE):
        try:
            line.write(data[at : at + _PIECE])
        except OSError as error:
            raise BoardError(
                f"{name}: the board asks for bytes and does not take them ({error}): reset it, and "
                "check that it reads its port"
            ) from error
