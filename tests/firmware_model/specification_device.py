"""A device in plain Python, written from docs/specification.md alone.

It imports nothing of the project. Names and numbers of sections are those of the page, and there is
no other way of computing anything: where a case of the vectors differs, the page or the model is
wrong.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

Row = list[int]
Record = tuple[str, Row]
#: origins, target and cost
Transitions = list[tuple[int, int, int]]
NONE = -1

#: section 6, step 1: f[0] to f[3] of the rows, and f[0] to f[6] with two places per window
ROWS = (
    (4, 24, 47, 71), (4, 22, 43, 66), (4, 20, 39, 61), (4, 17, 36, 57), (4, 15, 32, 52),
    (4, 12, 28, 48), (4, 10, 24, 43), (4, 7, 20, 38), (4, 5, 17, 34), (4, 3, 13, 30),
    (5, 1, 10, 26), (7, 0, 8, 22), (9, 0, 6, 20), (11, 0, 5, 18), (15, 1, 5, 17), (19, 3, 5, 16),
    (22, 4, 4, 15),
)  # fmt: skip
HALF_ROWS = (
    (4, 17, 44, 63, 80, 107, 120), (4, 15, 39, 57, 73, 100, 111), (4, 14, 35, 51, 67, 92, 103),
    (4, 12, 31, 45, 60, 84, 95), (4, 10, 26, 40, 53, 77, 87), (4, 8, 22, 34, 46, 69, 79),
    (4, 6, 18, 28, 40, 62, 70), (4, 4, 14, 22, 33, 54, 62), (5, 3, 10, 17, 27, 47, 55),
    (5, 1, 6, 11, 20, 40, 46), (6, 1, 2, 7, 14, 33, 39), (8, 1, 1, 4, 10, 28, 34),
    (12, 3, 0, 2, 7, 24, 29), (17, 6, 1, 1, 5, 22, 26), (23, 11, 2, 1, 4, 20, 24),
    (30, 16, 6, 3, 5, 20, 23), (37, 21, 8, 4, 5, 20, 22),
)  # fmt: skip


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
        self.filters, self.contrast = d["matching"] == "filter", d["code"] == "contrast"
        self.own = d["code"] in ("own-mean", "contrast")
        self.pixels = {(x, y): j for j, (x, y) in enumerate(table(folder, "pixels"))}
        self.slots = d["pixels"] * (2 if d["polarity"] else 1)
        self.top = max(d["full_scales"])
        codes, self.tables = words(folder, "codes"), words(folder, "code_tables")
        size = self.top + 1
        self.codes = [codes[n : n + size] for n in range(0, len(codes), size)]
        self.places = table(folder, "places")
        bytes_ = words(folder, "place_activity") if d["activity_costs"] else []
        self.place_activity = [byte - 256 if byte > 127 else byte for byte in bytes_]
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
        self.support, self.residuals = 0, (0, 0)

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
        counted, pause, activity = self.counted, False, 0
        if self.filters or self.own:
            pause, activity = pause_and_activity(counted, self.usual)
        entries = [self.codes[n][v] for n, v in zip(self.tables, self.counters, strict=True)]
        codes = self.own_means(entries) if self.own else entries
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
        match = self.filtered(codes, activity, pause) if self.filters else self.sequence(codes)
        if match is not None:
            yield "match", [self.window, *match]
        self.window += 1

    def own_means(self, levels: Row) -> Row:
        """Section 4."""
        half = 1 << (self.design["code_bits"] - 1)
        d = [level - ((m + 128) >> 8) for level, m in zip(levels, self.means, strict=True)]
        g = (2 * sum(d) + self.slots) // (2 * self.slots) if self.contrast else 0
        octaves = [(one - g + 128) >> 8 for one in d]
        return [min(max(one, -half), half - 1) + half for one in octaves]

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
        return [*self.places_of(sums, best, second, ties), int(self.accepted(sums, best, second))]

    def filtered(self, codes: Row, activity: int, pause: bool) -> Row:
        """Section 6."""
        places = range(len(self.places))
        predicted = [0] * len(places)
        if self.place is not None:
            transitions = transitions_by_steps(
                self.design, len(places), activity, self.place_activity
            )
            predicted = predict(self.metrics, transitions, 4 * self.design["restart"])
        against = [0] * len(places)
        if not pause:
            distances = self.distances(codes)
            against, self.reciprocal = evidence(distances, self.reciprocal, activity)
        self.metrics = [min(p + e, 1023) for p, e in zip(predicted, against, strict=True)]
        metric = dict(enumerate(self.metrics))
        best, second, ties = search(metric, self.design["exclusion"])
        follows = self.place is not None and within_steps(self.design, best - self.place)
        margin = 1023 if second is None else metric[second] - metric[best]
        self.support = support_after(self.support if follows else 0, margin, best == self.place)
        residual = min(against[best], 23)
        trust = max(self.support - 16 * max(residual, *self.residuals), 0)
        self.place, self.residuals = best, (residual, self.residuals[0])
        accepted = trust >= self.design["trust"] and self.accepted(metric, best, second)
        return [*self.places_of(metric, best, second, ties), int(accepted), trust]

    @staticmethod
    def places_of(metric: dict[int, int], best: int, second: int | None, ties: int) -> Row:
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


def pause_and_activity(counted: int, usual: int) -> tuple[bool, int]:
    """Section 3, step 1."""
    if counted == 0:
        return True, -368
    return counted * 256 * 16 < usual, ilog(min(counted, (1 << 23) - 1)) - ilog(usual >> 8)


def ilog(n: int) -> int:
    """Section 3, step 1, without roots: (n + 1)^16 against powers of 2."""
    e = (n + 1).bit_length() - 1
    return 16 * e + sum((n + 1) ** 16 >= 1 << (16 * e + i) for i in range(1, 16))


def costs_of(design: dict[str, Any], activity: int, place: int) -> dict[int, int]:
    """Section 6, step 1: cost of each step to a place of this activity, with fraction bits."""
    if design["activity_costs"]:
        row = min(max((activity - place + 4) >> 3, -12), 4) + 12
        rows = HALF_ROWS if design["activity_costs"] == 2 else ROWS
        forward = dict(enumerate(rows[row]))
    else:
        forward = {i: 4 * cost for i, cost in enumerate(design["steps"])}
    return forward | {-i: 4 * cost for i, cost in enumerate(design["back"], 1)}


def transitions_by_steps(
    design: dict[str, Any],
    places: int,
    activity: int,
    place_activity: Sequence[int],
    jumps: Sequence[tuple[int, int]] = (),
) -> Transitions:
    """Section 6, step 1; section 10, jumps."""
    transitions = []
    for k in range(places):
        of_place = place_activity[k] if design["activity_costs"] else 0
        for step, cost in costs_of(design, activity, of_place).items():
            if 0 <= k - step < places:
                transitions.append((k - step, k, cost))
            for a, b in jumps:
                o = k - b
                if 0 <= o < step and a - (step - 1 - o) >= 0:
                    transitions.append((a - (step - 1 - o), k, cost))
    return transitions


def predict(metrics: Row, transitions: Transitions, restart: int) -> Row:
    """Section 6, step 1."""
    predicted, least = [restart] * len(metrics), min(metrics)
    for j, k, cost in transitions:
        predicted[k] = min(predicted[k], metrics[j] - least + cost)
    return predicted


def evidence(
    distances: Row, reciprocal: int | None, activity: int, most: int = 8
) -> tuple[Row, int]:
    """Section 6, step 2: evidence, and the R of the next window; `most` is of section 10."""
    mean = sum(distances) // len(distances)
    spread = max(sum(abs(d - mean) for d in distances) // len(distances), 1)
    own, least = 65_536 // spread, min(distances)
    scale = own if reciprocal is None else reciprocal
    weight = min(max((activity + 48) >> 1, 0), most)
    return [(min(((d - least) * scale) >> 14, 255) * weight) >> 3 for d in distances], own


def last_step(design: dict[str, Any]) -> int:
    """Section 6, step 4."""
    if design["activity_costs"]:
        return 6 if design["activity_costs"] == 2 else 3
    return max(len(design["steps"]), 3) - 1


def within_steps(design: dict[str, Any], step: int) -> bool:
    """Section 6, step 4."""
    return -len(design["back"]) <= step <= last_step(design)


def support_after(kept: int, margin: int, stands: bool) -> int:
    """Section 6, step 4."""
    support = kept + ((16 * min(margin, 23) - kept) >> 2)
    return min(support, kept - (kept >> 4)) if stands else support


class Drive:
    """Section 10: a drive of n windows on a computer, by the rest of the drive too.

    `distances` of each window to each place, its number of events, and the distance driven before
    it; None if not known.
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
        place_activity: Sequence[int] = (),
    ) -> None:
        self.design, self.jumps, self.along = design, jumps, along
        self.driven = driven or [None] * len(distances)
        self.metrics: list[Row] = []
        self.evidence: list[Row] = []
        self.transitions: list[Transitions] = []
        reciprocal, places = None, len(distances[0])
        for w, row in enumerate(distances):
            pause, activity = pause_and_activity(counted[w], usual)
            usual += (min(counted[w], (1 << 23) - 1) * 256 - usual) >> 6
            driven = self.driven[w]
            by_steps = transitions_by_steps(design, places, activity, place_activity, jumps)
            self.transitions.append(by_steps if driven is None else self.by_odometry(driven))
            against = [0] * places
            if not pause:
                most = 8 if driven is None else self.most_weight(driven)
                against, reciprocal = evidence(row, reciprocal, activity, most)
            predicted = [0] * places
            if w:
                predicted = predict(self.metrics[-1], self.transitions[w], 4 * design["restart"])
            self.metrics.append([min(p + e, 1023) for p, e in zip(predicted, against, strict=True)])
            self.evidence.append(against)

    def spacing(self) -> tuple[int, bool]:
        """Mean distance between two places, and whether these are at half windows."""
        last = len(self.along) - 1
        spacing = (self.along[last] - self.along[0]) // max(last, 1)
        return spacing, self.design["activity_costs"] == 2

    def most_weight(self, driven: int) -> int:
        """Return the largest weight of the evidence, by the whole distance driven."""
        spacing, half_windows = self.spacing()
        window = spacing * 2 if half_windows else spacing
        return min((8 * abs(driven) + window - 1) // window, 8)

    def by_odometry(self, driven: int) -> Transitions:
        """Return all transitions, with their costs by the distance driven."""
        along, last = self.along, len(self.along) - 1
        spacing, half_windows = self.spacing()
        rate = (1 << (18 if half_windows else 19)) // spacing

        def cost(length: int) -> int:
            return (abs(length - driven) * rate) >> 16

        every = range(last + 1)
        transitions = [(j, k, cost(along[k] - along[j])) for j in every for k in every]
        for a, b in self.jumps:
            for j in range(max(a - 7, 0), a + 1):
                for k in range(b, min(b + 7, last) + 1):
                    length = along[a] - along[j] + spacing + along[k] - along[b]
                    transitions.append((j, k, cost(length)))
        return transitions

    def whole(self, w: int, last: int) -> Row:
        """Cost of the whole path through each place in window w."""
        onward = [0] * len(self.metrics[0])
        for v in range(last, w, -1):
            total = [e + g for e, g in zip(self.evidence[v], onward, strict=True)]
            mirrored = [(k, j, cost) for j, k, cost in self.transitions[v]]
            onward = predict(total, mirrored, 4 * self.design["restart"])
        return [m + g for m, g in zip(self.metrics[w], onward, strict=True)]

    def follows(self, w: int, before: int, place: int) -> bool:
        """Return whether a match of window w follows the one before."""
        if self.driven[w] is not None:
            restart = 4 * self.design["restart"]
            return any(
                (j, k) == (before, place) and cost < restart for j, k, cost in self.transitions[w]
            )
        if within_steps(self.design, place - before):
            return True
        return any(
            a >= before and place >= b and (a - before) + (place - b) < last_step(self.design)
            for a, b in self.jumps
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
        alike = [len(list(same)) for _, same in groupby(best for best, _, _ in found)]
        row = [size for size in alike for _ in range(size)]
        terms = []
        for size, (_, _, margin) in zip(row, found, strict=True):
            term = 16 * margin
            for _ in range(size - 1):
                term -= term >> 4
            terms.append(term)
        matches = []
        for w, (best, metric, _) in enumerate(found):
            first, last = w, w
            while first > max(w - 4, 0) and chained[first]:
                first -= 1
            while last < min(w + 4, n - 1) and chained[last + 1]:
                last += 1
            margins = sum(terms[first : last + 1])
            near = range(max(w - 4, 0), min(w + 4, n - 1) + 1)
            residual = max(self.evidence[v][found[v][0]] for v in near)
            matches.append((best, metric, max(margins // 9 - 16 * residual, 0)))
        return matches

    def delayed(self, delay: int) -> list[tuple[int, int, int]]:
        """Place, cost and trust of each window, so many windows late; 0: as section 6."""
        support, residuals, matches, before = 0, (0, 0), [], None
        found = self.matches(lambda w: min(w + delay, len(self.metrics) - 1))
        for w, (best, metric, margin) in enumerate(found):
            follows = before is not None and self.follows(w, before, best)
            support = support_after(support if follows else 0, margin, best == before)
            residual = min(self.evidence[w][best], 23)
            matches.append((best, metric, max(support - 16 * max(residual, *residuals), 0)))
            before, residuals = best, (residual, residuals[0])
        return matches
