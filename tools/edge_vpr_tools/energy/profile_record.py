"""Profile as a value: the content of `profile.json`, which can be read and written."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.plain_values import read_json, understood
from edge_vpr_tools.energy.conditions import Conditions
from edge_vpr_tools.energy.design_trials import DesignResult
from edge_vpr_tools.energy.energy_record import Energy, Outcome
from edge_vpr_tools.energy.sensors.sensor import read_text
from edge_vpr_tools.energy.speed import SparseAgainstAll
from edge_vpr_tools.energy.throughput import Throughput
from edge_vpr_tools.output.json_records import RecordError, from_json
from edge_vpr_tools.output.provenance import RunRecord

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
    """Conditions of the machine before, during and after the load.

    Attributes
    ----------
    before, loaded, after : Conditions
    void_because : str
        Reason why the figures are void; empty if none is known.
    """

    before: Conditions
    loaded: Conditions
    after: Conditions
    void_because: str

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
        energy : Energy or NotMeasured
        run : RunRecord
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
    """Load measured on a machine.

    Attributes
    ----------
    schema : int
    quick : bool
        Whether windows were too short for a figure that can be published.
    throughput : Throughput
    map : MapSize
    energy : Energy or NotMeasured
    designs : tuple of DesignResult
        Empty if no designs were compared.
    conditions : Moments
    sparse_against_all : SparseAgainstAll
    load : LoadRecord
    provenance : Provenance
    run : RunRecord
    """

    schema: int = SCHEMA
    quick: bool
    throughput: Throughput
    map: MapSize
    energy: Outcome
    designs: tuple[DesignResult, ...]
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
        """Read a profile.

        Raises
        ------
        UsageError
            If the file is not a profile, or is of another version.
        """
        what, remedy = "a profile", "make one by edge-vpr profile"
        values = read_json(path, what, remedy)
        if values.get("schema") != SCHEMA or "throughput" not in values:
            raise UsageError(f"{path} is not a profile that this edge-vpr reads: make it again")
        try:
            with understood(path, what, remedy):
                return from_json(cls, values)
        except RecordError as error:
            raise UsageError(f"{path} is a damaged profile: {error}: make it again") from error
