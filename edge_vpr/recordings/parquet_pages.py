"""Sizes of the pages of a Parquet file, read before Arrow reserves memory for them.

Arrow believes the size that a page's header states, up to 2 GiB. The headers are structures in
Thrift's compact protocol: a byte of type and field number before each value, integers as zigzag
varints (parquet.apache.org, "File Format"; Apache Thrift, "Compact Protocol").
"""

from __future__ import annotations

from typing import IO, NamedTuple

_LONGEST_HEADER = 1 << 16  # statistics are part of it
_DEEPEST = 8
_UNCOMPRESSED, _COMPRESSED = 2, 3  # fields of PageHeader


class Page(NamedTuple):
    """Place of one page in the file, and its sizes in bytes without the header."""

    at: int
    compressed: int
    uncompressed: int


def read_pages(file: IO[bytes], begin: int, end: int) -> list[Page]:
    """Read the headers of all pages between two places of a file.

    Parameters
    ----------
    file : binary file
    begin, end : int
        Where a column chunk begins and ends.

    Returns
    -------
    list of Page

    Raises
    ------
    ValueError
        If a header cannot be read.
    """
    pages, at = [], begin
    while at < end:
        file.seek(at)
        header = _Header(file.read(min(_LONGEST_HEADER, end - at)))
        fields = header.structure()
        compressed, uncompressed = fields.get(_COMPRESSED, -1), fields.get(_UNCOMPRESSED, -1)
        if compressed < 0 or uncompressed < 0:
            raise ValueError(f"the page at byte {at:,} states no size")
        pages.append(Page(at, compressed, uncompressed))
        at += header.at + compressed
    return pages


class _Header:
    """Reads integers of a structure, and skips all else."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def structure(self, depth: int = 0) -> dict[int, int]:
        """Read one structure; its integers by field number."""
        if depth > _DEEPEST:
            raise ValueError("a page header is nested too deeply")
        fields: dict[int, int] = {}
        number = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            number = number + step if step else self._integer()
            if kind in (4, 5, 6):
                fields[number] = self._integer()
            else:
                self._skip(kind, depth)
        return fields

    def _skip(self, kind: int, depth: int, *, element: bool = False) -> None:
        if kind in (1, 2):
            self.at += element  # a field's value is its type
        elif kind == 3:
            self.at += 1
        elif kind in (4, 5, 6):
            self._varint()
        elif kind == 7:
            self.at += 8
        elif kind == 8:
            length = self._varint()  # which moves the place itself
            self.at += length
        elif kind in (9, 10):
            head = self._byte()
            for _ in range(self._count(head >> 4)):
                self._skip(head & 15, depth + 1, element=True)
        elif kind == 12:
            self.structure(depth + 1)
        else:
            raise ValueError(f"a page header has a field of type {kind}")

    def _count(self, short: int) -> int:
        count = self._varint() if short == 15 else short
        if count > len(self._data):
            raise ValueError("a list in a page header is longer than the header")
        return count

    def _byte(self) -> int:
        if self.at >= len(self._data):
            raise ValueError("a page header is cut off")
        self.at += 1
        return self._data[self.at - 1]

    def _varint(self) -> int:
        value, shift = 0, 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value
            if shift > 63:
                raise ValueError("a number in a page header has no end")

    def _integer(self) -> int:
        zigzag = self._varint()
        return zigzag >> 1 ^ -(zigzag & 1)
