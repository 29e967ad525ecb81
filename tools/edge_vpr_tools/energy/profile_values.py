"""The numbers of a profile by name, each with its interval where it has one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

_ENERGY = (
    "marginal_j_per_match", "saturated_j_per_match", "mission_j_per_match", "matches_per_joule",
    "idle_w",
)  # fmt: skip


NOT_MEASURED, NOT_RESOLVED, VOID = "not measured", "not resolved", "void: throttled"


class Number(NamedTuple):
    """A figure; `value` is None where there is none, and `why` says why."""

    name: str
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""


def numbers(found: dict[str, Any]) -> list[Number]:
    """Gather the numbers of a profile, in a fixed order and under the same names in each."""
    return [*_numbers(found)]


def _numbers(found: dict[str, Any]) -> Iterator[Number]:
    for name, value in found["throughput"].items():
        yield Number(name, value)
    for name, against in found["sparse_against_all"].items():
        for pixels in ("sparse", "all"):
            yield Number(f"{name}_{pixels}_pixels", against[f"{pixels}_pixels"])
            yield Number(
                f"{name}_{pixels}_s_per_{against['unit'].split()[-1]}",
                *against[f"{pixels}_s"].values(),
            )
        yield Number(f"{name}_times_faster", *against["times"].values())
    void = bool(found["conditions"]["void_because"])
    for name in _ENERGY:
        yield _of_energy(found["energy"], name, name, void)
    for design in found["designs"]:
        prefix = design["name"]
        yield Number(f"{prefix}: precision_at_100_recall", design["precision_at_100_recall"])
        yield Number(f"{prefix}: bytes_per_place", design["bytes_per_place"])
        yield Number(
            f"{prefix}: cpu_s_per_match", design["cpu_s_per_match"],
            *design["cpu_s_per_match_interval"],
        )  # fmt: skip
        yield _of_energy(design["energy"] or {}, _ENERGY[0], f"{prefix}: {_ENERGY[0]}", void)


def _of_energy(energy: dict[str, Any], key: str, name: str, void: bool) -> Number:
    value = energy.get(key)
    if value is None:
        why = NOT_RESOLVED if "idle_w" in energy else NOT_MEASURED
        return Number(name, None, why=VOID if void else why)
    return Number(name, value, *(energy.get(f"{key}_interval") or ()))
