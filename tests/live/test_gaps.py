"""Time in which nothing was seen: lost frames, restarts of the camera, and cuts in a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge_vpr.descriptors.unseen import UnseenTime
from edge_vpr.descriptors.windows import FixedCount, FixedTime
from edge_vpr.events import join_events
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.stream_matcher import StreamMatcher
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair
from tests.streams import split_events

PIECE_US = 20_000
#: when nothing is seen, in seconds of the drive; without a gap, matches are accepted then
BEGIN_S = 30.0
#: seconds from a gap to the next match that is accepted, at most
SOON_S = 16.0


@pytest.fixture(scope="module")
def street():
    """A map that accepts at 0.99, another drive along it, and where that is."""
    first, second = simulate_pair(seed=0, length_m=400.0)
    reference = ReferenceMap.build(first, track=first.track)
    settings = replace(reference.settings, precision=0.99, smooth=False)
    track = second.track
    return (
        reference.matched_with(settings),
        join_events(list(second)),
        lambda time_us: np.interp(time_us, track.time_us, track.position[:, 0]),
    )


def live_matches(reference, events, device, restarts, gap_s):
    """Host's time, metres and acceptance of each match of a camera that is away for a while."""
    decoder = open_decoder(device, reference.pixel_map.sensor)
    decoder.live = True
    live = StreamMatcher(decoder, reference, MatchSchedule(interval_us=50_000))
    encoder, begun_us, rows = open_encoder(device, decoder.sensor), 0, []
    begins = np.arange(0, int(events["t"][-1]), PIECE_US)
    cuts = np.searchsorted(events["t"], begins[1:])
    for begin_us, part in zip(begins.tolist(), split_events(events, cuts), strict=True):
        piece, host_us = part.copy(), begin_us + PIECE_US
        away = 1e6 * BEGIN_S <= begin_us < 1e6 * (BEGIN_S + gap_s)
        if away and restarts:  # its clock begins with the next piece
            begun_us = host_us
            again = f"{device}:boot=9" if device == "evpr" else device
            encoder = open_encoder(again, decoder.sensor)
            continue
        piece.t -= begun_us
        data = encoder.encode(piece)
        if away:
            continue
        result = live.feed(data, host_us)
        for match in result.matches:
            then_us = host_us - (live.decoder.reached_us - match.time_us)
            rows.append((then_us, match.along_m, not match.lost))
    return [np.array(column) for column in zip(*rows, strict=True)]


@pytest.mark.parametrize("gap_s", [0.4, 2.0])
@pytest.mark.parametrize("restarts", [True, False], ids=["restart", "black-out"])
@pytest.mark.parametrize("device", ["evpr", "evt3", "edvs:format=E3"])
def test_what_was_not_seen_live_is_not_believed(device, restarts, gap_s, street):
    reference, events, along_m = street
    then_us, metres, accepted = live_matches(reference, events, device, restarts, gap_s)
    wrong = np.abs(metres - along_m(then_us)) > 10
    assert not (accepted & wrong).any()
    end_us = 1e6 * (BEGIN_S + gap_s)
    assert accepted[then_us < 1e6 * BEGIN_S].any()
    # of windows after the gap, and soon enough
    waited_s = (then_us[accepted & (then_us > end_us)][0] - end_us) / 1e6
    assert 1.0 < waited_s < SOON_S


@pytest.mark.parametrize("gap_s", [2.0, 4.0])
@pytest.mark.parametrize("smooth", [True, False])
def test_what_is_cut_out_of_a_recording_is_not_believed(smooth, gap_s, street):
    reference, events, along_m = street
    reference = reference.matched_with(replace(reference.settings, smooth=smooth))
    away = (events["t"] >= 1e6 * BEGIN_S) & (events["t"] < 1e6 * (BEGIN_S + gap_s))
    matches = reference.match(events[~away]).matches
    wrong = np.abs(reference.route.along_m[matches.place] - along_m(matches.time_us)) > 10
    assert not (wrong & ~matches.lost).any()
    within = np.abs(matches.time_us / 1e6 - BEGIN_S - gap_s / 2) < gap_s / 2
    assert matches.lost[within].all()
    later_s = matches.time_us[~matches.lost] / 1e6 - BEGIN_S - gap_s
    assert 0.0 < later_s[later_s > 0][0] < SOON_S


def test_unseen_time_is_the_same_however_the_stream_is_cut():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.choice([1, 20, 24, 25, 60, 250], 500, p=[0.9, *np.full(5, 0.02)]))
    whole = UnseenTime(FixedTime(100)).feed(times)
    assert {halves for _, halves in whole} == {1, 4}
    for pieces in (2, 7, 500):
        unseen, gaps = UnseenTime(FixedTime(100)), []
        for piece in np.array_split(times, pieces):
            # a frame without events may say how late it is
            gaps += unseen.until(int(piece[0])) if rng.random() < 0.5 else []
            gaps += unseen.feed(piece)
        assert gaps == whole
    assert UnseenTime(FixedCount(10)).feed(times) == []
