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


def count(events: Sequence[Event], pixels: Sequence[Pixel], polarity: bool = False) -> list[int]:
    """Events at each selected pixel; with polarity, the OFF counts follow the ON counts."""
    slot_of = {pixel: slot for slot, pixel in enumerate(pixels)}
    counts = [0] * (len(pixels) * (2 if polarity else 1))
    for _, x, y, p in events:
        if (x, y) in slot_of:
            counts[slot_of[x, y] + (len(pixels) if polarity and not p else 0)] += 1
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


def without_bursts_so_far(events, slot_us, pixels, share):
    """Drop each event at which more than `share` of all pixels have fired in its slot and the one
    before it, counted up to this event."""
    kept = []
    for i, event in enumerate(events):
        slot = event[0] // slot_us
        seen = {e[1:3] for e in events[: i + 1] if e[0] // slot_us in (slot - 1, slot)}
        if len(seen) * share[1] <= pixels * share[0]:
            kept.append(event)
    return kept


def hot_pixels(totals: Matrix, factor: int) -> list[Pixel]:
    """Pixels with more than `factor` times the events of their neighbourhood, and of the mean.

    The neighbourhood is the 5 x 5 square around the pixel, cut at the border, without the pixel;
    its events are the upper median plus one.
    """
    height, width = len(totals), len(totals[0])
    everything = sum(map(sum, totals))
    found = []
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
                found.append((x, y))
    return found


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
    found = having = 0
    for j in range(len(distances[0])):
        nearest = sorted(range(len(distances)), key=lambda k: (distances[k][j], k))[:n]
        found += any(correct[k][j] for k in nearest)
        having += any(row[j] for row in correct)
    return found, having


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
    found, level = [], logs[0]
    for step in range(1, len(logs)):
        move = logs[step] - level
        threshold = on if move >= on else -off if -move >= off else 0.0
        n = int(move / threshold) if threshold else 0
        found += [(step, level, k * threshold, threshold > 0) for k in range(1, n + 1)]
        level += n * threshold
    return found


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


def online_match(
    places: Matrix, lags: Matrix, exclusion: int, recent: int = 0
) -> tuple[int, int, int, int]:
    """Best and second place where the sequence can end now, and their summed distances."""
    length = len(lags)
    ends = range(length - 1, len(places) - recent)
    sums = [sum(sad(places[k - i], lags[i]) for i in range(length)) for k in ends]
    best, second, _ = best_and_second(sums, exclusion)
    if second < 0:
        return best + length - 1, sums[best], -1, -1
    return best + length - 1, sums[best], second + length - 1, sums[second]


@cache
def log_level(count: int) -> int:
    """``round(256 log2(1 + count))``, decided in integers: 2**(2r-1) <= (1+count)**512."""
    level = round(256 * math.log2(1 + count))
    candidates = range(max(level - 2, 0), level + 3)
    return max(r for r in candidates if r == 0 or 2 ** (2 * r - 1) <= (1 + count) ** 512)


def own_mean_codes(
    counts: Sequence[int], means: Sequence[int], bits: int, full_scale: int, contrast: bool = False
) -> list[int]:
    """Octaves of each count of a window above its counter's mean, saturated, plus half the range.

    With contrast, less the mean of the window too, rounded.
    """
    half, above = 2 ** (bits - 1), []
    for count, mean in zip(counts, means, strict=True):
        above.append(log_level(min(count, full_scale)) - mean)
    shared = (2 * sum(above) + len(above)) // (2 * len(above)) if contrast else 0
    return [min(max((a - shared + 128) // 256, -half), half - 1) + half for a in above]


def running_means(
    levels: Sequence[int], mean: int, begin: tuple[int, int] | None = None
) -> list[int]:
    """Mean of one counter's logarithms before each window, and after the last.

    It begins at `mean` with window 0, or with a total of 65,536 an octave and a later window.
    """
    total, first = begin or (256 * mean, 0)
    means = []
    for w, level in enumerate([*levels, 0], first):
        means.append((total + 128) // 256)
        total += (256 * level - total) // 2 ** min(int(math.log2(16 + w)), 8)
    return means


def log_activity(events: int) -> int:
    """``floor(16 log2(1 + events))`` of up to 2**23 - 1 events."""
    return int((min(events, 2**23 - 1) + 1) ** 16).bit_length() - 1


def activity(events: int, usual: int) -> int:
    """Logarithm of a window's events less that of the usual number; the lowest without events."""
    return log_activity(events) - log_activity(usual // 256) if events else -368


def is_pause(events: int, usual: int) -> bool:
    """Whether a window has no event, or less than 1/16 of the usual number."""
    return events == 0 or 16 * 256 * events < usual


def usual_after(usual: int, events: int) -> int:
    """Usual number of events, times 256, after a window."""
    return usual + (256 * min(events, 2**23 - 1) - usual) // 64


#: octaves of spread, and the speed and share of each step, by the number of places per window
STEPS = {
    1: (1.2, [(0.3, 0.2), (1, 0.6), (2, 0.19), (3, 0.01)]),
    2: (0.9, [(0.3, 0.1), (0.5, 0.25), (1, 0.3), (1.5, 0.25), (2, 0.1), (2.5, 0.002), (3, 0.001)]),
}


@cache
def step_costs(row: int, per_window: int = 1) -> list[int]:
    """Costs of steps of 0, 1 ... places where the activity is ``row / 2 - 6`` octaves higher.

    A share of the steps is expected to be of each, with so many octaves of activity.
    """
    spread, steps = STEPS[per_window]
    costs = {}
    for each in range(17):
        costs[each] = [
            (each / 2 - 6 - math.log2(speed)) ** 2 / 2 / spread**2 - math.log(share)
            for speed, share in steps
        ]
    lowest = min(map(min, costs.values()))
    lower = max(min(costs[row]) - lowest - 1, 0)  # the cheapest step costs 1 at most
    return [round(4 * (cost - lowest - lower)) for cost in costs[row]]


Costs = dict[int, int]


def costs_to(
    places: Sequence[int],
    now: int,
    forward: Sequence[int] | None,
    back: Sequence[int],
    per_window: int = 1,
) -> list[Costs]:
    """Costs of the steps that reach each place in a window; `places` and `now` are activities."""
    costs = {-1 - i: 4 * cost for i, cost in enumerate(back)}
    if forward is not None:
        return [costs | {i: 4 * cost for i, cost in enumerate(forward)} for _ in places]
    rows = [min(max((now - place + 4) // 8, -12), 4) + 12 for place in places]
    return [costs | dict(enumerate(step_costs(row, per_window))) for row in rows]


def steps_that_follow(
    forward: Sequence[int] | None, back: Sequence[int], per_window: int = 1
) -> Costs:
    """Steps after which a match follows from the one before."""
    last = 3 * per_window if forward is None else max(len(forward) - 1, 2 * per_window)
    return dict.fromkeys(range(-len(back), last + 1), 0)


def place_filter(
    distances: Matrix,
    events: Sequence[int],
    forward: Sequence[int] | None,
    back: Sequence[int],
    restart: int,
    exclusion: int,
    usual: int,
    begin: tuple[list[int], int, int, int, list[int]] | None = None,
    jumps: Sequence[tuple[int, int]] = (),
    along: Sequence[int] = (),
    travelled: Sequence[int | None] = (),
    places: Sequence[int] = (),
    per_window: int = 1,
    weights: Sequence[int] = (),
) -> list[tuple[list[int], int, int, int]]:
    """Metrics, best, second and trust after each window; ``distances[j]`` are those of window j.

    `places` are the activities of the places; without `forward`, costs depend on them. `weights`
    limit those of the evidence where the distance travelled is known. It goes on from `begin`:
    metrics, scale (0: none yet), place and support of a window before, and the residuals of it and
    the one before it.
    """
    k = len(distances[0])
    metric, scale, last, support, residuals = begin or ([0] * k, 0, None, 0, [])
    matches = []
    for j, d in enumerate(distances):
        least, driven = min(metric), travelled[j] if travelled else None
        now = activity(events[j], usual)
        transitions = transitions_by_steps(
            costs_to(places or [0] * k, now, forward, back, per_window), jumps
        )
        if driven is not None:
            transitions = transitions_by_odometry(along, driven, jumps, per_window)
        predicted = [
            min([4 * restart] + [metric[i] - least + c for i, to, c in transitions if to == place])
            for place in range(k)
        ]
        if j == 0 and begin is None:
            predicted = [0] * k
        evidence, scale = evidence_of(d, events[j], usual, scale, weights[j] if weights else 8)
        metric = [min(p + e, 1023) for p, e in zip(predicted, evidence, strict=True)]
        usual = usual_after(usual, events[j])
        best, second, _ = best_and_second(metric, exclusion)
        margin = metric[second] - metric[best] if second >= 0 else 1023
        if driven is None:
            transitions = transitions_by_steps(
                [steps_that_follow(forward, back, per_window)] * k, jumps
            )
        follows = any((i, to) == (last, best) and c < 4 * restart for i, to, c in transitions)
        support = next_support(support if follows else 0, margin, best == last)
        residuals, last = [*residuals, evidence[best]][-3:], best
        matches.append((metric, best, second, trust(support, residuals)))
    return matches


def evidence_of(
    distances: Sequence[int], events: int, usual: int, scale: int, most: int = 8
) -> tuple[list[int], int]:
    """Evidence against each place, and the scale of the next window; 0 if there is none yet.

    `most` limits its weight.
    """
    if is_pause(events, usual):
        return [0] * len(distances), scale
    mean = sum(distances) // len(distances)
    own = 65536 // max(sum(abs(d - mean) for d in distances) // len(distances), 1)
    weight = min(max((activity(events, usual) + 48) // 2, 0), most)
    least = min(distances)  # scaled by the spread of the window before, up to 2**16
    return [min((d - least) * (scale or own) // 2**14, 255) * weight // 8 for d in distances], own


def next_support(kept: int, margin: int, stands: bool) -> int:
    """Running mean of 16 times the margins, of at most 23 each."""
    risen = kept + (16 * min(margin, 23) - kept) // 4
    # the same view again says nothing new
    return min(risen, kept - kept // 16) if stands else risen


def trust(support: int, residuals: Sequence[int]) -> int:
    """Support of a match, less 16 times the worst evidence against it in three windows."""
    return max(support - 16 * min(max(residuals), 23), 0)


def typical(places: Sequence[Sequence[int]]) -> list[int]:
    """Mean distance of each place to all places, less the mean of these means."""
    mean = [sum(sad(a, b) for b in places) // len(places) for a in places]
    return [m - sum(mean) // len(mean) for m in mean]


def misfits_of_windows(
    distances: Matrix,
    events: Sequence[int],
    usual: int,
    matched: Sequence[int],
    typical_of: Sequence[int],
    weights: Sequence[int] = (),
) -> list[int | None]:
    """Evidence against each match, less its advantage over the mean place; None in pauses."""
    scale, misfits = 0, []
    most_of = weights or [8] * len(events)
    for d, count, best, most in zip(distances, events, matched, most_of, strict=True):
        whole = min(max((activity(count, usual) + 48) // 2, 0), 8)
        weight = min(whole, most)
        before, (evidence, scale) = scale, evidence_of(d, count, usual, scale, most)
        factor = 0 if is_pause(count, usual) else (before or scale) * weight
        usual = usual_after(usual, count)
        nearer = typical_of[best] * factor // 2**17
        # a short distance makes evidence count less, but no view fit any worse
        share = 8 * weight // whole if factor else 8
        against = evidence[best] * 8 // share
        advantage = (sum(evidence) // len(evidence) - evidence[best] + nearer) * 8 // share
        misfit = min(against, 23) - min(max(advantage, -23), 23)
        misfits.append(misfit if factor else None)
    return misfits


def misfit(of_windows: Sequence[int | None]) -> list[int]:
    """Running mean of 16 times the misfits of windows, above that of a usual drive."""
    mean, misfits = -80 * 16, []
    for one in of_windows:
        mean += 0 if one is None else (256 * one - mean) // 16
        misfits.append(max(mean // 16 + 80, 0))
    return misfits


def net_trust(trust_of: int, misfit_of: int) -> int:
    """What the probability of a match depends on; sequences have no misfit, which is -1."""
    return trust_of if misfit_of < 0 else min(trust_of, 368) - 4 * misfit_of


def smoothed_misfit(of_windows: Sequence[int | None]) -> list[int]:
    """Mean of 16 times the misfits of 33 windows, above that of a usual drive."""
    misfits = []
    for j in range(len(of_windows)):
        known = [one for one in of_windows[max(j - 16, 0) : j + 17] if one is not None]
        misfits.append(max(16 * sum(known) // len(known) + 80, 0) if known else 0)
    return misfits


def smoothed_filter(
    distances: Matrix,
    events: Sequence[int],
    forward: Sequence[int] | None,
    back: Sequence[int],
    restart: int,
    usual: int,
    jumps: Sequence[tuple[int, int]],
    along: Sequence[int],
    travelled: Sequence[int | None],
    places: Sequence[int] = (),
    per_window: int = 1,
    weights: Sequence[int] = (),
) -> tuple[list[list[int]], list[set[tuple[int, int]]], list[list[int]]]:
    """Forward metric of each window plus the cost of the best path on from each place.

    And the pairs of places that may follow each other up to each window, and its evidence.
    """
    k, scale, evidence, transitions, follow = len(distances[0]), 0, [], [], []
    given = (
        forward,
        back,
        restart,
        0,
        usual,
        None,
        jumps,
        along,
        travelled,
        places,
        per_window,
        weights,
    )
    most_of = weights or [8] * len(events)
    metrics = [metric for metric, *_ in place_filter(distances, events, *given)]
    for d, count, driven, most in zip(distances, events, travelled, most_of, strict=True):
        some, scale = evidence_of(d, count, usual, scale, most)
        evidence.append(some)
        steps = costs_to(places or [0] * k, activity(count, usual), forward, back, per_window)
        steps, known = transitions_by_steps(steps, jumps), []
        if driven is not None:
            steps = known = transitions_by_odometry(along, driven, jumps, per_window)
        transitions.append(steps)
        usual = usual_after(usual, count)
        follows = steps_that_follow(forward, back, per_window)
        known = known or transitions_by_steps([follows] * k, jumps)
        follow.append({(i, to) for i, to, c in known if c < 4 * restart})
    onward, summed = [0] * k, []
    for j in reversed(range(len(distances))):
        summed.append([m + o for m, o in zip(metrics[j], onward, strict=True)])
        cost = [e + o for e, o in zip(evidence[j], onward, strict=True)]
        onward = [
            min(
                [4 * restart]
                + [cost[to] - min(cost) + c for i, to, c in transitions[j] if i == place]
            )
            for place in range(k)
        ]
    return summed[::-1], follow, evidence


def smoothed_trust(
    place: Sequence[int],
    margin: Sequence[int],
    follow: Sequence[set[tuple[int, int]]],
    evidence: Matrix,
) -> list[int]:
    """Mean of 16 times the margin over 9 windows, without those behind a jump.

    It is reduced by 16 times the worst evidence against a match in the 9 windows, and each margin
    before by a sixteenth for each other window in a row at the same place.
    """
    residual = [row[best] for row, best in zip(evidence, place, strict=True)]
    scaled = []
    for j, best in enumerate(place):
        begin = end = j
        while begin > 0 and place[begin - 1] == best:
            begin -= 1
        while end + 1 < len(place) and place[end + 1] == best:
            end += 1
        value = 16 * margin[j]
        for _ in range(end - begin):
            value -= value // 16
        scaled.append(value)
    trust = []
    for j in range(len(place)):
        first = last = j
        while first > max(j - 4, 0) and (place[first - 1], place[first]) in follow[first]:
            first -= 1
        while last < min(j + 4, len(place) - 1) and (
            (place[last], place[last + 1]) in follow[last + 1]
        ):
            last += 1
        mean = sum(scaled[first : last + 1]) // 9
        trust.append(max(mean - 16 * max(residual[max(j - 4, 0) : j + 5]), 0))
    return trust


def delayed_trust(
    place: Sequence[int],
    margin: Sequence[int],
    follow: Sequence[set[tuple[int, int]]],
    evidence: Matrix,
) -> list[int]:
    """Trust of the place filter, of margins and places that later windows have changed."""
    trusts, support, residuals = [], 0, []
    for j, best in enumerate(place):
        last = place[j - 1] if j else None
        kept = support if (last, best) in follow[j] else 0
        support = next_support(kept, margin[j], best == last)
        residuals = [*residuals, evidence[j][best]][-3:]
        trusts.append(trust(support, residuals))
    return trusts


def transitions_by_steps(
    costs: Sequence[Costs], jumps: Sequence[tuple[int, int]]
) -> list[tuple[int, int, int]]:
    """Place, place after one window, and cost; a jump is one step, others lead up to it and on.

    `costs` are those of the steps that reach each place.
    """
    transitions = [
        (to - step, to, cost)
        for to, steps in enumerate(costs)
        for step, cost in steps.items()
        if 0 <= to - step < len(costs)
    ]
    for a, b in jumps:
        transitions += [
            (i, to, costs[to][a - i + 1 + to - b])
            for i in range(a + 1)
            for to in range(b, len(costs))
            if a - i + 1 + to - b in costs[to]
        ]
    return transitions


def counted_distances(along: Sequence[int], driven: Sequence[int | None]) -> list[int | None]:
    """What counts of the distances between readings: short ones once they add up to a place."""
    spacing = (along[-1] - along[0]) // (len(along) - 1)
    counted: list[int | None] = []
    held = 0
    for distance in driven:
        held = 0 if distance is None else held + distance
        if distance is None:
            counted.append(None)
        elif 2 * abs(distance) < spacing and abs(held) < spacing:
            counted.append(0)
        else:
            counted.append(held)
            held = 0
    return counted


def weights_by_distance(
    along: Sequence[int], driven: Sequence[int | None], per_window: int
) -> list[int]:
    """Largest weights of evidence: shares of a window's distance of the map, in eighths."""
    window = (along[-1] - along[0]) // (len(along) - 1) * per_window
    return [8 if d is None else min((8 * abs(d) + window - 1) // window, 8) for d in driven]


def transitions_by_odometry(
    along: Sequence[int], travelled: int, jumps: Sequence[tuple[int, int]], per_window: int = 1
) -> list[tuple[int, int, int]]:
    """Place, place after a known distance, and cost: 2 for each mean distance of a window off."""
    places = len(along)
    spacing = (along[-1] - along[0]) // (places - 1)
    rate = 2 * 4 * 2**16 // (spacing * per_window)
    transitions = [
        (i, k, abs(along[k] - along[i] - travelled) * rate // 2**16)
        for i in range(places)
        for k in range(places)
    ]
    for a, b in jumps:
        for i in range(max(a - 7, 0), a + 1):
            for k in range(b, min(b + 8, places)):
                length = along[a] - along[i] + spacing + along[k] - along[b]
                transitions.append((i, k, abs(length - travelled) * rate // 2**16))
    return transitions


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

    found = [[correlation(a, b) for b in levels(windows)] for a in levels(places)]
    return [
        max(
            mean([found[k + i][j + i] for i in range(length)])
            for k in range(len(places) - length + 1)
        )
        for j in range(len(windows) - length + 1)
    ]
