"""GPS logs as receivers send them: RMC and GGA sentences of NMEA 0183, any talker."""

from __future__ import annotations

import datetime as dt
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.fixes import Fixes
from edge_vpr.evaluation.tracks import APART_M, great_circle

_DAY_US = 86_400_000_000
_HOUR_US = 3_600_000_000
_SENTENCE = re.compile(
    r"\$(?P<body>(?P<type>[A-Z]{2}(?:RMC|GGA)),[^*$\r\n]*)(?:\*(?P<sum>[0-9A-Fa-f]{2}))?"
)
_OTHER = re.compile(r"\$(?:[A-Z]{2})?(GNS|GLL|PUBX)\b")
_TIME = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d{1,6})\d*)?")
_ANGLE = re.compile(r"(\d{1,3})(\d\d(?:\.\d*)?)")

#: Sentences of another type can follow a second late, and a single one later still.
_LATE_US = 2_000_000
#: Clocks are set back by at most the seconds between GPS time and UTC, which a receiver learns
#: minutes after its first fix; by more, the log holds two drives.
_LEAP_US = 60_000_000
#: Old receivers count weeks from 0 again after so many, and say a date 20 years ago.
_ROLLOVER_US = 1024 * 7 * _DAY_US
#: A time that comes again is of a clock that was set back, if the vehicle has moved by so much.
_MOVED_M = 1.0
#: A clock that is set on by seconds leaves a gap as lost sentences do. It was set if the vehicle,
#: at a steady speed (within this share), lacks at least so many metres. Chosen on logs of a car.
_STEADY_SHARE, _LACKS_M = 0.3, 5.0


def is_nmea(text: str) -> bool:
    """Return whether a text holds a sentence that `read_nmea` reads."""
    return _SENTENCE.search(text) is not None


def read_nmea(text: str) -> Fixes:
    """Read a log.

    Time 0 is the first sentence with a time, with or without a fix. If logger and camera start
    together, this is the start of the recording. Where the receiver sets its clock (before the
    first fix by years, later by leap seconds or a rollover of weeks), what came before is moved
    with it, so that time goes on by one interval. Sentences with a wrong checksum or without a fix
    are left out and counted, and those without a checksum unless most have none. RMC and GGA of one
    instant make one point, the first.

    Raises
    ------
    GroundTruthError
        If no sentence has a fix, or time runs backwards.
    """
    dropped: Counter[str] = Counter()
    found = list(_sentences(text, dropped))
    unchecked = sum(not sentence.checked for sentence in found)
    if 2 * unchecked <= len(found):
        found = [sentence for sentence in found if sentence.checked]
        dropped["no checksum"] += unchecked
        unchecked = 0
    timed = [sentence for sentence in found if sentence.time_of_day_us is not None]
    dropped["no fix"] += len(found) - len(timed)
    with_fix = np.array([sentence.position is not None for sentence in timed], dtype=np.bool_)
    if not with_fix.any():
        dropped["no fix"] += len(timed)
        raise _no_fix(dropped, _OTHER.findall(text))
    clock, dated = _unwrapped(timed)
    time, steps, kept = _steady(clock, with_fix, [sentence.type for sentence in timed])
    for row, step in _set_by_seconds(time, kept, timed):
        time[:row] += step
        steps.append(step)
    dropped["no fix"] += int((kept & ~with_fix).sum())
    dropped["a time out of order"] += int((~kept).sum())
    zero, start = int(time[0]), None
    if dated is not None:
        day = dt.datetime.fromordinal(dated[1]).replace(tzinfo=dt.UTC)
        of_day, after = timed[dated[0]].time_of_day_us or 0, int(time[dated[0]]) - zero
        start = day + dt.timedelta(microseconds=of_day - after)
    rows = np.flatnonzero(kept & with_fix)
    rows = rows[np.argsort(time[rows], kind="stable")]
    first: dict[int, int] = {}  # the row of each instant
    pairs = []  # rows of one instant, of two types
    for row in rows.tolist():
        one = first.setdefault(int(time[row]), row)
        if timed[one].type != timed[row].type:
            pairs.append((one, row))
        elif one != row:
            dropped["a time that another has"] += 1
    once = list(first.values())
    notes = [
        f"the receiver's clock was set {'back' if step < 0 else 'on'} by {abs(step) / 1e6:,.0f} s: "
        "times before count on from the ones after"
        for step in steps
    ]
    if unchecked:
        notes.append(f"{unchecked:,} sentences have no checksum, so that damage is not noticed")
    if pairs:
        both = np.array([[timed[row].position for row in pair] for pair in pairs])
        apart_m = float(np.median(great_circle(both[:, 0], both[:, 1])))
        if apart_m > APART_M:
            notes.append(
                f"sentences of one instant are {apart_m:.0f} m apart, as of two receivers: keep "
                "those of one, such as of one talker"
            )
    return Fixes(
        time[once] - zero,
        np.array([timed[row].position for row in once]),
        "geographic",
        start,
        +dropped,
        len(once) + sum(dropped.values()),
        tuple(notes),
    )


