"""Model of sequences: the distances of the last L windows are added along diagonals."""

from __future__ import annotations

from collections.abc import Iterator

from firmware_model.design import Design


class SequenceModel:
    """Keeps the distances of the last L windows to every place, and adds them up.

    ``sum[k] = distance[k] + distance one window ago[k - 1] + ...``, L terms. There is no sum before
    L windows are complete, nor for places below L - 1, whose diagonal leaves the map.

    Attributes
    ----------
    history : list of L lists of K int
        A ring of rows: row ``newest`` is of the window that ended last. What was not yet written
        is None: it is never added.
    newest : int
    seen : int
        Windows so far, at most L.
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        self.history: list[list[int | None]] = [
            [None] * design.places for _ in range(design.length)
        ]
        self.newest = 0
        self.seen = 0

    def next_window(self) -> None:
        """Begin another window, whose distances overwrite those of L windows ago."""
        self.newest = (self.newest + 1) % self.design.length
        self.seen = min(self.seen + 1, self.design.length)

    def steps(self, place: int, distance: int) -> Iterator[int | None]:
        """Store a distance, and yield the partial sums with those before it.

        Yields
        ------
        int or None
            The sum so far, in each of L cycles; the last is the sequence's. None if there is none.
        """
        self.history[self.newest][place] = distance
        complete = self.seen == self.design.length and place >= self.design.length - 1
        total = distance
        yield total if complete else None
        for ago in range(1, self.design.length):
            if complete:
                term = self.history[(self.newest - ago) % self.design.length][place - ago]
                assert term is not None, "a complete sequence has been written"
                total += term
            yield total if complete else None

    def sum(self, place: int, distance: int) -> int | None:
        """Store a distance; return the sum of the sequence that ends at this place."""
        *_, last = self.steps(place, distance)
        return last
