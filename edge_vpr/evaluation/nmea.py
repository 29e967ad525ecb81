"""GPS logs as receivers send them: RMC or GGA sentences of NMEA 0183, any talker."""

from __future__ import annotations

import datetime as dt
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.fixes import Fixes

_DAY_US = 86_400_000_000
_SENTENCE = re.compile(
    r"\$(?P<body>[A-Z]{2}(?P<type>RMC|GGA),[^*$\r\n]*)(?:\*(?P<sum>[0-9A-Fa-f]{2}))?"
)
_OTHER = re.compile(r"\$(?:[A-Z]{2})?(GNS|GLL|PUBX)\b")
_TIME = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d{1,6})\d*)?")
_ANGLE = re.compile(r"(\d{1,3})(\d\d(?:\.\d*)?)")
#: Modes of RMC and qualities of GGA of positions that were estimated, entered or simulated.
_NOT_MEASURED = ("E", "M", "S", "6", "7", "8")
_ESTIMATED = "an estimated fix"


def is_nmea(text: str) -> bool:
    """Return whether a text holds a sentence that `read_nmea` reads."""
    return _SENTENCE.search(text) is not None


def read_nmea(text: str) -> Fixes:
    """Read the RMC sentences of a log, or its GGA sentences if no RMC has a fix.

    Time 0 is the first of them with a time, with or without a fix. A time of day that is more than
    12 hours before the last one is of the next day. Left out and counted are sentences with a wrong
    checksum, or without one if others have one; without a fix; and of an instant of which a
    sentence calls the position estimated.

    Raises
    ------
    GroundTruthError
        If no sentence has a fix, or the receiver's clock was set back, on to another date, or
        before the first fix, so that the log does not say when it began.
    """
    dropped: Counter[str] = Counter()
    sentences = list(_sentences(text, dropped))
    if any(sentence.checked for sentence in sentences):
        unchecked = sum(not sentence.checked for sentence in sentences)
        dropped["no checksum"] += unchecked
        sentences = [sentence for sentence in sentences if sentence.checked]
    estimated = {each.time_of_day_us for each in sentences if each.lacks == _ESTIMATED}
    sentences = [
        replace(each, position=None, lacks=_ESTIMATED)
        if each.position and each.time_of_day_us in estimated
        else each
        for each in sentences
    ]
    for kind in ("RMC", "GGA"):
        of_kind = [sentence for sentence in sentences if sentence.type == kind]
        if any(sentence.position for sentence in of_kind):
            break
    else:
        dropped.update(sentence.lacks for sentence in sentences)
        raise _no_fix(dropped, _OTHER.findall(text))
    dropped.update(sentence.lacks for sentence in of_kind if sentence.lacks)
    timed = [sentence for sentence in of_kind if sentence.time_of_day_us is not None]
    of_day = np.array([sentence.time_of_day_us for sentence in timed])
    step = (np.diff(of_day) + _DAY_US // 2) % _DAY_US - _DAY_US // 2
    time = np.append(0, np.cumsum(step))
    # some receivers change the date seconds after midnight
    midnights = (time + of_day[0]) // _DAY_US
    day: int | None = None
    for row, sentence in enumerate(timed):
        if row and step[row - 1] < 0:
            raise _clock_error(f"time runs backwards by {-step[row - 1] / 1e6:,.12g} s", kind, row)
        if sentence.ordinal is not None:
            zero = sentence.ordinal - int(midnights[row])
            if day is not None and abs(zero - day) > 1:
                raise _clock_error(f"the date changes by {abs(zero - day):,} days", kind, row)
            day = zero if day is None else max(day, zero)
    rows = [row for row, sentence in enumerate(timed) if sentence.position]
    early = step[: rows[0]][step[: rows[0]] > 0]
    if early.size and early.max() >= 2 * early.min():  # else lost sentences would pass for time
        row = int(np.argmax(step[: rows[0]])) + 1
        raise _clock_error(
            f"before the first fix, time steps by {early.max() / 1e6:,.12g} s", kind, row
        )
    start = None
    if day is not None:
        start = dt.datetime.fromordinal(day).replace(tzinfo=dt.UTC)
        start += dt.timedelta(microseconds=int(of_day[0]))
    return Fixes(
        time[rows],
        np.array([timed[row].position for row in rows]),
        "geographic",
        start,
        dropped,
        len(rows) + sum(dropped.values()),
    )


def _clock_error(what: str, kind: str, row: int) -> GroundTruthError:
    return GroundTruthError(
        f"{what} at {kind} sentence {row + 1}, where the receiver set its clock or another log "
        "begins: keep the sentences on one side of it, and give the second of the recording at "
        "which they begin (Track.shifted)"
    )


@dataclass(frozen=True)
class _Sentence:
    type: str  # RMC or GGA
    checked: bool  # whether it has a checksum, which fits
    time_of_day_us: int | None  # None before the receiver has a time
    ordinal: int | None  # proleptic day number of the date, if stated
    position: tuple[float, float] | None  # None if the receiver had no fix
    lacks: str  # why it has no position


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
            dropped["unreadable field"] += 1


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
    if kind == "RMC":
        valid, first = fields[2] == "A", 3  # the field of the latitude
        how = fields[12] if len(fields) > 12 else ""
        if fields[9]:
            ordinal = dt.datetime.strptime(fields[9], "%d%m%y").toordinal()
    else:
        valid, first = fields[6] not in ("", "0"), 2
        how = fields[6]
    if how in _NOT_MEASURED:
        return _Sentence(kind, checked, time, ordinal, None, _ESTIMATED)
    if time is None or not valid:
        return _Sentence(kind, checked, time, ordinal, None, "no fix")
    latitude = _degrees(fields[first], fields[first + 1], "NS", 90.0)
    longitude = _degrees(fields[first + 2], fields[first + 3], "EW", 180.0)
    return _Sentence(kind, checked, time, ordinal, (latitude, longitude), "")


def _degrees(value: str, side: str, sides: str, limit: float) -> float:
    """Convert ``2730.39720,S`` (degrees and minutes) to signed degrees."""
    angle = _ANGLE.fullmatch(value)
    if angle is None or side not in tuple(sides):
        raise ValueError
    degrees = int(angle[1]) + float(angle[2]) / 60.0
    if float(angle[2]) >= 60.0 or degrees > limit:
        raise ValueError
    return degrees if side == sides[0] else -degrees


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
