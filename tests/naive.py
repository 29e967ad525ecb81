"""The one oracle: every step of the method in plain Python, short enough to be believed.

Nothing here is fast and nothing is imported from the project. Kernels and streams are held to
these functions to the bit. Events are tuples ``(t, x, y, p)``; a descriptor is a list of counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import pairwise

Event = tuple[int, int, int, bool]
Pixel = tuple[int, int]
Matrix = list[list[int]]


def count(events: Sequence[Event], pixels: Sequence[Pixel]) -> list[int]:
    """Events at each selected pixel."""
    slot_of = {pixel: slot for slot, pixel in enumerate(pixels)}
    counts = [0] * len(pixels)
    for _, x, y, _ in events:
        if (x, y) in slot_of:
            counts[slot_of[x, y]] += 1
    return counts


def sad(a: Sequence[int], b: Sequence[int]) -> int:
    """Sum of absolute differences of two descriptors (method.md section 4)."""
    return sum(abs(int(i) - int(j)) for i, j in zip(a, b, strict=True))


def distance_matrix(reference: Sequence[Sequence[int]], query: Sequence[Sequence[int]]) -> Matrix:
    """``D[k][j]``: row = reference place, column = query."""
    return [[sad(place, descriptor) for descriptor in query] for place in reference]


def fixed_time_windows(events: Sequence[Event], tau: int) -> list[list[Event]]:
    """Cut into windows ``[k tau, (k+1) tau)``; the last, not known to be complete, is dropped."""
    if not events:
        return []
    windows: list[list[Event]] = [[] for _ in range(events[-1][0] // tau + 1)]
    for event in events:
        windows[event[0] // tau].append(event)
    return windows[:-1]


def unseen_halves(times: Sequence[int], tau: int, windows: int, end: int) -> list[int]:
    """Of each window, the halves of a window without an event that are known within it.

    Of a gap, the first is known once a quarter has passed, and the others, rounded up, at its end.
    """
    half, quarter = max(tau // 2, 1), max(tau // 4, 1)
    halves, before = [0] * windows, 0
    for i, t in enumerate([*times, end]):
        if t - before >= quarter:
            halves[(before + quarter) // tau] += 1
            if i < len(times):
                halves[t // tau] += math.ceil((t - before) / half) - 1
        before = t
    return halves


def fixed_count_windows(
    events: Sequence[Event], pixels: Sequence[Pixel], n: int
) -> list[list[Event]]:
    """Close a window with its `n`-th event at a selected pixel; drop the unfinished last one."""
    windows, window, seen = [], [], 0
    for event in events:
        window.append(event)
        seen += (event[1], event[2]) in pixels
        if seen == n:
            windows.append(window)
            window, seen = [], 0
    return windows


def without_bursts(
    events: Sequence[Event], slot_us: int, pixels_of_sensor: int, share: tuple[int, int]
) -> list[Event]:
    """Remove two neighbouring time slots where together more than the share of all pixels fired."""
    fired: dict[int, set[Pixel]] = {}
    for t, x, y, _ in events:
        fired.setdefault(t // slot_us, set()).add((x, y))
    removed = set()
    for slot, pixels in fired.items():
        union = fired.get(slot - 1, set()) | pixels
        if len(union) * share[1] > share[0] * pixels_of_sensor:
            removed |= {slot - 1, slot}
    return [event for event in events if event[0] // slot_us not in removed]


def hot_pixels(totals: Matrix, factor: int) -> list[Pixel]:
    """Pixels with more than `factor` times the events of their neighbourhood, and of the mean.

    The neighbourhood is the 5 x 5 square around the pixel, cut at the border, without the pixel;
    its events are the upper median plus one.
    """
    height, width = len(totals), len(totals[0])
    everything = sum(map(sum, totals))
    hot = []
    for y in range(height):
        for x in range(width):
            around = sorted(
                totals[v][u]
                for v in range(max(0, y - 2), min(height, y + 3))
                for u in range(max(0, x - 2), min(width, x + 3))
                if (u, v) != (x, y)
            )
            median = around[len(around) // 2] if around else 0
            above_mean = totals[y][x] * width * height > factor * everything
            if above_mean and totals[y][x] > factor * (median + 1):
                hot.append((x, y))
    return hot


@cache  # powers of a thousand digits
def counter_code(kind: str, bits: int, full_scale: int, count: int) -> int:
    """Code of a count, the nearest, from the middle up; compared in integers alone."""
    top, c = min(2**bits - 1, full_scale), min(count, full_scale)

    def reaches(half: int) -> bool:
        """Whether the exact code is at least half of `half`."""
        if kind == "linear":
            return 2 * top * c >= half * full_scale
        if kind == "sqrt":
            return 4 * top * top * c >= half * half * full_scale
        return (1 + c) ** (2 * top) >= (1 + full_scale) ** half

    return max(code for code in range(top + 1) if code == 0 or reaches(2 * code - 1))


def usual_full_scale(counts: Sequence[int]) -> int:
    """Least ``2**n - 1``, n from 1 to 16, that nine of ten counts do not exceed."""
    scales = [2**n - 1 for n in range(1, 17)]
    held = [f for f in scales if 10 * sum(c <= f for c in counts) >= 9 * len(counts)]
    return held[0] if held else scales[-1]


def variance(counts: Sequence[int]) -> float:
    """Population variance of one pixel's counts (paper, eq. 3), rounded to a float once."""
    k = len(counts)
    return (k * sum(c * c for c in counts) - sum(counts) ** 2) / (k * k)


