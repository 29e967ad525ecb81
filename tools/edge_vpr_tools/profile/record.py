"""Profile as a value: the content of `profile.json`, which can be read and written."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr.files import parse_errors, read_json
from edge_vpr.results import RecordError, RunRecord, from_json
from edge_vpr_tools.profile.conditions import Conditions
from edge_vpr_tools.profile.measurement import BOUNDED, Energy, Outcome
from edge_vpr_tools.profile.sensors.sensor import read_text
from edge_vpr_tools.profile.speed import SparseAgainstAll
from edge_vpr_tools.profile.workload import DesignResult, Throughput

PROFILE = "profile.json"
SCHEMA = 3


@dataclass(frozen=True)
class MapSize:
    """Size of the map that the load matches against."""

    places: int
    pixels: int
    bytes_per_place: int
    sequence_length: int


@dataclass(frozen=True)
class LoadRecord:
    """Load: the recording, the schedule of matches, and the events of a call."""

    recording: str
    every: str
    packet: int


@dataclass(frozen=True)
class Moments:
    """Conditions of the machine before, during and after the load."""

    before: Conditions
    loaded: Conditions
    after: Conditions
    void_because: str  #: Reason why the figures are void; empty if none is known.

    def named(self) -> dict[str, Conditions]:
        """Return the three conditions in their order, by name."""
        return {"before": self.before, "loaded": self.loaded, "after": self.after}


@dataclass(frozen=True)
class Provenance:
    """Origin of a profile; None if not known."""

    board: str | None
    processor: str
    kernel: str
    clock_hz: float | None
    governor: str | None
    sensor: str | None
    shunt_mohm: float | None
    versions: dict[str, str]

    @classmethod
    def of(cls, root: Path, loaded: Conditions, energy: Outcome, run: RunRecord) -> Provenance:
        """Determine the origin of a profile on this machine.

        Parameters
        ----------
        root : path
            Root of the file system.
        loaded : Conditions
            Conditions under load.
        """
        board = read_text(root / "proc/device-tree/model").rstrip("\0")
        readings = energy.readings if isinstance(energy, Energy) else None
        sensor = None if readings is None else readings.sensor
        return cls(
            board=board or read_text(root / "sys/class/dmi/id/product_name") or None,
            processor=run.machine.processor,
            kernel=platform.release(),
            clock_hz=loaded.frequency_hz,
            governor=loaded.governor,
            sensor=None if sensor is None else sensor.name,
            shunt_mohm=None if sensor is None else sensor.shunt_mohm,
            versions=run.versions,
        )


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Load measured on a machine."""

    schema: int = SCHEMA
    quick: bool  #: Whether windows were too short for a figure that can be published.
    throughput: Throughput
    map: MapSize
    energy: Outcome
    designs: tuple[DesignResult, ...]  #: Empty if no designs were compared.
    conditions: Moments
    sparse_against_all: SparseAgainstAll
    load: LoadRecord
    provenance: Provenance
    run: RunRecord

    @property
    def void(self) -> bool:
        """Whether the figures are void because the machine was throttled."""
        return bool(self.conditions.void_because)

    @classmethod
    def load_file(cls, path: Path) -> Profile:
        """Read a profile, by its file or the folder that holds it.

        Raises
        ------
        UsageError
            If the file is not a profile, or is of another version.
        """
        what, remedy = "a profile", "make one by edge-vpr profile"
        path = path / PROFILE if path.is_dir() else path
        values = read_json(path, what, remedy)
        if values.get("schema") != SCHEMA or "throughput" not in values:
            raise UsageError(f"{path} is not a profile that this edge-vpr reads: make it again")
        try:
            with parse_errors(path, what, remedy):
                return from_json(cls, values)
        except RecordError as error:
            raise UsageError(f"{path} is a damaged profile: {error}: make it again") from error


# Numbers of a profile by name, with their intervals.


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
