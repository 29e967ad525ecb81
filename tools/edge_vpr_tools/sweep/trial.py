"""One trial of a sweep: a variant of the method on one pair of drives with one seed."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import edge_vpr
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Sensor
from edge_vpr.recordings import Recording, open_recording, parse_period
from edge_vpr.recordings.time_crop import TimeCrop, seconds_us
from edge_vpr.settings import Settings
from edge_vpr_tools.runs.mapping import map_recording
from edge_vpr_tools.runs.matching import match_recording
from edge_vpr_tools.runs.truth_files import load_truth

#: version of the key and of the result's file
SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class PairOfDrives:
    """Two recordings, the options for reading them, and the ground truth of the second.

    Attributes
    ----------
    reference, query : str
        Paths of the recordings.
    ground_truth : tuple of str
        Files, as for `edge-vpr evaluate --ground-truth`.
    tolerance, rows, frame_period, offset
        As the flags of `evaluate` with these names.
    sensor, format, time_unit, topic, columns, on_fault
        As the flags of `map` with these names, for both drives.
    start, end, start_offset : (str, str), optional
        For the reference and for the query: seconds at which to start, at which to end, and from
        which these count, as the flags with these names.
    """

    reference: str
    query: str
    ground_truth: tuple[str, ...]
    tolerance: float | None = None
    rows: str | None = None
    frame_period: str | None = None
    offset: tuple[float, float] | None = None
    sensor: str | None = None
    format: str | None = None
    time_unit: str | None = None
    topic: str | None = None
    columns: str | None = None
    on_fault: str = "error"
    start: tuple[str, str] | None = None
    end: tuple[str, str] | None = None
    start_offset: tuple[str, str] | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all input files."""
        return (self.reference, self.query, *self.ground_truth)

    def open(self, which: int) -> Recording:
        """Open the reference (0) or the query (1).

        Raises
        ------
        EdgeVprError
            If it cannot be read.
        """
        period = None if self.frame_period is None else parse_period(self.frame_period)
        recording = open_recording(
            (self.reference, self.query)[which],
            format=self.format,
            sensor=None if self.sensor is None else Sensor.parse(self.sensor),
            on_fault=self.on_fault,
            frame_period=period,
            topic=self.topic,
            time_unit=self.time_unit,
            columns=self.columns,
        )
        if self.start is self.end is self.start_offset is None:
            return recording
        start, end, offset = (
            None if pair is None else seconds_us(pair[which], name)
            for name, pair in (
                ("start", self.start), ("end", self.end), ("start_offset", self.start_offset)
            )
        )  # fmt: skip
        return recording.cropped(TimeCrop(start_us=start or 0, end_us=end, offset_us=offset))


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Everything that determines a result; can be sent to another process or machine.

    Attributes
    ----------
    settings : mapping
        As returned by `Settings.to_dict`, with the seed.
    drives : PairOfDrives
    inputs : tuple of str
        SHA-256 of each file of `drives.files`, in that order.
    version : str
        Version of edge-vpr.
    """

    settings: Mapping[str, Any]
    drives: PairOfDrives
    inputs: tuple[str, ...]
    version: str = edge_vpr.__version__

    @property
    def key(self) -> str:
        """Key of the result: a hash of settings, contents of inputs, and version.

        Names of files and variants have no effect on it.
        """
        drives = asdict(self.drives)
        for name in ("reference", "query", "ground_truth"):
            del drives[name]
        decides = [SCHEMA, self.version, dict(self.settings), drives, self.inputs]
        text = json.dumps(decides, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:32]


@dataclass(frozen=True, kw_only=True)
class TrialResult:
    """Result of a trial.

    Attributes
    ----------
    precision_at_100_recall, recall_at_99_precision, average_precision, recall_at_1 : float
    queries, places, pixels, bytes_per_place, packed_bytes_per_place, events : int
    mapping_s, counting_s, microseconds_per_match : float
        Times on this machine, under its load during the trial.
    elapsed_s : float
        Time of the whole trial on its worker.
    """

    precision_at_100_recall: float
    recall_at_99_precision: float
    average_precision: float
    recall_at_1: float
    queries: int
    places: int
    pixels: int
    bytes_per_place: int
    packed_bytes_per_place: int
    events: int
    mapping_s: float
    counting_s: float
    microseconds_per_match: float
    elapsed_s: float


@dataclass(frozen=True, kw_only=True)
class KeptResult:
    """Stored result, with its trial."""

    key: str
    trial: Trial
    found: TrialResult
    schema: int = SCHEMA


@dataclass(frozen=True, kw_only=True)
class KeptFailure:
    """Stored failure of a trial.

    Attributes
    ----------
    error : str
        One-line message.
    where : str
        Traceback; empty if the worker died.
    """

    key: str
    trial: Trial
    error: str
    where: str = ""
    schema: int = SCHEMA


def run_trial(trial: Trial) -> TrialResult:
    """Map, match and evaluate one trial.

    Raises
    ------
    EdgeVprError
        If an input cannot be used, or `trial` is of another version of edge-vpr.
    """
    begin = time.perf_counter()
    if trial.version != edge_vpr.__version__:
        raise UsageError(
            f"this worker has edge-vpr {edge_vpr.__version__} and the sweep is of {trial.version}: "
            "install one version everywhere"
        )
    drives = trial.drives
    for file in drives.files:
        if not Path(file).exists():
            raise UsageError(
                f"{file} is not on this worker: name a path that all workers of a cluster share"
            )
    settings = Settings.from_dict(trial.settings, "the trial")
    mapped = map_recording(drives.open(0), settings)
    matched = match_recording(mapped.reference, drives.open(1))
    matches, reference = matched.matches, mapped.reference
    truth = load_truth(
        drives.ground_truth,
        reference.places.centre_us,
        matched.queries.centre_us,
        tolerance=drives.tolerance,
        rows=drives.rows,
        frame_period=drives.frame_period,
        offset_s=drives.offset,
    )
    found = evaluate(matches, truth)
    return TrialResult(
        precision_at_100_recall=found.precision_at_100_recall,
        recall_at_99_precision=found.recall_at_99_precision,
        average_precision=found.curve.average_precision,
        recall_at_1=found.recall_at[1],
        queries=found.queries,
        places=len(reference),
        pixels=len(reference.pixel_map),
        bytes_per_place=reference.bytes_per_place,
        packed_bytes_per_place=reference.packed_bytes_per_place,
        events=int(matched.queries.events.sum()),
        mapping_s=mapped.seconds,
        counting_s=matched.counting_s,
        microseconds_per_match=1e6 * matched.matching_s / len(matches),
        elapsed_s=time.perf_counter() - begin,
    )