def draw(weights: Sequence[float], u: float) -> int:
    """Index whose share of the running sum holds ``u * total``."""
    running, total = [], 0.0
    for weight in weights:
        total += weight
        running.append(total)
    return next(i for i, upto in enumerate(running) if u * total < upto)


def select_pixels(
    saliency: Sequence[Sequence[float]], j: int, sigma: float, draws: Sequence[float]
) -> list[Pixel]:
    """Draw `j` pixels, each draw suppressing its surround by an inverse Gaussian (paper, III-B)."""
    width = len(saliency[0])
    p = [value for row in saliency for value in row]
    chosen = []
    for u in draws[:j]:
        flat = draw(p, u)
        x, y = flat % width, flat // width
        chosen.append((x, y))
        for i in range(len(p)):
            dx, dy = i % width - x, i // width - y
            p[i] *= 1.0 - gauss(dx, sigma) * gauss(dy, sigma)
    return chosen


def gauss(d: int, sigma: float) -> float:
    """Gaussian of peak 1."""
    return math.exp(-d * d / (2.0 * sigma * sigma))


def sequence_sums(distances: Matrix, length: int) -> Matrix:
    """``sum_{i<L} D[k+i][j+i]``: L times D_seq (method.md section 5), in integers."""
    k, q = len(distances), len(distances[0])
    return [
        [sum(distances[a + i][b + i] for i in range(length)) for b in range(q - length + 1)]
        for a in range(k - length + 1)
    ]


def best_and_second(distances: Sequence[int], exclusion: int) -> tuple[int, int, int]:
    """Best place (ties: lowest), best outside ``+-exclusion`` of it (-1: none), further ties."""
    best = distances.index(min(distances))
    outside = [k for k in range(len(distances)) if abs(k - best) > exclusion]
    second = min(outside, key=lambda k: (distances[k], k)) if outside else -1
    return best, second, distances.count(distances[best]) - 1


def precision_recall(
    scores: Sequence[float], correct: Sequence[bool], has_place: Sequence[bool], denominator: str
) -> list[tuple[int, int, int]]:
    """Counts ``(tp, fp, fn)`` at each distinct threshold, ascending: accept ``score <= threshold``.

    fn = rejected queries whose best match was correct ("rejected-correct", the released code), or
    queries that have a true place and did not get it ("all-with-place").
    """
    points = []
    for threshold in sorted(set(scores)):
        accepted = [s <= threshold for s in scores]
        tp = sum(a and c for a, c in zip(accepted, correct, strict=True))
        fp = sum(a and not c for a, c in zip(accepted, correct, strict=True))
        if denominator == "rejected-correct":
            fn = sum(c and not a for a, c in zip(accepted, correct, strict=True))
        else:
            fn = sum(has_place) - tp
        points.append((tp, fp, fn))
    return points


def recall_at(distances: Matrix, correct: list[list[bool]], n: int) -> tuple[int, int]:
    """Queries with a true place among the `n` nearest (ties: lowest), and queries with one."""
    recalled = having = 0
    for j in range(len(distances[0])):
        nearest = sorted(range(len(distances)), key=lambda k: (distances[k][j], k))[:n]
        recalled += any(correct[k][j] for k in nearest)
        having += any(row[j] for row in correct)
    return recalled, having


def interpolate(
    points: Sequence[tuple[int, float]], x: int, max_gap: int | None = None
) -> float | None:
    """Straight line between two neighbouring points; unknown (None) outside and in long gaps."""
    for (x0, y0), (x1, y1) in pairwise(points):
        if x0 < x < x1 and (max_gap is None or x1 - x0 <= max_gap):
            return y0 + (x - x0) / (x1 - x0) * (y1 - y0)
    return dict(points).get(x)


def distance(kind: str, a: Sequence[float], b: Sequence[float]) -> float:
    """Metres: straight, or between degrees of latitude and longitude on a sphere (by its chord)."""
    if kind == "metric":
        return math.dist(a, b)
    if math.isnan(sum(a) + sum(b)):
        return math.nan
    p, q = (
        (math.cos(v) * math.cos(w), math.cos(v) * math.sin(w), math.sin(v))
        for v, w in (map(math.radians, a), map(math.radians, b))
    )
    return 2 * 6_371_008.8 * math.asin(math.dist(p, q) / 2)


