"""A device in plain Python, written from docs/specification.md alone.

It imports nothing of the project. Names and numbers of sections are those of the page, and there is
no other way of computing anything: where a case of the vectors differs, the page or the model is
wrong.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

Row = list[int]
Record = tuple[str, Row]
#: origins, target and cost
Ways = list[tuple[int, int, int]]
NONE = -1


def words(folder: Path, name: str) -> Row:
    return [int(line, 16) for line in (folder / f"{name}.mem").read_text("ascii").split()]


def table(folder: Path, name: str) -> list[Row]:
    with (folder / f"{name}.csv").open(encoding="ascii") as file:
        return [[int(value) for value in row] for row in list(csv.reader(file))[1:]]


class Device:
    """Section 1: what a device is given, from the folder of a case."""

    def __init__(self, folder: Path) -> None:
        self.design: dict[str, Any] = tomllib.loads((folder / "design.toml").read_text("ascii"))
        d = self.design
        self.filters, self.own = d["matching"] == "filter", d["code"] == "own-mean"
        self.pixels = {(x, y): j for j, (x, y) in enumerate(table(folder, "pixels"))}
        self.slots = d["pixels"] * (2 if d["polarity"] else 1)
        self.top = max(d["full_scales"])
        codes, self.tables = words(folder, "codes"), words(folder, "code_tables")
        size = self.top + 1
        self.codes = [codes[n : n + size] for n in range(0, len(codes), size)]
        self.places = table(folder, "places")
        # section 2
        self.counters, self.counted, self.window = [0] * self.slots, 0, 0
        self.events, self.period = 0, 1 << d["timestamp_bits"]
        self.end = (words(folder, "start")[0] + d["tau_us"]) % self.period
        # sections 3 and 4
        adaptive = self.filters or self.own
        self.usual = words(folder, "activity")[0] if adaptive else 0
        self.means = [256 * mean for mean in words(folder, "means")] if self.own else []
        self.w = 0
        self.history: list[Row] = []
        # section 6
        self.metrics: Row = []
        self.reciprocal: int | None = None
        self.place: int | None = None
        self.support, self.misfits = 0, (0, 0)

    def take(self, t: int, x: int, y: int, on: int) -> Iterator[Record]:
        """Section 2."""
        d = self.design
        if d["window"] == "time":
            while self.left(t) <= 0:
                yield from self.end_window()
                self.end = (self.end + d["tau_us"]) % self.period
        slot = self.pixels.get((x, y))
        if slot is not None and d["polarity"] and not on:
            slot += d["pixels"]
        count = 0
        if slot is not None:
            count = self.counters[slot] = min(self.counters[slot] + 1, self.top)
            self.counted += 1
        yield "event", [self.events, NONE if slot is None else slot, count]
        self.events += 1
        if d["window"] == "count" and slot is not None and self.counted == d["window_events"]:
            yield from self.end_window()

    def left(self, t: int) -> int:
        left = (self.end - t) % self.period
        return left - self.period if left >= self.period // 2 else left

    def end_window(self) -> Iterator[Record]:
        """Section 3."""
        counted, quiet, pause = self.counted, False, False
        if self.filters or self.own:
            quiet = counted == 0 or counted * 256 * 8 < self.usual
            pause = counted == 0 or counted * 256 * 16 < self.usual
        entries = [self.codes[n][v] for n, v in zip(self.tables, self.counters, strict=True)]
        codes = (
            [self.own_mean(j, level) for j, level in enumerate(entries)] if self.own else entries
        )
        yield "window", [self.window, self.events, *codes]
        if self.own and not pause:
            shift = min((16 + self.w).bit_length() - 1, 8)
            self.means = [
                m + ((256 * level - m) >> shift)
                for m, level in zip(self.means, entries, strict=True)
            ]
            self.w += 1
        self.usual += (min(counted, (1 << 23) - 1) * 256 - self.usual) >> 6
        self.counters, self.counted = [0] * self.slots, 0
        match = self.filtered(codes, quiet, pause) if self.filters else self.sequence(codes)
        if match is not None:
            yield "match", [self.window, *match]
        self.window += 1

    def own_mean(self, slot: int, level: int) -> int:
        """Section 4."""
        half = 1 << (self.design["code_bits"] - 1)
        octaves = (level - ((self.means[slot] + 128) >> 8) + 128) >> 8
        return min(max(octaves, -half), half - 1) + half

    def distances(self, codes: Row) -> Row:
        """Section 5."""
        return [sum(abs(a - b) for a, b in zip(codes, place, strict=True)) for place in self.places]

    def sequence(self, codes: Row) -> Row | None:
        """Section 5."""
        length = self.design["length"]
        self.history = [self.distances(codes), *self.history][:length]
        if len(self.history) < length:
            return None
        sums = {
            k: sum(self.history[i][k - i] for i in range(length))
            for k in range(length - 1, len(self.places))
        }
        best, second, ties = search(sums, self.design["exclusion"])
        return [*self.told(sums, best, second, ties), int(self.accepted(sums, best, second))]

    def filtered(self, codes: Row, quiet: bool, pause: bool) -> Row:
        """Section 6."""
        places = range(len(self.places))
        predicted = [0] * len(places)
        if self.place is not None:
            ways = ways_of_steps(self.design, len(places), quiet)
            predicted = predict(self.metrics, ways, 4 * self.design["restart"])
        against = [0] * len(places)
        if not pause:
            against, self.reciprocal = evidence(self.distances(codes), self.reciprocal)
        self.metrics = [min(p + e, 1023) for p, e in zip(predicted, against, strict=True)]
        metric = dict(enumerate(self.metrics))
        best, second, ties = search(metric, self.design["exclusion"])
        follows = self.place is not None and within_steps(self.design, best - self.place)
        margin = 1023 if second is None else metric[second] - metric[best]
        self.support = support_after(self.support if follows else 0, margin, best == self.place)
        misfit = min(against[best], 23)
        trust = max(self.support - 16 * max(misfit, *self.misfits), 0)
        self.place, self.misfits = best, (misfit, self.misfits[0])
        accepted = trust >= self.design["trust"] and self.accepted(metric, best, second)
        return [*self.told(metric, best, second, ties), int(accepted), trust]

    @staticmethod
    def told(metric: dict[int, int], best: int, second: int | None, ties: int) -> Row:
        """Section 9."""
        if second is None:
            return [best, metric[best], NONE, NONE, ties]
        return [best, metric[best], second, metric[second], ties]

    def accepted(self, metric: dict[int, int], best: int, second: int | None) -> bool:
        """Section 8."""
        if second is None:
            return False
        if self.design["accept"] == "margin":
            return bool(metric[second] - metric[best] >= self.design["margin"])
        n, d = self.design["ratio"]
        return metric[second] > 0 and bool(metric[best] * d <= metric[second] * n)


def search(metric: dict[int, int], zone: int) -> tuple[int, int | None, int]:
    """Section 7: best, second best and ties."""
    best = min(metric, key=lambda k: (metric[k], k))
    ties = sum(m == metric[best] for m in metric.values()) - 1
    outside = [k for k in metric if abs(k - best) > zone]
    second = min(outside, key=lambda k: (metric[k], k)) if outside else None
    return best, second, ties


def costs_of(design: dict[str, Any], quiet: bool) -> dict[int, int]:
    """Section 6, step 1: cost of each step, with fraction bits."""
    if quiet:
        return {0: 0, 1: 0, 2: 4}
    forward = {i: 4 * cost for i, cost in enumerate(design["steps"])}
    return forward | {-i: 4 * cost for i, cost in enumerate(design["back"], 1)}


def ways_of_steps(
    design: dict[str, Any], places: int, quiet: bool, jumps: Sequence[tuple[int, int]] = ()
) -> Ways:
    """Section 6, step 1; section 11, jumps."""
    ways = []
    for step, cost in costs_of(design, quiet).items():
        ways += [(j, j + step, cost) for j in range(places) if 0 <= j + step < places]
        for a, b in jumps:
            for o in range(step):
                if a - (step - 1 - o) >= 0 and b + o < places:
                    ways.append((a - (step - 1 - o), b + o, cost))
    return ways


def predict(metrics: Row, ways: Ways, restart: int) -> Row:
    """Section 6, step 1."""
    predicted, least = [restart] * len(metrics), min(metrics)
    for j, k, cost in ways:
        predicted[k] = min(predicted[k], metrics[j] - least + cost)
    return predicted


def evidence(distances: Row, reciprocal: int | None) -> tuple[Row, int]:
    """Section 6, step 2: evidence, and the R of the next window."""
    mean = sum(distances) // len(distances)
    spread = max(sum(abs(d - mean) for d in distances) // len(distances), 1)
    own, least = 65_536 // spread, min(distances)
    scale = own if reciprocal is None else reciprocal
    return [min(((d - least) * scale) >> 14, 255) for d in distances], own


def within_steps(design: dict[str, Any], step: int) -> bool:
    """Section 6, step 4."""
    return -len(design["back"]) <= step <= max(len(design["steps"]), 3) - 1


def support_after(kept: int, margin: int, stands: bool) -> int:
    """Section 6, step 4."""
    support = kept + ((16 * min(margin, 23) - kept) >> 2)
    return min(support, kept - (kept >> 4)) if stands else support


class Drive:
    """Section 11: a drive of n windows on a computer, by the rest of the drive too.

    `distances` of each window to each place, its number of events, and its way; None if not known.
    """

    def __init__(
        self,
        design: dict[str, Any],
        distances: Sequence[Row],
        counted: Row,
        usual: int,
        jumps: Sequence[tuple[int, int]] = (),
        along: Sequence[int] = (),
        driven: Sequence[int | None] = (),
        quiet_shift: int = 0,
    ) -> None:
        self.design, self.jumps, self.along = design, jumps, along
        self.driven = driven or [None] * len(distances)
        self.metrics: list[Row] = []
        self.evidence: list[Row] = []
        self.ways: list[Ways] = []
        reciprocal, places = None, len(distances[0])
        for w, row in enumerate(distances):
            quiet = counted[w] == 0 or counted[w] * 256 * 8 < usual
            pause = counted[w] == 0 or counted[w] * 256 * 16 < usual
            usual += (min(counted[w], (1 << 23) - 1) * 256 - usual) >> 6
            way = self.driven[w]
            by_steps = ways_of_steps(design, places, quiet, jumps)
            self.ways.append(by_steps if way is None else self.by_odometry(way))
            against = [0] * places
            if not pause:
                against, reciprocal = evidence(row, reciprocal)
            against = [e >> quiet_shift if quiet else e for e in against]
            predicted = [0] * places
            if w:
                predicted = predict(self.metrics[-1], self.ways[w], 4 * design["restart"])
            self.metrics.append([min(p + e, 1023) for p, e in zip(predicted, against, strict=True)])
            self.evidence.append(against)

    def by_odometry(self, driven: int) -> Ways:
        """Return all ways, with their costs by the distance driven."""
        along, last = self.along, len(self.along) - 1
        spacing = (along[last] - along[0]) // max(last, 1)
        rate = (1 << 19) // spacing

        def cost(way: int) -> int:
            return (abs(way - driven) * rate) >> 16

        every = range(last + 1)
        ways = [(j, k, cost(along[k] - along[j])) for j in every for k in every]
        for a, b in self.jumps:
            for j in range(max(a - 7, 0), a + 1):
                for k in range(b, min(b + 7, last) + 1):
                    way = along[a] - along[j] + spacing + along[k] - along[b]
                    ways.append((j, k, cost(way)))
        return ways

    def whole(self, w: int, last: int) -> Row:
        """Cost of the whole path through each place in window w."""
        onward = [0] * len(self.metrics[0])
        for v in range(last, w, -1):
            total = [e + g for e, g in zip(self.evidence[v], onward, strict=True)]
            mirrored = [(k, j, cost) for j, k, cost in self.ways[v]]
            onward = predict(total, mirrored, 4 * self.design["restart"])
        return [m + g for m, g in zip(self.metrics[w], onward, strict=True)]

    def follows(self, w: int, before: int, place: int) -> bool:
        """Return whether a match of window w follows the one before."""
        if self.driven[w] is not None:
            restart = 4 * self.design["restart"]
            return any((j, k) == (before, place) and cost < restart for j, k, cost in self.ways[w])
        if within_steps(self.design, place - before):
            return True
        last = max(len(self.design["steps"]), 3) - 1
        return any(
            a >= before and place >= b and (a - before) + (place - b) < last for a, b in self.jumps
        )

    def matches(self, last_of: Callable[[int], int]) -> list[tuple[int, int, int]]:
        """Best place, its cost and margin of each window."""
        found = []
        for w in range(len(self.metrics)):
            metric = dict(enumerate(self.whole(w, last_of(w))))
            best, second, _ = search(metric, self.design["exclusion"])
            margin = 1023 if second is None else metric[second] - metric[best]
            found.append((best, metric[best], margin))
        return found

    def smoothed(self) -> list[tuple[int, int, int]]:
        """Place, cost and trust of each window, by the whole drive."""
        n = len(self.metrics)
        found = self.matches(lambda _: n - 1)
        chained = [w > 0 and self.follows(w, found[w - 1][0], found[w][0]) for w in range(n)]
        told = []
        for w, (best, metric, _) in enumerate(found):
            first, last = w, w
            while first > max(w - 4, 0) and chained[first]:
                first -= 1
            while last < min(w + 4, n - 1) and chained[last + 1]:
                last += 1
            margins = sum(16 * margin for _, _, margin in found[first : last + 1])
            near = range(max(w - 4, 0), min(w + 4, n - 1) + 1)
            misfit = max(self.evidence[v][found[v][0]] for v in near)
            told.append((best, metric, max(margins // 9 - 16 * misfit, 0)))
        return told

    def delayed(self, delay: int) -> list[tuple[int, int, int]]:
        """Place, cost and trust of each window, so many windows late; 0: as section 6."""
        support, misfits, told, before = 0, (0, 0), [], None
        found = self.matches(lambda w: min(w + delay, len(self.metrics) - 1))
        for w, (best, metric, margin) in enumerate(found):
            follows = before is not None and self.follows(w, before, best)
            support = support_after(support if follows else 0, margin, best == before)
            misfit = min(self.evidence[w][best], 23)
            told.append((best, metric, max(support - 16 * max(misfit, *misfits), 0)))
            before, misfits = best, (misfit, misfits[0])
        return told
