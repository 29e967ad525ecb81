"""What a map or a state that was accepted must give, held to plain Python."""

from __future__ import annotations

from pathlib import Path

import filter_oracle
import naive
import numpy as np
from streams import descriptors, random_events, with_sums

from edge_vpr.archive import read_archive
from edge_vpr.confidence import default_confidence
from edge_vpr.descriptors.codes import codes_of
from edge_vpr.descriptors.counting import window_of
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import EdgeVprError
from edge_vpr.events import TIME_LIMIT_US, Sensor, make_events
from edge_vpr.live.protocols.aer import Field, Layout, LayoutEncoder
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.online.localiser import Localiser
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from firmware_model.specification_drive import confidence_of

Rows = list[list[int]]


def check_loaded_map(reference: ReferenceMap) -> None:
    """Match made-up windows and events, and compare with plain Python."""
    settings = reference.settings
    rng = np.random.default_rng(1)
    counters = reference.places.counts.shape[1]
    queries = rng.integers(0, 6, (6, counters))
    queries[rng.random(6) < 0.3] = 0  # pauses
    coded = _query_codes(reference, queries.tolist())
    events = queries.sum(axis=1)
    counted = descriptors(queries)
    given = reference.coded(
        Descriptors(counted.counts, counted.start_us, counted.end_us, counted.events, events)
    )
    assert given.counts.tolist() == coded
    try:
        found = match_descriptors(
            reference.places, given, settings, reference.confidence, jumps=reference.jumps
        )
    except EdgeVprError:
        assert _cannot_match(reference, len(queries))
    else:
        _compare_matches(reference, found, coded, events.tolist())
        _compare_route(reference, found)
    try:
        localiser = Localiser(reference)
    except EdgeVprError:
        return
    _follow(localiser, reference, [], 0, 0, rng)


def check_loaded_state(localiser: Localiser, path: Path) -> None:
    """Go on from a state, and compare with plain Python."""
    arrays, meta = read_archive(path, "localiser state")
    selected = list(zip(arrays["time"].tolist(), arrays["slot"].tolist(), strict=True))
    nothing = np.zeros(len(arrays["places"]), dtype=np.int64)
    reference = ReferenceMap(
        localiser.settings,
        PixelMap(Sensor(*meta["sensor"]), arrays["pixel_x"], arrays["pixel_y"]),
        Descriptors(arrays["places"], nothing, nothing, nothing, arrays.get("activity")),
        np.zeros(meta["sensor"][::-1], dtype=np.float32),
        np.zeros(meta["sensor"][::-1], dtype=np.bool_),
        arrays.get("full_scale"),
        arrays.get("mean"),
        jumps=arrays.get("jumps"),
    )
    before = int(arrays["bound"][0]) - len(selected)
    begin = None
    if localiser.settings.matching == "filter":
        begin = filter_oracle.resumed(arrays)
    _compare(localiser, reference, selected, meta["now_us"], before, begin)
    rng = np.random.default_rng(2)
    _follow(
        localiser, reference, selected, meta["floor_us"], before, rng, meta["recent"], begin
    )  # fmt: skip


def _query_codes(reference: ReferenceMap, counted: Rows) -> Rows:
    if reference.own_mean_code is None:
        return [_coded(reference, row) for row in counted]
    settings = reference.settings
    at_once = settings.matching == "filter" and not settings.smooth
    if settings.query_mean == "running" or (settings.query_mean == "auto" and at_once):
        begin = filter_oracle.begin_of(reference)
        return filter_oracle.running_codes(reference, counted, begin)
    return filter_oracle.codes_of_drive(reference, counted)


def _cannot_match(reference: ReferenceMap, queries: int) -> bool:
    """Whether a sequence is too long, or the precision beyond what the table promises."""
    settings = reference.settings
    if settings.windows_per_match > min(len(reference), queries):
        return True
    return bool(settings.precision) and _least_trust(reference) is None


def _table(reference: ReferenceMap) -> list[tuple[int, float, int]] | None:
    found, settings = reference.confidence, reference.settings
    if found is None and settings.matching == "filter":
        found = default_confidence(settings.smooth, settings.match_delay, settings.stays_on_map)
    if found is None:
        return None
    return list(
        zip(found.trust.tolist(), found.probability.tolist(), found.matches.tolist(), strict=True)
    )


def _least_trust(reference: ReferenceMap) -> int | None:
    """Least trust from which on matches are as precise as is wanted; None if there is none."""
    table = _table(reference) or []
    for i in range(len(table)):
        matches = sum(n for _, _, n in table[i:])
        share = sum(p * n for _, p, n in table[i:]) / matches
        if abs(share - reference.settings.precision) < 1e-9:
            share = reference.settings.precision  # rounded in another order
        if share >= reference.settings.precision:
            return table[i][0] if i else -TIME_LIMIT_US
    return None