def pixel_crossings(
    logs: Sequence[float], on: float, off: float
) -> list[tuple[int, float, float, bool]]:
    """One simulated pixel: (step, remembered level, rise from there to the crossing, ON)."""
    crossings, level = [], logs[0]
    for step in range(1, len(logs)):
        move = logs[step] - level
        threshold = on if move >= on else -off if -move >= off else 0.0
        n = int(move / threshold) if threshold else 0
        crossings += [(step, level, k * threshold, threshold > 0) for k in range(1, n + 1)]
        level += n * threshold
    return crossings


def pixel_events(
    light: Sequence[float], times: Sequence[int], on: float, off: float, refractory: int
) -> list[tuple[int, bool]]:
    """Time and polarity of one simulated pixel's events, the logarithm a line between two times."""
    logs = [math.log(value) for value in light]
    events: list[tuple[int, bool]] = []
    for step, level, rise, polarity in pixel_crossings(logs, on, off):
        was, now, start = logs[step - 1], logs[step], times[step - 1]
        share = (level + rise - was) / (now - was) if now != was else 1.0
        t = start + int((times[step] - start) * min(max(share, 0.0), 1.0))
        if not events or t - events[-1][0] >= refractory:
            events.append((t, polarity))
    return events


def lagged_counts(
    selected: Sequence[tuple[int, int]], until: int, length: int, slots: int, tau: int, n: int
) -> Matrix:
    """Counts of the newest window and the `length - 1` before it, newest first.

    `selected` holds ``(t, slot)`` of the events at selected pixels so far. Windows are of `tau`
    microseconds, ``[until - (i+1) tau, until - i tau)``, or of `n` events where `tau` is 0.
    """
    lags = [[0] * slots for _ in range(length)]
    for age, (t, slot) in enumerate(reversed(selected)):
        lag = (until - 1 - t) // tau if tau else age // n
        if lag < length:
            lags[lag][slot] += 1
    return lags


def online_match(places: Matrix, lags: Matrix, exclusion: int) -> tuple[int, int, int, int, int]:
    """Best and second place where the sequence can end now, their summed distances, and ties."""
    length = len(lags)
    ends = range(length - 1, len(places))
    sums = [sum(sad(places[k - i], lags[i]) for i in range(length)) for k in ends]
    best, second, ties = best_and_second(sums, exclusion)
    if second < 0:
        return best + length - 1, sums[best], -1, -1, ties
    return best + length - 1, sums[best], second + length - 1, sums[second], ties


def isotonic(values: Sequence[float], weights: Sequence[float]) -> list[float]:
    """The rising fit of least squares: the largest over a of the least over b of the mean a..b."""

    def mean(a: int, b: int) -> float:
        total = sum(v * w for v, w in zip(values[a : b + 1], weights[a : b + 1], strict=True))
        return total / sum(weights[a : b + 1])

    n = len(values)
    return [max(min(mean(a, b) for b in range(i, n)) for a in range(i + 1)) for i in range(n)]


def auroc(higher: Sequence[int], lower: Sequence[int]) -> float:
    """Share of pairs in which one of `higher` is above one of `lower`; a tie is half a pair."""
    wins = sum((a > b) + (a == b) / 2 for a in higher for b in lower)
    return wins / (len(higher) * len(lower))


def calibration_error(probability: Sequence[float], correct: Sequence[bool], bins: int) -> float:
    """Mean over all matches of the gap between probability and share of right ones, by bin."""
    error = 0.0
    for number in range(bins):
        inside = [
            (p, c)
            for p, c in zip(probability, correct, strict=True)
            if min(int(p * bins), bins - 1) == number
        ]
        error += abs(sum(c for _, c in inside) - sum(p for p, _ in inside))
    return error / len(probability)


def likeness(
    places: Sequence[Sequence[int]], windows: Sequence[Sequence[int]], length: int
) -> list[float]:
    """Of each sequence of windows, the mean correlation with the most similar one of places.

    Correlated are logarithms in 1/16 octave, less each counter's mean.
    """

    def levels(rows: Sequence[Sequence[int]]) -> list[list[int]]:
        logs = [[round(256 * math.log2(1 + min(c, 1023))) for c in row] for row in rows]
        means = [math.floor(sum(column) / len(column) + 0.5) for column in zip(*logs, strict=True)]
        return [[(v - m) // 16 for v, m in zip(row, means, strict=True)] for row in logs]

    def correlation(a: Sequence[int], b: Sequence[int]) -> float:
        n = len(a)
        spread = [math.sqrt(n * sum(v * v for v in c) - sum(c) ** 2) for c in (a, b)]
        cross = n * sum(u * v for u, v in zip(a, b, strict=True)) - sum(a) * sum(b)
        return cross / (spread[0] * spread[1]) if all(spread) else 0.0

    def mean(values: Sequence[float]) -> float:
        total = 0.0
        for value in values:  # sum() rounds otherwise from Python 3.12 on
            total += value
        return total / len(values)

    correlations = [[correlation(a, b) for b in levels(windows)] for a in levels(places)]
    return [
        max(
            mean([correlations[k + i][j + i] for i in range(length)])
            for k in range(len(places) - length + 1)
        )
        for j in range(len(windows) - length + 1)
    ]
