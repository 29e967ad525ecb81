"""Cases on a board over its serial port, where `vpr_replay_line` of ``c/replay.c`` runs them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from firmware_model.errors import BoardError, VectorError
from firmware_model.vectors.case import KINDS, Record
from firmware_model.vectors.manifest import CaseEntry, load_manifest, read_case_file

#: of ``c/replay.h``: the word with which a case begins, and records of the line alone
MAGIC, READY, REFUSED = 0x43525056, 4, 5
#: largest number of values in a record
_LONGEST = 1 << 20


class Line(Protocol):
    """What is used of a `serial.Serial` with a time limit."""

    def read(self, size: int, /) -> bytes:
        """Return so many bytes, or fewer when the time is over."""

    def write(self, data: Any, /) -> Any:
        """Send bytes."""


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
        Open, with a time limit for reading.
    folder : path
        Folder of the vectors.
    case : str, optional
        The only case to run, as ``suite/name``.
    show : callable, optional
        Called with the present case and how much of it is sent, whenever the board takes more.

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
    line.write(struct.pack("<5I", MAGIC, *number, len(image), len(events) // 8))
    left = data = image + events
    found: list[Record] = []
    # a device may return too many, but not without end
    most = 2 * (1 + entry.events + entry.windows + entry.matches) + 16
    while True:
        kind, count = struct.unpack("<2I", _read(line, 8, name))
        if kind > REFUSED or not 0 < count <= (_LONGEST if 0 < kind < READY else 1):
            raise BoardError(
                f"{name}: the board sent {kind:#x} and {count:#x}, which begin no record: reset "
                "it, and check --baud"
            )
        values = struct.unpack(f"<{count}I", _read(line, 4 * count, name))
        if (kind == 0) == bool(found) or (not found and values != (entry.number,)):
            raise BoardError(
                f"{name}: the board does not begin with the number of the case, {entry.number}, "
                f"or begins twice (kind {kind}, {values[0]}): reset it, and check the line"
            )
        if len(found) > most or (kind == READY and values[0] > len(left)):
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
            returned.records += found
            return
        if kind == READY:
            yield 1 - len(left) / len(data)
            line.write(left[: values[0]])
            left = left[values[0] :]
        else:
            found.append((KINDS[kind], values))


def _read(line: Line, size: int, name: str) -> bytes:
    data = line.read(size)
    if len(data) < size:
        raise BoardError(
            f"{name}: the board is silent: reset it, as after every run that was ended before its "
            "end, check that it runs vpr_replay_line, and check --baud"
        )
    return data