def _compare_matches(
    reference: ReferenceMap, found: Matches, coded: Rows, events: list[int]
) -> None:
    settings, places = reference.settings, reference.places.counts.tolist()
    if settings.matching == "filter":
        if settings.smooth or settings.match_delay:
            rows = filter_oracle.smoothed(reference, coded, events)
        else:
            begin = filter_oracle.begin_of(reference)
            rows = filter_oracle.filtered(reference, coded, events, begin)
    else:
        length = settings.sequence_length
        sums = naive.sequence_sums(naive.distance_matrix(places, coded), length)
        offset = length // 2 if settings.anchor == "middle" else length - 1
        rows = []
        for i in range(len(found)):
            column = [row[i] for row in sums]
            best, second, ties = naive.best_and_second(column, settings.exclusion)
            assert found.ties[i] == ties
            least = column[second] if second >= 0 else -1
            trust = least - column[best] if second >= 0 else 0
            named = second + offset if second >= 0 else -1
            rows.append((best + offset, column[best], named, least, trust))
    names = ("place", "distance_sum", "second", "second_sum", "trust")
    assert list(zip(*(getattr(found, name).tolist() for name in names), strict=True)) == rows
    _compare_judged(reference, found)


def _compare_judged(reference: ReferenceMap, found: Matches) -> None:
    table, wanted = _table(reference), reference.settings.precision
    columns = found.trust, found.misfit, found.probability, found.lost
    for trust, misfit, p, gone in zip(*(column.tolist() for column in columns), strict=True):
        value = confidence_of(trust, misfit)
        if table is None:
            assert p != p and not gone
            continue
        reached = [step for step in table if step[0] <= value] or table[:1]
        assert p == reached[-1][1]
        assert gone == (bool(wanted) and value < _least_trust(reference))


def _compare_route(reference: ReferenceMap, found: Matches) -> None:
    """Hold the intervals along the route to a search of the known places."""
    if reference.route is None:
        return
    within = filter_oracle.zone_of(reference.settings)
    located = reference.route.locate(found.place, within)
    along = reference.route.along_m.tolist()
    for i, place in enumerate(found.place.tolist()):
        known = [a for a in along[max(place - within, 0) : place + within + 1] if a == a]
        ends = (known[0], known[-1]) if known else (np.nan, np.nan)
        found_ends = (located.from_m[i], located.to_m[i])
        assert np.array_equal(found_ends, ends, equal_nan=True)
        assert np.array_equal(located.along_m[i], along[place], equal_nan=True)


