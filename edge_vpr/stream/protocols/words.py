"""Streams of words of one size with no frame around them, and where a word begins in them.

Nothing marks the beginning, so that it is found by what words must look like. A reader that has
lost its place tries every offset over the next words and takes the one where most look right.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Sensor
from edge_vpr.recordings.source import Columns
from edge_vpr.stream.gate import Clock
from edge_vpr.stream.protocols.protocol import Decoder

Raw = npt.NDArray[np.uint8]

#: Words looked at to find the place.
SEARCH_WORDS = 32


class WordDecoder(Decoder):
    """A decoder of words of `size` bytes.

    Parameters
    ----------
    sensor : Sensor
    clock : Clock
    size : int
        Bytes a word.
    search_words : int
        Words that decide between two offsets.
    notice_words : int
        A shifted stream is noticed within so many words.
    """

    def __init__(
        self,
        sensor: Sensor,
        clock: Clock,
        size: int,
        *,
        search_words: int = SEARCH_WORDS,
        notice_words: int = 4,
    ) -> None:
        super().__init__(sensor, clock)
        self._size = size
        self._search_words = search_words
        self._searching = True
        self.resync_bytes = (2 * search_words + notice_words + 1) * size

    @abstractmethod
    def _good(self, raw: Raw) -> npt.NDArray[np.bool_]:
        """Tell of each word whether it looks right after the one before it.

        `raw` is whole words from one offset on; nothing is remembered.
        """

    @abstractmethod
    def _usable(self, raw: Raw) -> int:
        """Count the words before the first one that shows the place to be lost."""

    @abstractmethod
    def _columns(self, raw: Raw) -> Columns:
        """Decode whole words; the columns are new arrays, or valid until the next call."""

    def _lose_sync(self) -> None:
        self._searching = True

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        raw = np.frombuffer(data, dtype=np.uint8)
        size, at, parts = self._size, 0, []
        while True:
            if self._searching:
                if raw.size - at < (self._search_words + 1) * size and not final:
                    break
                if raw.size - at < size:
                    break
                skip = self._search(raw[at:])
                at += skip
                self.health.skipped_bytes += skip
                if self._searching:
                    continue
            words = (raw.size - at) // size
            whole = raw[at : at + words * size]
            used = self._usable(whole)
            if used:
                columns = self._columns(whole[: used * size])
                # a later part overwrites what the columns lie in
                parts.append(columns if used == words else _copied(columns))
            at += used * size
            if used == words:
                break
            self.health.resyncs += 1
            self._searching = True
        return parts, data[at:]

    def _search(self, raw: Raw) -> int:
        """Find how many bytes to skip to the next word; stay lost if it is nowhere near."""
        size = self._size
        words = min(self._search_words, raw.size // size)
        # the first byte from which a word looks right at all
        first = min(raw.size, words * size)
        candidates = []
        for offset in range(size):
            n = min(words, (raw.size - offset) // size)
            if n == 0:
                break
            stretch = raw[offset : offset + n * size]
            good = self._good(stretch)
            if good.any():
                first = min(first, offset + int(good.argmax()) * size)
            # random bytes look right less often than this, and damaged words more often
            if good[0] and int(good.sum()) * 4 >= n * 3:
                candidates.append((self._pace(stretch), -int(good.sum()) * words // n, offset))
        if candidates:
            self._searching = False
            return min(candidates)[2]
        return first if first > 0 else min(raw.size, max(1, words // 2) * size)

    def _pace(self, raw: Raw) -> float:
        """Tell how fast time runs if words begin here; a shifted reading makes it run faster."""
        return 0.0


def _copied(columns: Columns) -> Columns:
    return Columns(*(np.array(column) for column in columns))


def assemble(raw: Raw, size: int, *, big: bool) -> npt.NDArray[Any]:
    """Join bytes to unsigned words of up to 64 bits."""
    if size in (2, 4, 8):
        words: npt.NDArray[Any] = raw.view(np.dtype(f"{'>' if big else '<'}u{size}"))
        return words.astype(np.uint64)
    columns = raw.reshape(-1, size)
    words = np.zeros(len(columns), dtype=np.uint64)
    for i in range(size):
        shift = 8 * (size - 1 - i if big else i)
        words |= columns[:, i].astype(np.uint64) << np.uint64(shift)
    return words
