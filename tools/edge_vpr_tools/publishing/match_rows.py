"""Conversion of live matches to rows of JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from edge_vpr.matching.matches_csv import ALONG
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.stream.live import LiveResult


class MatchRows:
    """Makes rows of live matches.

    Parameters
    ----------
    reference : ReferenceMap, optional
        With positions, each row has that of its place. With a delay, each row has the host time
        of its own window.
    """

    def __init__(self, reference: ReferenceMap | None = None) -> None:
        self._names: tuple[str, ...] = ()
        self._where: list[list[float | None]] = []
        self._late = reference is not None and reference.settings.late > 0
        self._texts: dict[int, str] = {}  # of `_where`, made when a place is first matched
        if reference is not None and reference.route is not None:
            route = reference.route
            found = route.locate(np.arange(len(reference)), reference.settings.exclusion)
            columns = (*found.position.T, found.along_m, found.from_m, found.to_m)
            self._names = (*route.coordinates, *ALONG)
            self._where = [
                [_or_none(value) for value in place] for place in np.stack(columns, axis=1).tolist()
            ]

    def lines(self, result: LiveResult, host_us: int) -> Iterator[str]:
        """Yield the row of each match as JSON, without a line feed.

        A reader waits for each row, and `json.dumps` would take three times as long.

        Parameters
        ----------
        result : LiveResult
        host_us : int
            When the bytes came that gave these matches, in microseconds since 1970 by the clock of
            this machine; `t` is the time of the event by the camera's.

        Yields
        ------
        str
            What is not known is null: JSON has no not-a-number.
        """
        incomplete = _FLAG[result.incomplete]
        for values in result.matches.tolist():
            t, place, best_sum, second, second_sum, ratio, events, start, trust, chance, lost = (
                values
            )
            came_us = host_us - (result.reached_us - t) * self._late
            yield (
                f'{{"kind": "match", "t": {t}, "place": {place}, "distance_sum": {best_sum}, '
                f'"second": {second}, "second_sum": {second_sum}, "ratio": {_number(ratio)}, '
                f'"events": {events}, "start": {start}, "trust": {trust}, '
                f'"probability": {_number(chance)}, "lost": {_FLAG[lost]}, '
                f'"incomplete": {incomplete}, "host_us": {came_us}'
                f"{self._where_text(place) if self._where else ''}}}"
            )

    def _where_text(self, place: int) -> str:
        text = self._texts.get(place)
        if text is None:
            where = dict(zip(self._names, self._where[place], strict=True))
            text = self._texts[place] = f", {json.dumps(where)[1:-1]}"
        return text


#: As JSON has it.
_FLAG = {True: "true", False: "false"}


def _number(value: float) -> str:
    return repr(value) if value == value else "null"


def _or_none(value: float) -> float | None:
    return value if value == value else None