@dataclass(frozen=True)
class _Sentence:
    type: str  # talker and type
    checked: bool  # whether it has a checksum, which fits
    time_of_day_us: int | None  # None before the receiver has a time
    ordinal: int | None  # proleptic day number of the date, if stated
    position: tuple[float, float] | None  # None if the receiver had no fix


def _sentences(text: str, dropped: Counter[str]) -> Iterator[_Sentence]:
    """Yield the RMC and GGA sentences; count the faulty ones.

    Written here because it needs only two types of sentence and an XOR. pynmea2 has had no release
    since 2022 and would be a dependency of every installation.
    """
    for match in _SENTENCE.finditer(text):
        body, checksum = match["body"], 0
        for byte in body.encode("ascii", errors="replace"):
            checksum ^= byte
        if match["sum"] is not None and int(match["sum"], 16) != checksum:
            dropped["bad checksum"] += 1
            continue
        try:
            yield _parsed(match["type"], body.split(","), match["sum"] is not None)
        except (ValueError, IndexError):
            dropped["unreadable field" if match["sum"] else "no checksum"] += 1


def _parsed(kind: str, fields: list[str], checked: bool) -> _Sentence:
    clock = _TIME.fullmatch(fields[1])
    time = ordinal = None
    if fields[1]:
        if clock is None:
            raise ValueError
        hour, minute, second = (int(part) for part in clock.groups()[:3])
        if hour > 23 or minute > 59 or second > 60:  # 60: a leap second
            raise ValueError
        time = (hour * 3600 + minute * 60 + second) * 1_000_000
        time += int((clock[4] or "0").ljust(6, "0"))
    if kind.endswith("RMC"):
        valid, first = fields[2] == "A", 3  # the field of the latitude
        if fields[9]:
            ordinal = dt.datetime.strptime(fields[9], "%d%m%y").toordinal()
    else:
        valid, first = fields[6] not in ("", "0"), 2
    if time is None or not valid:
        return _Sentence(kind, checked, time, ordinal, None)
    latitude = _degrees(fields[first], fields[first + 1], "NS", 90.0)
    longitude = _degrees(fields[first + 2], fields[first + 3], "EW", 180.0)
    return _Sentence(kind, checked, time, ordinal, (latitude, longitude))


def _degrees(value: str, side: str, sides: str, limit: float) -> float:
    """Convert ``2730.39720,S`` (degrees and minutes) to signed degrees."""
    angle = _ANGLE.fullmatch(value)
    if angle is None or side not in tuple(sides):
        raise ValueError
    degrees = int(angle[1]) + float(angle[2]) / 60.0
    if float(angle[2]) >= 60.0 or degrees > limit:
        raise ValueError
    return degrees if side == sides[0] else -degrees


