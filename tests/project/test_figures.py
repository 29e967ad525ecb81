"""Numbers in the sentences of README and results are those of the files of docs/results.

Tables are compared with their files in `test_documents.py`.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable
from fnmatch import fnmatchcase
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from firmware_model import Design
from firmware_model.image import stride

ROOT = Path(__file__).parents[2]


@cache
def rows_of(table: str) -> list[dict[str, str]]:
    with (ROOT / "docs" / "results" / table).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def chosen_rows(table: str, chosen: dict[str, str]) -> list[dict[str, str]]:
    """Return the rows whose cells match one of the patterns ``a|b``; in names, ``_`` is a space."""
    patterns = {name.replace("_", " "): of.split("|") for name, of in chosen.items()}
    return [
        row
        for row in rows_of(table)
        if all(any(fnmatchcase(row[k], one) for one in of) for k, of in patterns.items())
    ]


def cell(table: str, column: str, **chosen: str) -> str:
    """Return a cell of the only row that is chosen."""
    (row,) = chosen_rows(table, chosen)
    return row[column]


def means(table: str, column: str, **chosen: str) -> list[float]:
    """Return means over the trials that differ in their seed alone, in the order of the file."""
    names = list(rows_of(table)[0])
    names = names[: names.index("seed")]
    found: dict[tuple[str, ...], list[float]] = {}
    for row in chosen_rows(table, chosen):
        if row[column]:
            found.setdefault(tuple(row[name] for name in names), []).append(float(row[column]))
    return [float(np.mean(of)) for of in found.values()]


def ends(found: list[float]) -> tuple[float, float]:
    return min(found), max(found)


def trust(
    column: str, drives: str = "*", matching: str = "live", map: str = "whole"
) -> list[float]:
    return means("trust.csv", column, drives=drives, matching=matching, map=map)


def correct(drives: str, method: str, column: str = "P@100R") -> list[float]:
    return means("place-filter.csv", column, drives=drives, method=method)


def rivals(column: str) -> list[float]:
    """Return what our default, patch normalisation and HOG take."""
    return means(
        "rivals.csv", column, drives="*streets*N events", matching="sequences of 10",
        system="edge-vpr*|patch-*|hog*",
    )  # fmt: skip


def nulls(ending: str, matching: str) -> float:
    """Return the most that a filter finds on a query that shows nothing of the route."""
    method = "|".join(f"null: {one}{ending}" for one in SCRAMBLED)
    found = means("place-filter.csv", "P@100R", method=method)
    found += means("rivals.csv", "P@100R", system="null: *", matching=matching)
    return max(found)


def frames(system: str) -> list[float]:
    events, shown = means("frames.csv", "P@100R", system=system)
    return [shown, events]


def changed(constant: str, drives: str, times: str, column: str = "P@100R") -> list[float]:
    """Return what a constant of the filter gives live: its default, then its value times this."""
    chosen = {"constant": constant, "drives": drives, "matching": "live"}
    chosen["parameters_chosen_on"] = "streets and the real drives*"
    return [
        value
        for one in ("1.0", times)
        for value in means("sensitivity.csv", column, times_the_default=one, **chosen)
    ]


LIMIT, WEIGHT = "largest evidence at high misfit", "weight of evidence"
CUT, CARRIED, SWITCHED = "a piece cut out", "carried off twice", "switched on in mid-route"
FILTERED = "sequences of 5, 3-bit log|place filter, 3-bit log"
ROBOT = "place filter, running mean (robot)"
INNER = "P@100R (inner windows)"
QUARTER, SEEN = "a quarter cut out", " from one window after a change on"
SWAPPED, THEIRS = "Brisbane, 49 *, sunset2 on sunset1", "Brisbane, LENS's *"
AT_WHOLE = ", places at whole windows"
OURS, LIVE = f"edge-vpr{AT_WHOLE}", "place filter, live"
SMOOTHED = "place filter, recorded"
SOON = "median time to 0.99 (s)"
SCRAMBLED = (
    "windows shuffled", "query reversed", "pixels shuffled in each window", "pixels shuffled once",
)  # fmt: skip


def place_bytes() -> str:
    (found,) = {
        row["bytes per window"]
        for row in chosen_rows("places-per-window.csv", {"pixels": "150", "places_per_window": "1"})
    }
    return found


def speeds(variant: str) -> list[float]:
    query = "speed x 0.5|speed x 1|speed x 4"
    return means(
        "fixed-number.csv", "P@100R", drives="simulated streets", variant=variant, query=query
    )


def slower(method: str, column: str = "P@100R") -> list[float]:
    """Return what a filter reaches at half and at a quarter of the speed of the map."""
    drives = "street, half speed, 150 px|street, quarter speed, 150 px"
    return means("place-filter.csv", column, drives=drives, method=method)


def indoors(system: str, matching: str, column: str = "P@100R") -> list[float]:
    return means("rivals.csv", column, drives="Speck indoor", system=system, matching=matching)


def shifted(way: str) -> list[float]:
    return means("mount-shift.csv", "P@100R", drives="Speck indoor, 150 px", way=way)


def half_windows(column: str, pixels: str, per_window: str) -> float:
    """Return the mean over the queries."""
    found = means(
        "places-per-window.csv", column, drives="streets*", drive="whole", odometry="none",
        matched="live", pixels=pixels, places_per_window=per_window,
    )  # fmt: skip
    return float(np.mean(found))


def kept(drive: str, per_window: str) -> float:
    """Return the precision of all live matches that are accepted with 150 pixels on the streets."""
    rows = chosen_rows("places-per-window.csv", {
        "drives": "streets*", "drive": drive, "odometry": "none", "matched": "live",
        "pixels": "150", "places per window": per_window,
    })  # fmt: skip
    kept, accepted = (
        sum(int(row[name]) for row in rows) for name in ("accepted and correct", "accepted at 0.99")
    )
    return kept / accepted


def promised_on_streets(column: str = f"precision{SEEN}") -> list[float]:
    """Return the precision of accepted live matches: a piece cut out, a detour, carried off."""
    return [
        value
        for map in (CUT, "a detour", CARRIED)
        for value in means("calibration.csv", column, map=map, matching="live")
    ]


def reported(column: str, pixels: str) -> list[float]:
    """Return figures of the position that is reported on streets, in each light."""
    return means("position.csv", column, drives="streets*", pixels=pixels, position="reported")


def at_half_windows() -> list[float]:
    """Return the same on the streets that chose half windows: a quarter cut out, carried off."""
    return [kept(drive, "2") for drive in (QUARTER, "carried off")]


def further_drives() -> list[float]:
    """Return what further drives add to live P@100R, by pixels, light and map."""
    found = {}
    for pixels, query in product(("25", "150"), ("in other light", "in low sun", "at noon")):
        chosen = {
            "drives": "streets of 450 m", "pixels": pixels, "query": query, "matched": "live",
        }  # fmt: skip
        one, *more = means("several-drives.csv", "P@100R", **chosen)
        found[pixels, query] = [of - one for of in more]
    return [gain for gains in found.values() for gain in gains]


def by_day(column: str, query: str, *aligned: str) -> list[float]:
    """Return what the drive by day changes live, by how it is aligned."""
    chosen = {"drives": "Brisbane, 49 px", "query": query, "matched": "live"}
    return [float(cell("several-drives.csv", column, aligned=how, **chosen)) for how in aligned]


def brisbane(matching: str, pixels: str, tolerance: str = "25 m") -> float:
    chosen = {"drives": pixels, "system": OURS, "tolerance": tolerance, "matching": matching}
    return float(cell("rivals.csv", INNER, **chosen))


def reached(column: str) -> list[bool]:
    """Return whether the shares accepted reach their targets: streets, walks, indoors, Brisbane."""
    streets = means("calibration.csv", column, map="whole", matching="live")
    real = [trust(column, of)[0] for of in ("*walks, 150 px", "*indoor, 150 px", "Brisbane*")]
    return [of >= target for of, target in zip(streets + real, (0.6, 0.9, 0.45, 0.75), strict=True)]


def windows_of(drives: str) -> int:
    """Return the number of windows of a recorded query whose truth is known."""
    (found,) = set(trust("windows", drives))
    return int(found)


def not_judged() -> tuple[int, float, float]:
    """Return the matches of Brisbane without a known truth; what is accepted of others, of all."""
    (of_all,), windows = trust("accepted at 0.99", "Brisbane*"), windows_of("Brisbane*")
    of_judged = laid_out("accepted at 0.99", LIVE)[-1]
    return windows - round(windows * of_all / of_judged), of_judged, of_all


def missed(matching: str, map: str) -> list[float]:
    """Return the precisions of drives on which the promise of 0.99 is not kept."""
    return [of for of in trust("precision", matching=matching, map=map) if of < 0.99]


def without_wrong() -> int:
    """Return how many live matches indoors with 25 pixels are accepted; all of them are correct."""
    drives = "Speck indoor, 25 px"
    assert trust("precision", drives) == [1]
    return round(trust("accepted at 0.99", drives)[0] * windows_of(drives))


def within(metres: str, column: str) -> float:
    """Return what our live matches of Brisbane reach, within a tolerance."""
    return float(cell("rivals.csv", column, drives="Brisbane, 49 *, sunset1 on sunset2",
                      tolerance=f"{metres} m", system=OURS, matching=LIVE))  # fmt: skip


def on_brisbane(system: str, matching: str, pixels: str) -> float:
    """Return the share of correct matches of the first drive on a map of the second."""
    return float(cell("rivals.csv", "P@100R", drives=f"Brisbane, {pixels}, sunset1 on sunset2",
                      tolerance="70 m", system=system, matching=matching))  # fmt: skip


def laid_out(column: str, matching: str, metres: int = 70) -> list[float]:
    """Return what patch normalisation, HOG and ours reach at the 49 pixels of Brisbane."""
    return [
        float(cell("rivals.csv", column, drives="Brisbane, 49 *, sunset1 on sunset2",
                   tolerance=f"{metres} m", system=system, matching=matching))
        for system in ("patch-normalised*", "hog*", OURS)
    ]  # fmt: skip


def swapped_live() -> list[float]:
    """Return what ours and seed-code reach live with the map of sunset 1, in 70 and 25 m."""
    ours, theirs = (
        [float(cell("rivals.csv", "P@100R", drives=SWAPPED, system=system, tolerance=f"{metres} m",
                    matching=LIVE)) for metres in (70, 25)]
        for system in (OURS, "seed-code*")
    )  # fmt: skip
    assert ours[0] == theirs[0], "the pages say that they are equal"
    return [ours[0], theirs[0], theirs[1], ours[1]]


def with_other_map() -> float:
    """Return what all three reach smoothed with the map of the first drive."""
    (found,) = {float(row["P@100R"]) for row in chosen_rows("rivals.csv", {
        "drives": "Brisbane, 49 *, sunset2 on sunset1", "tolerance": "70 m",
        "system": f"patch-normalised*|hog*|{OURS}", "matching": SMOOTHED})}  # fmt: skip
    return found


def accepted_near() -> list[float]:
    """Return the precision of our accepted live matches within 10 m, on each street."""
    chosen = {"drives": "simulated streets, windows of 1 s", "system": OURS, "matching": LIVE}
    rows = chosen_rows("rivals.csv", chosen)
    return [float(row["correct of accepted"]) for row in rows]


def at_half_speed() -> tuple[float, float]:
    """Return how many accepted matches are correct with odometry: the mean and the least."""
    chosen = {"drives": "street, half speed, 150 px", "method": "*(robot), odometry"}
    rows = chosen_rows("place-filter.csv", chosen)
    found = [float(row["correct of accepted"]) for row in rows]
    return float(np.mean(found)), min(found)


def a_wrong_match() -> float:
    """Return the least that one wrong match takes from the precision on the walks."""
    most = max(trust("accepted at 0.99", "*walks*"))
    return 1 / (most * windows_of("Speck walks*"))


def smoothed_walks() -> float:
    """Return the share within the tolerance, where all matches of the walks are accepted."""
    assert set(trust("accepted at 0.99", "*walks*", "smoothed")) == {1}
    few, many = trust("precision by tolerance", "*walks*", "smoothed")
    assert round(few, 2) == round(many, 2)
    return many


def live_recorded(drives: str) -> list[float]:
    return correct(drives, "*(robot)|*smoothed (default)")


def modelled(column: str) -> list[float]:
    """Return what 150 pixels on a Cortex-M4 take, by the rate of events."""
    chosen = {"system": "*, 150 pixels", "device": "cortex-m4", "basis": "modelled"}
    return [float(row[column]) for row in chosen_rows("joules.csv", chosen)]


def area(design: str) -> list[str]:
    return [
        cell("core-area.csv", column, FPGA="iCE40UP5K", design=design)
        for column in ("logic cells", "block memories")
    ]


def clock(design: str, fpga: str) -> list[str]:
    found = cell("core-area.csv", "MHz (worst to best)", FPGA=fpga, design=design)
    return found.partition(",")[0].split(" to ")


def latency(column: str, events: str = "1") -> str:
    return cell("latency-chunks.csv", column, matched_by="place filter*", events_per_chunk=events)


#: page, words of it with a field for each number, and what computes these
SENTENCES: list[tuple[str, str, Callable[[], object]]] = [
    ("README", "Each second of the route takes {} bytes packed", lambda: 2 * int(place_bytes())),
    ("README", "at 49 pixels: {:.2f} of all live matches lie within 70 m, and {:.2f} within 25 m",
     lambda: [laid_out("P@100R", LIVE, metres)[-1] for metres in (70, 25)]),
    ("README", "`--precision 0.99`, {:.2f} are accepted, and {:.2f} of these lie within 70 m",
     lambda: [*trust("accepted at 0.99", "Brisbane*"),
              *trust("precision by tolerance", "Brisbane*")]),
    ("README", "a second of the route takes {} bytes, packed as on the FPGA, and {} in the C "
     "firmware",
     lambda: (2 * int(place_bytes()),
              2 * stride(Design(width=128, height=128, pixels=150, places=9)))),
    ("README", "a route of 500 s takes {:.0f} KiB, of which {:.0f} KiB are RAM and the rest flash, "
     "and a match takes {:.0f} ms and {:.1f} mJ at 100,000 events per second (modelled)",
     lambda: (modelled("memory (KiB)")[0], modelled("of it RAM (KiB)")[0],
              modelled("time (ms)")[1], 1e3 / modelled("matches per joule")[1])),
    ("README", "the paper's released code reaches {:.2f}, and ours {:.2f}.",
     lambda: [on_brisbane(of, "sequences of 20", "49 pixels") for of in ("seed-code*", OURS)]),
    ("README", "behind the same filter, reaches {:.2f} live, with {:.0f} times the bytes",
     lambda: [laid_out("P@100R", LIVE)[0], laid_out("bytes per place", LIVE)[0]
              / laid_out("bytes per place", LIVE)[-1]]),
    ("results_methods", "ours 0.985, and in sequences of 20 {:.3f}, ours {:.3f}.",
     lambda: [on_brisbane(of, "sequences of 20", "LENS's 49 pixels")
              for of in ("patch-normalised*", OURS)]),
    ("README", "equals ours within 70 m, with {:.3f}, and is better within 25 m: {:.3f}, ours "
     "{:.3f}.", lambda: swapped_live()[1:]),
    ("results_methods", "seed-code equals it within 70 m ({:.3f}) and is better within 25 m "
     "({:.3f}, ours {:.3f})", lambda: swapped_live()[1:]),
    ("README", "live too ({:.3f} and {:.3f}, ours at whole windows {:.3f})",
     lambda: means("rivals.csv", "P@100R", drives="*streets*1 s", tolerance="10 m", matching=LIVE,
                   system="patch-normalised*|hog 64*") + means(
                       "rivals.csv", "P@100R", drives="*streets*1 s", tolerance="10 m",
                       matching=LIVE, system=OURS)),
    ("README", "of which {:.3f} or more keep the promise",
     lambda: min(trust("precision (stays on map)"))),
    ("results_methods", "Our single windows of 1 s reach {:.3f}:",
     lambda: laid_out("P@100R", "single windows", 25)[-1]),
    ("results_methods", "ours reaches {:.3f} in sequences of 20, {:.3f} live and {:.3f} smoothed.",
     lambda: [float(cell("rivals.csv", "P@100R", drives=SWAPPED, system=OURS, tolerance="25 m",
                         matching=how)) for how in ("sequences of 20", LIVE, SMOOTHED)]),
    ("results_methods", "within 70 m, live, {:.2f} by day",
     lambda: by_day("P@100R", "by day", "alone")),
    ("results", "With `--stays-on-map`, it is missed on the walks with 150 pixels ({:.3f})",
     lambda: trust("precision (stays on map)", "*walks, 150 px")),
    ("README", "reaches {:.2f} with sequences of 20 at its own 49 pixels, where ours reaches "
     "{:.2f}, and live {:.2f}.",
     lambda: [on_brisbane("LENS, sunset2", "sequences of 20", "LENS's 49 pixels"),
              *(on_brisbane(OURS, how, "LENS's 49 pixels") for how in ("sequences of 20", LIVE))]),
    ("README", "takes {:,.0f} bytes with patch normalisation, {:,.0f} with HOG, and {:.0f} with "
     "ours",
     lambda: laid_out("bytes per place", LIVE)),
    ("results_methods", "patch normalisation and HOG reach {:.3f} here, ours {:.3f}",
     lambda: list(dict.fromkeys(laid_out("P@100R", SMOOTHED)))),
    ("results_methods", "(with the map of sunset 1, all three reach {:.0f})", with_other_map),
    ("results_methods", "Within 25 m, smoothed, they reach {:.3f} and {:.3f}, ours {:.3f}",
     lambda: laid_out("P@100R", SMOOTHED, 25)),
    ("results_methods", "the best live, {:.3f} against {:.3f} of patch normalisation",
     lambda: [on_brisbane(of, LIVE, "LENS's 49 pixels") for of in (OURS, "patch-normalised*")]),
    ("results_methods", "smoothed, that reaches {:.3f} and all pixels {:.3f}, ours {:.3f}",
     lambda: [on_brisbane(of, SMOOTHED, "LENS's 49 pixels")
              for of in ("patch-normalised*", "all-pixels, SAD", OURS)]),
    ("README", "by that measure, the precision on these drives is {:.3f} or more.",
     lambda: min(trust("precision"))),
    ("README", "on the walks, of {} windows,", lambda: windows_of("Speck walks*")),
    ("README", "one wrong match costs {:.3f} or more", a_wrong_match),
    ("README", "the promise is kept on the real drives ({:.3f} or more)",
     lambda: min(trust("precision", map=f"{CUT}|{CARRIED}"))),
    ("README", "not on all simulated streets ({:.2f} to {:.2f})",
     lambda: ends(promised_on_streets() + at_half_windows())),
    ("README", "on the walks and indoors ({:.2f} to {:.2f})",
     lambda: ends(missed("smoothed", CUT))),
    ("will_it_work", "A second of the route takes {} bytes packed", lambda: 2 * int(place_bytes())),
    ("will_it_work", "{:.2f}, {:.2f} by car", lambda: live_recorded("Brisbane, 49 px")),
    ("will_it_work", "speed | {:.2f}, {:.2f} on streets", lambda: live_recorded("street, 150 px")),
    ("will_it_work", "pulls away | {:.2f}, {:.2f} on", lambda: live_recorded("*3 stops, 150 px")),
    ("results", "`--precision 0.99` accepts {:.2f} of all, of which {:.3f} are correct",
     lambda: [*correct("*2 min, 150 px", ROBOT, "accepted at 0.99"),
              *correct("*2 min, 150 px", ROBOT, "correct of accepted")]),
    ("will_it_work", "{:.2f}, {:.2f} on streets with three stops of 2 minutes, against {:.2f} with",
     lambda: [*live_recorded("*2 min, 150 px"), *correct("*2 min, 150 px", f"{ROBOT}, odometry")]),
    ("will_it_work", "{:.2f}, {:.2f} on streets where contrast thresholds are doubled",
     lambda: live_recorded("*thresholds x 2, 150 px")),
    ("will_it_work", "{:.2f}, {:.2f} on streets in low sun",
     lambda: live_recorded("*low sun, 150 px")),
    ("will_it_work", "{:.2f}, {:.2f} on one route", lambda: live_recorded("*walks, 150 px")),
    ("will_it_work", "{:.2f}, {:.2f} on another", lambda: live_recorded("*indoor, 150 px")),
    ("will_it_work", "{:.0f} to {:.0f} s of driving until a match is confident",
     lambda: ends(trust(SOON, "*150 px|*49 px|*walks, 25 px", map=SWITCHED))),
    ("will_it_work", "{:.0f} s indoors with 25 pixels",
     lambda: trust(SOON, "*indoor, 25 px", map=SWITCHED)),
    ("trust", "of {:.2f} to {:.2f} only",
     lambda: ends(trust("AUROC off the map", "*indoor*", map=CUT))),
    ("trust", "a mean probability of at most {:.2f} on recorded drives",
     lambda: max(trust("mean probability", map="null: *"))),
    ("trust", "and {:.2f} on simulated streets",
     lambda: max(means("calibration.csv", "mean probability", matching="live",
                       map="null: *|backwards|another route"))),
    ("trust", "smoothed, of up to {:.2f}",
     lambda: max(trust("mean probability", map="null: *", matching="smoothed"))),
    ("trust", "live probabilities are {:.2f} on average",
     lambda: means("calibration.csv", "mean probability (stays on map)", matching="live",
                   map="another route")),
    ("results", "are correct in {:.3f} of the windows, and in {:.3f} of those accepted",
     lambda: (within("25", "P@100R"), within("25", "correct of accepted"))),
    ("results", "the walks have {} windows, the indoor drive {}, Brisbane {}.",
     lambda: [windows_of(of) for of in ("Speck walks*", "Speck indoor*", "Brisbane*")]),
    ("results", "leave out {} of these windows, whose match has no known truth: {:.3f} of the "
     "others are accepted, {:.3f} of all", not_judged),
    ("results", "One wrong match costs the walks {:.3f} or more", a_wrong_match),
    ("results", "{} correct matches of {} (indoors, 25 pixels)", lambda: 2 * (without_wrong(),)),
    ("results", "only show a share above {:.3f} (95 % confidence)",
     lambda: 0.05 ** (1 / without_wrong())),
    ("results", "On streets, {:.3f} of the accepted live matches are within",
     lambda: means("calibration.csv", "precision", map="whole", matching="live")),
    ("results", "with places at whole windows, {:.3f} are within 10 m, on the worst one {:.3f}",
     lambda: (float(np.mean(accepted_near())), min(accepted_near()))),
    ("results", "{:.3f} (walks, 25 pixels), {:.3f} (walks, 150 pixels) and {:.3f} (Brisbane)",
     lambda: trust("precision by tolerance", "*walks*|Brisbane*")),
    ("results", "is just missed on the walks ({:.4f})",
     lambda: list(set(missed("smoothed", "whole")))),
    ("results", "accepted and {:.2f} of them lie within the tolerance of 2 s", smoothed_walks),
    ("README", "at {:,.0f}, {:.0f} and {:.0f} matches per joule at 10,000, 100,000 and 1,000,000",
     lambda: modelled("matches per joule")),
    ("README", "keeps it busy for {:.0f}, {:.0f} and {:.0f} ms at 100 MHz;",
     lambda: modelled("time (ms)")),
    ("README", "program, map and state take {:.0f} KiB, of which {:.0f} KiB are RAM",
     lambda: [modelled(column)[0] for column in ("memory (KiB)", "of it RAM (KiB)")]),
    ("results_cost", "the default filter takes {} logic cells and {} block memories",
     lambda: area("place filter, contrast codes")),
    ("results_cost", "half windows {} and {}; sequences of 5 take {} and {} (core-area.csv)",
     lambda: area("*half windows*") + area("sequences of 5")),
    ("results_cost", "the default filter reaches {} to {} MHz",
     lambda: clock("place filter, contrast codes", "iCE40UP5K")),
    ("results_cost", "on an ECP5 {} to {} MHz",
     lambda: clock("place filter, contrast codes", "ECP5-25F")),
    ("results_cost", "the filter of counts reaches {} to {} MHz",
     lambda: clock("place filter", "ECP5-25F")),
    ("results_methods", "in more than {:.2f} of the windows live, or {:.2f} smoothed",
     lambda: (nulls("", "*, live"), nulls(", smoothed", "*, recorded"))),
    ("results_methods", "our places take {:.0f} bytes, theirs {:,.0f} and {:,.0f}",
     lambda: rivals("bytes per place")),
    ("results_methods", "{:.3f} in windows of a fixed number of events, {:.3f} in windows of"
     " a fixed time",
     lambda: means("simulated.csv", "P@100R", variant="150 varying pixels, fixed N|150 *, *tau")),
    ("results_methods", "{:.3f} with 25 varying pixels, {:.3f} with 25 random pixels, {:.3f} with"
     " all",
     lambda: means("simulated.csv", "P@100R", variant="25 *, fixed N|all pixels, fixed N")),
    ("results_methods",
     "the default (smoothed), of all windows: {:.3f}; a guess at constant speed: {:.3f}",
     lambda: means("simulated.csv", "P@100R", variant="*(default)|null: constant*")),
    ("results_methods", "sequences of 20 of our codes reach {:.3f} on sunset 2 of Brisbane",
     lambda: brisbane("sequences of 20", SWAPPED)),
    ("results_methods", "(map: sunset 1), the live filter {:.3f};",
     lambda: brisbane(LIVE, SWAPPED)),
    ("results_methods", "sequences of 10 reach {:.3f}, the live filter {:.3f}. Within 70",
     lambda: [brisbane(matching, THEIRS) for matching in ("sequences of 10", LIVE)]),
    ("results_methods", "of 20 of our codes reach {:.3f}, the live filter {:.3f}. On Speck",
     lambda: indoors(OURS, "sequences of 20|*, live", INNER)),
    ("results_methods", "match a recorded drive far better: {:.3f} of all windows, ours {:.3f}",
     lambda: [indoors(system, "*, recorded")[0]
              for system in ("paper: *", OURS)]),
    ("results", "error of the position is {:.2f} m in other light and {:.2f} m in low sun",
     lambda: reported("median error (m)", "25")),
    ("results_robustness", "1.3 m; below 1 | on streets at most {:.1f} m; {:.0f}",
     lambda: (max(reported("median error (m)", "150")),
              max(reported("steps back per km", "25|150")))),
    ("results_methods", "reach a P@100R of {:.2f} and events {:.2f}",
     lambda: frames("150 by variance")),
    ("results_methods", "at 25 pixels, {:.2f} and {:.2f}", lambda: frames("25 by variance")),
    ("results_methods", "over sequences of 5 from {:.3f} to {:.3f} on Speck indoor",
     lambda: correct("*indoor, 150 px", FILTERED, INNER)),
    ("results_methods", "and from {:.3f} to {:.3f} on streets in low sun",
     lambda: correct("*low sun, 150 px", FILTERED, INNER)),
    ("results_methods", "then give {:.3f} and {:.3f}",
     lambda: [
         *correct("*indoor, 150 px", ROBOT, INNER),
         *correct("*low sun, 150 px", f"{ROBOT}, places at whole windows", INNER),
     ]),
    ("results_robustness", "accepts {:.2f} to {:.2f} of the live matches",
     lambda: ends(trust("accepted at 0.99", map=CUT))),
    ("results_robustness", "true of {:.3f} (Brisbane) to {:.3f} (indoors, 25 pixels)",
     lambda: (*trust("precision", "Brisbane*", map=CUT),
              *trust("precision", "*indoor, 25 px", map=CUT))),
    ("results_robustness", "be used here, it is true of {:.3f} to {:.3f}",
     lambda: ends(trust("precision (stays on map)", map=CUT))),
    ("results_robustness", "the default has a P@100R of {:.3f}. With images",
     lambda: shifted("place filter (default)")[0]),
    ("results_robustness", "it falls to {:.3f}, {:.3f}, {:.3f} and {:.3f};",
     lambda: shifted("place filter (default)")[1:]),
    ("results_robustness", "it stays at {:.3f} or above",
     lambda: min(shifted("place filter, registered"))),
    ("results_robustness", "live P@100R with 150 pixels from {:.2f} to {:.2f}",
     lambda: [half_windows("P@100R", "150", of) for of in "12"]),
    ("results_robustness", "accepts from {:.2f} to {:.2f}, for twice",
     lambda: [half_windows("share accepted at 0.99", "150", of) for of in "12"]),
    ("results_robustness", "P@100R rises from {:.3f} to {:.3f}, with stops from {:.3f} to {:.3f}",
     lambda: [value for drives in ("street, 150 px", "street, 3 stops, 150 px")
              for value in reversed(correct(drives, f"*(robot)|*(robot){AT_WHOLE}"))]),
    ("results_robustness",
     "spliced between windows, it is true of {:.3f} where a quarter is missing, and of {:.3f}",
     at_half_windows),
    ("results_robustness", "with places at whole windows ({:.3f})", lambda: kept(QUARTER, "1")),
    ("results_robustness", "with either (whole windows: {:.3f})",
     lambda: kept("carried off", "1")),
    ("results_robustness", "with 25 and 150 pixels, by {:.2f} to {:.2f}",
     lambda: ends(further_drives())),
    ("results_robustness", "Without tracks, {:.2f} of its windows are aligned",
     lambda: by_day("aligned of the last drive learnt", "by day", "by matching")),
    ("results_robustness", "are aligned, {:.2f} of these correctly",
     lambda: by_day("of these right", "by day", "by matching")),
    ("results_robustness", "day, from {:.2f} live to {:.2f} (with tracks to {:.2f})",
     lambda: by_day("P@100R", "by day", "alone", "by matching", "by tracks")),
    ("results_robustness", "pays for it: {:.3f} live falls to {:.3f} ({:.3f})",
     lambda: by_day("P@100R", "at sunset", "alone", "by matching", "by tracks")),
    ("README", "from sunset to day {:.2f}", lambda: by_day("P@100R", "by day", "alone")),
    ("will_it_work", "from sunset to day {:.2f}", lambda: by_day("P@100R", "by day", "alone")),
    ("results_robustness", "75 pixels at half windows reach {:.2f} and {:.2f}",
     lambda: [half_windows(of, "75", "2") for of in ("P@100R", "share accepted at 0.99")]),
    ("results_robustness", "precision is {:.2f} to {:.2f} on the walks and indoors",
     lambda: ends(missed("smoothed", CUT))),
    ("results_robustness", "and up to {:.0f} in a row on streets",
     lambda: max(float(row["most windows accepted after leaving"] or 0) for row in chosen_rows(
         "calibration.csv", {"matching": "live", "map": "a piece cut out|a detour"}))),
    ("results_robustness", "The calibration error is {:.2f} to {:.2f}",
     lambda: ends(trust("calibration error", map=CUT))),
    ("results_robustness", "with `--stays-on-map` {:.2f} to {:.2f}. On the map",
     lambda: ends(trust("calibration error (stays on map)", map=CUT))),
    ("results_robustness", "smoothing raises the share accepted at 0.99 from {:.2f} to {:.2f}",
     lambda: means("calibration.csv", "accepted at 0.99", map="whole",
                   matching="live|smoothed")),
    ("results_robustness", "of 0.99 after {:.1f} to {:.1f} s",
     lambda: ends(trust(SOON, "*150 px|*49 px|*walks, 25 px", map=SWITCHED))),
    ("results_robustness", "(median; {:.1f} s indoors with 25 pixels)",
     lambda: trust(SOON, "*indoor, 25 px", map=SWITCHED)),
    ("results_robustness",
     "within two minutes: {:.2f} of those on Brisbane, {:.2f} indoors with 25 pixels",
     lambda: [1 - trust("p >= 0.99 reached", of, map=SWITCHED)[0]
              for of in ("Brisbane*", "*indoor, 25 px")]),
    ("results_robustness", "is then correct in {:.3f} to {:.3f} of the cases",
     lambda: ends(trust("correct at 0.99", map=SWITCHED))),
    ("results_robustness", "smoothed at most {:.2f} (indoors, reversed)",
     lambda: max(trust("accepted at 0.99", "*indoor*", "smoothed", "null: query reversed"))),
    ("results_robustness",
     "has a P@100R of {:.3f} at half the speed of the map, {:.3f} at the same, and {:.3f}",
     lambda: speeds("150 pixels, fixed tau")),
    ("results_robustness", "(`--window count`) {:.3f}, {:.3f} and {:.3f}",
     lambda: speeds("150 pixels, fixed N")),
    ("results_robustness", "{:.3f} are correct at half the speed ({:.3f} on the worst street)",
     at_half_speed),
    ("results_robustness", "a share of only {:.2f} at half the speed, and {:.2f} at a quarter",
     lambda: slower("*(robot), odometry", "accepted at 0.99")),
    ("will_it_work", "live {:.2f} and {:.2f} with odometry",
     lambda: slower("*(robot), odometry")),
    ("will_it_work", "few of them confident; {:.2f} and {:.2f} without",
     lambda: slower("*(robot)")),
    ("results_robustness", "whose truth is a constant lag, from {:.2f} to {:.2f}",
     lambda: changed(WEIGHT, "*indoor, 150 px", "0.25")),
    ("results_robustness", "and the street in low sun from {:.2f} to {:.2f}",
     lambda: changed(WEIGHT, "*low sun, 150 px", "0.25")),
    ("results_robustness", "Speck indoor with 150 pixels rises from {:.2f} to {:.2f}",
     lambda: changed(LIMIT, "*indoor, 150 px", "0.015625")),
    ("results_robustness", "the street with 25 pixels falls from {:.2f} to {:.2f}",
     lambda: changed(LIMIT, "street, 25 px", "0.015625")),
    ("results_robustness", "with pixels shuffled, Speck indoor rises from {:.2f} to {:.2f}",
     lambda: changed(LIMIT, "*indoor, 150 px", "0.015625", "null: pixels shuffled once")),
    ("results_robustness", "Nulls are correct in at most {:.2f} of the windows",
     lambda: max(means("places-per-window.csv", "P@100R", drive="null: *", matched="live",
                       odometry="none"))),
    ("results_robustness",
     "| 0.98 | {:.3f}, on streets {:.3f} from one window after a change on, {:.3f} of all; with",
     lambda: (min(trust("precision", map=CUT)), min(promised_on_streets()),
              min(promised_on_streets("precision")))),
    ("results_robustness", "with `--stays-on-map` {:.3f} |",
     lambda: min(trust("precision (stays on map)", map=CUT))),
    ("results_robustness", "| 0.03, 0.05 | {:.2f} to {:.2f}, {:.2f} to {:.2f} |",
     lambda: (*ends(trust("calibration error")), *ends(trust("calibration error", map=CUT)))),
    ("tuning", "indoors {:.2f} correct against {:.2f}",
     lambda: [indoors(system, "*, recorded")[0]
              for system in ("paper: *", OURS)]),
]  # fmt: skip


def path_of(page: str) -> Path:
    return ROOT / ("README.md" if page == "README" else f"docs/{page}.md")


@cache
def prose_of(page: str) -> str:
    """Return the page in one line, without code blocks, links' targets and tables of files."""
    text = path_of(page).read_text(encoding="utf-8")
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    text = re.sub(r"^<!-- table: .*?-->\n\n(?:\|.*\n)+", "", text, flags=re.MULTILINE)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(text.split())


#: words that call a number a bound, and how it is rounded so that it holds
BOUNDS = [("or more", math.floor), ("or above", math.floor), ("above {", math.floor),
          ("at most {", math.ceil)]  # fmt: skip


def filled(words: str, found: object) -> str:
    """Put numbers into words: rounded, but down or up if the words call one a bound."""
    numbers = found if isinstance(found, (list, tuple)) else [found]
    assert len(numbers) == words.count("{"), (words, numbers)
    places = [10 ** int(digits) for digits in re.findall(r"\{:[,.]*(\d?)f?\}", words)]
    for bound, rounded in BOUNDS:
        if bound in words:
            numbers = [rounded(n * unit) / unit for n, unit in zip(numbers, places, strict=True)]
    return words.format(*numbers)


@pytest.mark.parametrize(("page", "words", "compute"), SENTENCES)
def test_a_sentence_has_the_numbers_of_the_files(page, words, compute):
    assert filled(words, compute()) in prose_of(page)
