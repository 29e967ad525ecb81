"""Words of one size without frames: how their beginning is found."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.events import Columns, Sensor
from edge_vpr.live.protocols import Clock, Decoder

# Nothing marks the beginning of a word; it is found from the properties of valid words. A decoder
# that is out of sync tries every offset over the next words, and takes the one with the most valid
# words.


Raw = npt.NDArray[np.uint8]

#: Number of words that are used to find the beginning.
SEARCH_WORDS = 32


class Reading(NamedTuple):
    """Quality of the words from one offset; all numbers are as a kernel returns them."""

    good: float  #: Number of valid words.
    first: float  #: Index of the first valid word; the number of words if there is none.
    #: How fast time runs, which is faster if the reading is shifted; 0 if words do not show it.
    pace: float = 0.0
    #: 1 if every word has the marks that words must have, whatever its time; else 0.
    marked: float = 0.0


class WordDecoder(Decoder):
    """Decoder of words of `size` bytes.

    Parameters
    ----------
    size : int
        Bytes of a word.
    search_words : int
        Number of words that decide between two offsets.
    notice_words : int
        Number of words within which a shifted stream is noticed.
    """

    def __init__(
        self,
        sensor: Sensor,
        clock: Clock,
        size: int,
        *,
        search_words: int = SEARCH_WORDS,
        notice_words: int,
    ) -> None:
        super().__init__(sensor, clock)
        self._size = size
        self._search_words = search_words
        self._searching = True
        # whether this search was counted; bytes before the first event of a device are no loss
        self._counted = True
        self.resync_bytes = (search_words + notice_words + 1) * size

    @abstractmethod
    def _readings(self, raw: Raw, most: int) -> list[Reading]:
        """Count the valid words of up to `most` from each offset, without changing the state."""

    @abstractmethod
    def _take_words(self, raw: Raw) -> tuple[int, Columns, bool]:
        """Decode words up to one that shows that the decoder is out of sync.

        Returns the number of words, their events (valid until the next call), and whether it is.
        """

    def _lose_sync(self) -> None:
        self._searching, self._counted = True, False

    def _decode(self, data: bytes, *, final: bool) -> tuple[list[Columns], bytes]:
        raw = np.frombuffer(data, dtype=np.uint8)
        size, at, parts = self._size, 0, []
        while True:
            if self._searching:
                needed = 1 if final else self._search_words + 1
                if raw.size - at < needed * size:
                    break
                skip = self._search(raw[at:])
                at += skip
                self.health.skipped_bytes += skip
                # a search that ends where it began has skipped nothing
                self.health.resyncs += skip > 0 and not self._counted
                self._counted |= skip > 0
                if self._searching:
                    continue
            words = (raw.size - at) // size
            used, columns, out_of_sync = self._take_words(raw[at : at + words * size])
            at += used * size
            if used == words:
                parts.append(columns)
                break
            if used:
                # the next words are decoded into the same memory
                parts.append(Columns(*(column.copy() for column in columns)))
            if out_of_sync:
                self._lose_sync()
        return parts, data[at:]

    def _search(self, raw: Raw) -> int:
        """Return the number of bytes to skip to the next word; go on searching if none is near."""
        size = self._size
        most = min(self._search_words, raw.size // size)
        # first byte at which any word is valid
        first = min(raw.size, most * size)
        readings = self._readings(raw, most)
        candidates = []
        for offset, reading in enumerate(readings):
            words = min(most, (raw.size - offset) // size)
            first = min(first, offset + int(reading.first) * size)
            # random bytes have a smaller share of valid words, damaged streams a larger one
            if reading.first == 0 and reading.good * 4 >= words * 3:
                candidates.append((reading.pace, -reading.good * most // words, offset))
        if candidates:
            self._searching = False
            return min(candidates)[2]
        if readings[0].marked:
            # the events are so rare that their times give no information
            self._searching = False
            return 0
        return first if first > 0 else min(raw.size, max(1, most // 2) * size)


@kernel
def word_at(raw, at, size, big):  # type: ignore[no-untyped-def]
    """Join `size` bytes to a word, as an unsigned integer of 64 bits."""
    word, eight = np.uint64(0), np.uint64(8)
    for i in range(size):
        word = word << eight | np.uint64(raw[at + (i if big else size - 1 - i)])
    return word
