"""Reading of text files of ground truth, in any usual encoding."""

from __future__ import annotations

from pathlib import Path

from edge_vpr.errors import GroundTruthError

#: longest log: a day at ten fixes a second has 140 MB, all of which is read into memory
MAX_BYTES = 256 << 20


def read_text(path: Path) -> str:
    """Read a text of UTF-8 or, as some loggers on Windows write, UTF-16.

    Returns
    -------
    str
        Bytes that are no text are U+FFFD, so that checksums and number parsers refuse them.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, or is too long to be a log.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise GroundTruthError(
            f"{path} cannot be read ({error.strerror}): check the path"
        ) from error
    if len(raw) > MAX_BYTES:
        raise GroundTruthError(f"{path} has more than {MAX_BYTES} bytes: split it")
    return raw.decode(_encoding(raw), errors="replace").removeprefix("\ufeff")


def _encoding(raw: bytes) -> str:
    # Every other byte of Latin text in UTF-16 is zero. The byte order mark is not used: it can be
    # missing, and noise on a serial line can look like it.
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        half = raw[first:1_000:2]
        if half and half.count(0) > 0.9 * len(half):
            return encoding
    return "utf-8"