def _unwrapped(
    timed: list[_Sentence],
) -> tuple[npt.NDArray[np.int64], tuple[int, int] | None]:
    """Return the clock of each sentence over midnight, and the last dated row with its day."""
    clock = np.zeros(len(timed), dtype=np.int64)
    day_0 = dated = None
    last = timed[0].time_of_day_us or 0
    for row, sentence in enumerate(timed):
        of_day = sentence.time_of_day_us or 0
        # take the day on which this time of day is nearest to the sentence before ...
        near = last + (of_day - last + _DAY_US // 2) % _DAY_US - _DAY_US // 2
        time = near
        if sentence.ordinal is not None:  # ... unless the sentence states its date
            if day_0 is None:
                day_0 = sentence.ordinal - near // _DAY_US
            time = (sentence.ordinal - day_0) * _DAY_US + of_day
            # which some receivers change seconds before or after midnight
            midnight = min(of_day, _DAY_US - of_day) < _LEAP_US
            if midnight and abs(time - near) == _DAY_US and abs(near - last) < _LEAP_US:
                time = near
            elif sentence.position is not None or dated is None:
                dated = row, sentence.ordinal
        clock[row] = last = time
    return clock, dated


def _steady(
    clock: npt.NDArray[np.int64], with_fix: npt.NDArray[np.bool_], types: list[str]
) -> tuple[npt.NDArray[np.int64], list[int], npt.NDArray[np.bool_]]:
    """Return times that do not jump where the clock was set, its steps, and which rows to keep."""
    forwards = np.diff(clock)
    forwards = forwards[(forwards > 0) & (forwards < _HOUR_US)]
    interval = int(np.median(forwards)) if forwards.size else 0
    time, kept, steps = clock.copy(), np.ones(clock.size, dtype=np.bool_), []
    newest, fixed = int(clock[0]), False
    newest_of: dict[str, int] = {}  # a type of sentence never repeats a time
    for row, now in enumerate(clock.tolist()):
        ahead = now - newest
        again = not fixed and bool(with_fix[row]) and now <= newest_of.get(types[row], now - 1)
        rolled = abs(ahead) > _HOUR_US and (ahead + _LEAP_US) % _ROLLOVER_US < 2 * _LEAP_US
        if ahead < -_LATE_US or rolled or (not fixed and (ahead > _HOUR_US or again)):
            following = clock[row + 1 : row + 3]
            alone = (np.abs(following - newest) < np.abs(following - now)).any()
            if (alone and not again) or (fixed and row + 1 == clock.size):
                kept[row] = False
                continue
            if fixed and ahead < -_LEAP_US and not rolled:
                raise GroundTruthError(
                    f"time runs backwards by {-ahead / 1e6:g} s at RMC/GGA sentence {row + 1}: "
                    "split the log there and use the part of this traverse"
                )
            time[:row] += ahead - interval
            steps.append(ahead - interval)
            newest, newest_of = now, {}
        newest_of[types[row]] = now
        newest, fixed = max(newest, now), fixed or bool(with_fix[row])
    return time, steps, kept


def _set_by_seconds(
    time: npt.NDArray[np.int64], kept: npt.NDArray[np.bool_], timed: list[_Sentence]
) -> Iterator[tuple[int, int]]:
    """Yield the rows at which the clock was set by seconds that `_steady` lets pass, and the steps.

    Of the type of sentence that begins each instant, times go on by one interval before and after.
    """
    types = np.array([sentence.type for sentence in timed])
    begins = Counter(types[np.flatnonzero(np.diff(time)) + 1].tolist())
    rows = np.flatnonzero(kept & (types == max(begins, key=lambda kind: begins[kind], default="")))
    gaps = np.diff(time[rows])
    if not (gaps > 0).any():
        return
    interval = float(np.median(gaps[gaps > 0]))
    regular = np.abs(gaps - interval) <= 0.1 * interval
    at = np.array([timed[row].position or (np.nan, np.nan) for row in rows])
    moved_m = great_circle(at[1:], at[:-1])
    for i in np.flatnonzero(~regular[2:-2]).tolist():
        beside = [i, i + 1, i + 3, i + 4]
        gap, step = int(gaps[i + 2]), round((gaps[i + 2] - interval) / 1e6) * 1_000_000
        whole = abs(gap - interval - step) <= 0.1 * interval and 0 < abs(step) < _LEAP_US
        if not (whole and regular[beside].all()):
            continue
        usual_m = float(moved_m[beside].mean())
        off_m = np.abs(moved_m[[*beside, i + 2]] - usual_m)
        was_set = gap < 0 or (gap == 0 and moved_m[i + 2] > max(usual_m / 2, _MOVED_M))
        if step > 0 and usual_m * step / interval >= _LACKS_M:
            was_set = bool((off_m <= _STEADY_SHARE * usual_m).all())
        if was_set:
            yield int(rows[i + 3]), step


def _no_fix(dropped: Counter[str], others: list[str]) -> GroundTruthError:
    """Return the error that says what the sentences lacked, and the remedy."""
    tally = ", ".join(f"{count} with {why}" for why, count in (+dropped).items()) or "none at all"
    remedy = "record again with the receiver under open sky, or give a .csv track"
    if others and not +dropped:
        remedy = f"it has {others[0]} sentences: let the receiver send RMC or GGA"
    most = max(dropped, key=lambda why: dropped[why], default="")
    if dropped[most] and most in ("bad checksum", "unreadable field", "no checksum"):
        remedy = "copy the log again, as it was edited or damaged, or give a .csv track"
    return GroundTruthError(f"no RMC or GGA sentence with a fix ({tally}): {remedy}")
