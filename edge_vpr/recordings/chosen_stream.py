"""Choice of one of the streams of a file, by its name or its number."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from edge_vpr.errors import RecordingError, UsageError


class Wording(NamedTuple):
    """What messages call the streams.

    Attributes
    ----------
    one, several : str
        ``"camera"`` and ``"cameras"``, for example.
    remedy : str
        What to do if there is none.
    """

    one: str
    several: str
    remedy: str


def choose_stream(
    path: Path, names: Mapping[int, str], wanted: str | None, wording: Wording
) -> int:
    """Return the number of the one stream, or of that which is wanted.

    Parameters
    ----------
    path : Path
    names : mapping of int to str
        Names of the streams by their numbers.
    wanted : str, optional
        Name or number of the stream.
    wording : Wording

    Raises
    ------
    RecordingError
        If there is none.
    UsageError
        If there are several.
    """
    found = [number for number, name in names.items() if wanted in (None, name, str(number))]
    listed = ", ".join(f"{number} ({name})" for number, name in names.items()) or "none"
    if not found:
        raise RecordingError(
            f"{path} has no {wording.one}{f' {wanted!r}' if wanted else ''}; it has: {listed}: "
            f"{wording.remedy}, or choose one of these with --topic"
        )
    if len(found) > 1:
        raise UsageError(f"{path} has several {wording.several}, {listed}: choose with --topic")
    return found[0]