def _follow(
    localiser: Localiser,
    reference: ReferenceMap,
    selected: list[tuple[int, int]],
    floor_us: int,
    before: int,
    rng: np.random.Generator,
    recent: int = 0,
    begin: filter_oracle.Begin | None = None,
) -> None:
    """Feed events at selected pixels one by one, each compared with the oracle's."""
    pixels, settings = reference.pixel_map, reference.settings
    window = window_of(settings)
    tau = getattr(window, "tau_us", 0)
    step = min(max(tau // 3, 1), 10**6)
    t = floor_us
    filtered = settings.matching == "filter"
    if filtered and begin is None:
        begin = filter_oracle.begin_of(reference)
    for _ in range(10):
        t += int(rng.integers(0, step + 1))
        j, p = int(rng.integers(len(pixels))), bool(rng.integers(2))
        try:
            matches = localiser.update(make_events([t], [pixels.x[j]], [pixels.y[j]], [p]))
        except EdgeVprError:
            assert t > 2**59 or localiser.every.interval_us
            return
        selected.append((t, j if p or not settings.polarity else j + len(pixels)))
        _compare(localiser, reference, selected, t + 1, before, begin)
        every, length = localiser.every, settings.windows_per_match
        if every.interval_us or every.change:
            continue
        number = before + len(selected)
        whole = t + 1 >= length * tau if tau else number >= length * window.events  # type: ignore[union-attr]
        assert len(matches) == (whole and number % every.events == 0)
        if not len(matches):
            continue
        names: tuple[str, ...] = ("place", "distance", "second", "second_distance")
        if begin is not None:
            ended = t // tau if tau else (number - 1) // window.events  # type: ignore[union-attr]
            coded, events = _coded_windows(reference, selected, t + 1, before, begin, ended)
            expected = filter_oracle.filtered(reference, coded, events, begin)[-1]
            names += ("trust",)
        else:
            lags = _lags(settings, selected, t + 1, reference.places.counts.shape[1])
            coded = [_coded(reference, lag) for lag in lags]
            places = reference.places.counts.tolist()
            expected = naive.online_match(places, coded, settings.exclusion, recent)
        found = with_sums(matches, settings.windows_per_match)[0]
        assert tuple(int(found[name]) for name in names) == expected


def _coded_windows(
    reference: ReferenceMap,
    selected: list[tuple[int, int]],
    until: int,
    before: int,
    begin: filter_oracle.Begin,
    ended: int,
) -> tuple[Rows, list[int]]:
    """Codes and events of the windows that ended since `begin`, and of the newest."""
    settings, counters = reference.settings, reference.places.counts.shape[1]
    window = window_of(settings)
    counted = []
    for w in range(begin.windows, ended):
        if settings.window == "time":
            span = [slot for t, slot in selected if t // window.tau_us == w]  # type: ignore[union-attr]
        else:
            first = w * window.events - before  # type: ignore[union-attr]
            span = [slot for _, slot in selected[first : first + window.events]]  # type: ignore[union-attr]
        counted.append([span.count(slot) for slot in range(counters)])
    counted += _lags(settings, selected, until, counters)[:1]
    if reference.own_mean_code is not None:
        coded = filter_oracle.running_codes(reference, counted, begin)
    else:
        coded = [_coded(reference, row) for row in counted]
    return coded, [sum(row) for row in counted]


def _lags(settings: Settings, selected: list[tuple[int, int]], until: int, counters: int) -> Rows:
    window, length = window_of(settings), settings.windows_per_match
    tau = getattr(window, "tau_us", 0)
    n = 0 if tau else window.events  # type: ignore[union-attr]
    return naive.lagged_counts(selected, until, length, counters, tau, n)


def _compare(
    localiser: Localiser,
    reference: ReferenceMap,
    selected: list[tuple[int, int]],
    until: int,
    before: int,
    begin: filter_oracle.Begin | None,
) -> None:
    """Hold counters and all distances to the oracle."""
    settings, places = reference.settings, reference.places.counts.tolist()
    lags = _lags(settings, selected, until, len(places[0]))
    assert localiser.counts.tolist() == lags
    if begin is None or reference.own_mean_code is None:
        coded = [_coded(reference, lag) for lag in lags]
    else:
        window = window_of(settings)
        # of the windows whose end was reached, also by the last event
        ended = begin.windows
        if settings.window == "count":
            ended = (before + len(selected)) // window.events  # type: ignore[union-attr]
        elif selected:
            ended = max(ended, selected[-1][0] // window.tau_us)  # type: ignore[union-attr]
        windows, _ = _coded_windows(reference, selected, until, before, begin, ended)
        coded = windows[-1:]
    length = settings.windows_per_match
    sums = [
        sum(naive.sad(places[k - i], coded[i]) for i in range(length))
        for k in range(length - 1, len(places))
    ]
    assert localiser.distance_sums.tolist() == sums


def _coded(reference: ReferenceMap, counts: list[int]) -> list[int]:
    """Code counts by the oracle; by the tables where it would take minutes."""
    settings = reference.settings
    if settings.counter_code == "none":
        return [min(c, settings.clip) for c in counts] if settings.clip else counts
    codes = codes_of(settings, len(counts), reference.full_scale)
    assert codes is not None
    if settings.counter_bits > 6 or max(code.full_scale for code in codes.codes) > 300:
        return codes.encode(np.array(counts)).tolist()
    scales = [codes.codes[row].full_scale for row in codes.row.tolist()]
    return [
        naive.counter_code(settings.counter_code, settings.counter_bits, scale, count)
        for scale, count in zip(scales, counts, strict=True)
    ]


def check_layout(layout: Layout) -> None:
    """Encode events in words of a layout, and take the words apart bit by bit."""
    sensor = Sensor(min(1 << layout.x.bits, 50), min(1 << layout.y.bits, 40))
    events = random_events(np.random.default_rng(4), 30, sensor, 900)
    events["t"] = events["t"] // layout.tick_us * layout.tick_us
    raw = LayoutEncoder("a layout", layout, sensor).encode(events)
    assert len(raw) == 30 * layout.size
    for i, (t, x, y, p) in enumerate(events.tolist()):
        order = "big" if layout.big else "little"
        word = int.from_bytes(raw[i * layout.size : (i + 1) * layout.size], order)
        assert word & layout.sync_mask == layout.sync_value

        def field(of: Field, word: int = word) -> int:
            return word >> of.shift & ((1 << of.bits) - 1)

        assert (field(layout.x), field(layout.y)) == (x, y)
        assert not layout.p.bits or (field(layout.p) == 1) == (p != layout.off_is_one)
        assert field(layout.t) == t // layout.tick_us % (1 << layout.t.bits)
