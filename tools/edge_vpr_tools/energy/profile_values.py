"""Numbers of a profile by name, with their intervals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import NamedTuple

from edge_vpr_tools.energy.energy_record import BOUNDED, Energy, Outcome
from edge_vpr_tools.energy.profile_record import Profile

NOT_MEASURED, NOT_RESOLVED, VOID = "not measured", "not resolved", "void: throttled"


class Number(NamedTuple):
    """Figure of a profile; if `value` is None, `why` states the reason."""

    name: str
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""


def numbers(found: Profile) -> list[Number]:
    """Return the numbers of a profile, in the same order and with the same names for each."""
    return [*_numbers(found)]


def _numbers(found: Profile) -> Iterator[Number]:
    for name, value in asdict(found.throughput).items():
        yield Number(name, value)
    for name, against in found.sparse_against_all.parts().items():
        sides = (
            ("sparse", against.sparse_pixels, against.sparse_s),
            ("all", against.all_pixels, against.all_s),
        )
        for pixels, count, seconds in sides:
            yield Number(f"{name}_{pixels}_pixels", count)
            yield Number(f"{name}_{pixels}_s_per_{against.unit.split()[-1]}", *seconds)
        yield Number(f"{name}_times_faster", *against.times)
    for name in BOUNDED:
        yield _of_energy(found.energy, name, name, found.void)
    for design in found.designs:
        prefix = design.name
        yield Number(f"{prefix}: precision_at_100_recall", design.precision_at_100_recall)
        yield Number(f"{prefix}: bytes_per_place", design.bytes_per_place)
        cpu = (design.cpu_s_per_match, *design.cpu_s_per_match_interval)
        yield Number(f"{prefix}: cpu_s_per_match", *cpu)
        yield _of_energy(design.energy, BOUNDED[0], f"{prefix}: {BOUNDED[0]}", found.void)


def _of_energy(energy: Outcome | None, key: str, name: str, void: bool) -> Number:
    figures = energy.figures if isinstance(energy, Energy) else None
    if void or figures is None:
        return Number(name, None, why=VOID if void else NOT_MEASURED)
    bounded = figures.bounded(key)
    if bounded.value is None:
        return Number(name, None, why=NOT_RESOLVED)
    return Number(name, *bounded)
