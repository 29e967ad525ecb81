"""The plan of a sweep (``sweep.toml``), and its trials."""

from __future__ import annotations

import hashlib
import itertools
import math
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import edge_vpr
from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr.evaluation.metrics import Evaluation, evaluate
from edge_vpr.files import open_input, read_toml
from edge_vpr.matching.drive import match_query
from edge_vpr.recordings import Recording, open_recording
from edge_vpr.recordings.reading import OnFault, TimeUnit, crop_of
from edge_vpr.reference_map import MatchMetrics, ReferenceMap
from edge_vpr.results import RecordError, from_json
from edge_vpr.settings import SETTING_FIELDS, Settings, resolve_settings
from edge_vpr.warm_up import mapping_steps, matching_steps, warm_up
from edge_vpr_tools.research.baselines import compare, open_baseline
from edge_vpr_tools.research.baselines.baseline import fastest
from edge_vpr_tools.research.experiments.pairs import Pair
from edge_vpr_tools.research.trials import ListedTrial, Store, key_of
from edge_vpr_tools.truth_files import TruthFiles

# One trial of a sweep: a variant of the method on one pair of drives with one seed.


@dataclass(frozen=True, kw_only=True)
class PairOfDrives:
    """Two recordings, the options for reading them, and the ground truth of the second."""

    #: reference, query: paths of the recordings.
    reference: str
    query: str
    ground_truth: tuple[str, ...]  #: Files, as for `edge-vpr evaluate --ground-truth`.
    #: tolerance, rows, frame_period, offset: as the flags of `evaluate` with these names.
    tolerance: tuple[float, ...] = ()
    rows: str | None = None
    frame_period: str | None = None
    offset: tuple[float, float] | None = None
    #: sensor, format, time_unit, topic, columns, on_fault: as the flags of `map` with these names,
    #: for both drives.
    sensor: str | None = None
    format: str | None = None
    time_unit: TimeUnit | None = None
    topic: str | None = None
    columns: str | None = None
    on_fault: OnFault = "error"
    #: start, end, start_offset: for the reference and for the query: seconds at which to start, at
    #: which to end, and from which these count, as the flags with these names.
    start: tuple[str, str] | None = None
    end: tuple[str, str] | None = None
    start_offset: tuple[str, str] | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all input files."""
        return (self.reference, self.query, *self.ground_truth)

    @property
    def truths(self) -> dict[str, TruthFiles]:
        """Ground truth by tolerance, which is read when it is called with centres of windows."""
        return {
            "" if each is None else f"{each:g}": TruthFiles(
                self.ground_truth, each, self.rows, self.frame_period, self.offset
            )
            for each in self.tolerance or (None,)
        }

    def open(self, which: int) -> Recording:
        """Open the reference (0) or the query (1).

        Raises
        ------
        EdgeVprError
            If it cannot be read.
        """
        recording = open_recording(
            (self.reference, self.query)[which], format=self.format, sensor=self.sensor,
            on_fault=self.on_fault, frame_period=self.frame_period, topic=self.topic,
            time_unit=self.time_unit, columns=self.columns,
        )  # fmt: skip
        given = (self.start, self.end, self.start_offset)
        crop = crop_of(*(None if pair is None else pair[which] for pair in given))
        return recording if crop is None else recording.cropped(crop)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Everything that determines a result; can be sent to another process or machine."""

    settings: Mapping[str, Any]  #: As returned by `Settings.to_dict`, with the seed.
    drives: PairOfDrives
    #: SHA-256 of each file of `drives.files`, in that order, and of those that `system` names.
    inputs: tuple[str, ...]
    version: str = edge_vpr.__version__  #: Version of edge-vpr.
    #: Name of a baseline (`open_baseline`), whose distances are matched as the settings say; None
    #: for the method itself.
    system: str | None = None

    @property
    def key(self) -> str:
        """Key of the result: a hash of settings, contents of inputs, and version.

        Names of files and variants have no effect on it.
        """
        drives = asdict(self.drives)
        for name in ("reference", "query", "ground_truth"):
            del drives[name]
        decides: list[Any] = [dict(self.settings), drives, self.inputs]
        if self.system is not None:
            decides.append(_FILE.sub(":", self.system))
        return key_of(self.version, *decides)


@dataclass(frozen=True, kw_only=True)
class Shares:
    """Shares of correct matches by one tolerance, and of how many windows that are judged."""

    tolerance: str  #: With its unit; empty where the truth has none.
    queries: int
    precision_at_100_recall: float
    recall_at_99_precision: float
    average_precision: float
    recall_at_1: float
    recall_at_5: float
    recall_at_10: float

    @classmethod
    def of(cls, found: Evaluation, **more: Any) -> Self:
        """Build from an evaluation."""
        recall = {f"recall_at_{n}": found.recall_at[n] for n in (1, 5, 10)}
        return cls(
            precision_at_100_recall=found.precision_at_100_recall,
            recall_at_99_precision=found.recall_at_99_precision,
            average_precision=found.average_precision,
            tolerance=found.truth.tolerance_text,
            queries=found.queries,
            **recall,
            **more,
        )


@dataclass(frozen=True, kw_only=True)
class TrialResult(Shares):
    """Result of a trial; the shares are by the first tolerance of the drives."""

    others: tuple[Shares, ...] = ()
    places: int
    pixels: int
    bytes_per_place: int
    packed_bytes_per_place: int
    events: int
    #: mapping_s, counting_s, microseconds_per_match: times on this machine, under its load during
    #: the trial; the last is the shortest of three (`fastest`), without a first use.
    mapping_s: float
    counting_s: float
    microseconds_per_match: float
    elapsed_s: float  #: Time of the whole trial on its worker.
    #: operations, packed_bytes_per_window: number of differences or products to compare one query
    #: window with the whole map, and size of the descriptors of the places that begin in a window.
    operations: int
    packed_bytes_per_window: int


def run_trial(trial: Trial) -> TrialResult:
    """Map, match and evaluate one trial.

    Raises
    ------
    EdgeVprError
        If an input cannot be used, or `trial` is of another version of edge-vpr.
    """
    start = time.perf_counter()
    if trial.version != edge_vpr.__version__:
        raise UsageError(
            f"this worker has edge-vpr {edge_vpr.__version__} and the sweep is of {trial.version}: "
            "install one version everywhere"
        )
    drives = trial.drives
    for file in (*drives.files, *_files_of(trial.system)):
        if not Path(file).exists():
            raise UsageError(
                f"{file} is not on this worker: name a path that all workers of a cluster share"
            )
    settings = Settings.from_dict(trial.settings, "the trial")
    if trial.system is None:
        judged, costs = _run_method(drives, settings)
    else:
        judged, costs = _run_system(drives, settings, trial.system)
    first, *others = judged
    return TrialResult.of(
        first,
        others=tuple(map(Shares.of, others)),
        **costs,
        elapsed_s=time.perf_counter() - start,
    )


def _run_method(
    drives: PairOfDrives, settings: Settings
) -> tuple[list[Evaluation], dict[str, Any]]:
    """Map and match two drives; return their evaluations, and the costs of a `TrialResult`."""
    # the times are of the work: a worker that is new would add those of compiling and loading
    warm_up(mapping_steps(settings))
    start = time.perf_counter()
    reference = ReferenceMap.build(drives.open(0), settings)
    mapping_s = time.perf_counter() - start
    warm_up(matching_steps(reference))
    matched = reference.match(drives.open(1))
    queries, metrics = matched.queries, matched.metrics
    assert queries is not None and isinstance(metrics, MatchMetrics)
    matches, matching_s = fastest(partial(match_query, reference, queries))
    times = reference.place_time_us, matched.query_time_us
    return [evaluate(matches, truth(*times)) for truth in drives.truths.values()], {
        "places": len(reference),
        "pixels": len(reference.pixel_map),
        "bytes_per_place": reference.bytes_per_place,
        "packed_bytes_per_place": reference.packed_bytes_per_place,
        "events": metrics.events,
        "mapping_s": mapping_s,
        "counting_s": metrics.counting_s,
        "microseconds_per_match": 1e6 * matching_s / len(matches),
        "operations": reference.places.counts.size,
        "packed_bytes_per_window": reference.packed_bytes_per_window,
    }


def _run_system(
    drives: PairOfDrives, settings: Settings, system: str
) -> tuple[list[Evaluation], dict[str, Any]]:
    """Count two drives at all pixels, compare them by a baseline, and match its distances."""
    start = time.perf_counter()
    baseline = open_baseline(system, settings.seed)
    truths = drives.truths
    counted = Pair(system, drives.open(0), drives.open(1), settings, truths).counted()
    places, queries = counted.reference, counted.query
    counting_s = time.perf_counter() - start
    compared = compare(baseline, places.images, queries.images)
    matches, matching_s = fastest(partial(counted.match, compared.distances, settings))
    times = places.centre_us, queries.centre_us
    return [evaluate(matches, truth(*times)) for truth in truths.values()], {
        "places": len(places.images),
        "pixels": places.images[0].size,
        "bytes_per_place": compared.bytes_per_place,
        "packed_bytes_per_place": compared.bytes_per_place,
        "events": int(queries.activity.sum()),
        # both drives are counted in one step
        "mapping_s": counting_s / 2,
        "counting_s": counting_s / 2,
        "microseconds_per_match": compared.query_us + 1e6 * matching_s / len(matches),
        "operations": compared.operations,
        "packed_bytes_per_window": compared.bytes_per_place,
    }


#: file that a system names, up to its windows or the next member of an ensemble
_FILE = re.compile(r":[^+@]*[/.][^+@]*")


def _files_of(system: str | None) -> list[str]:
    """Return the files of weights that a system names."""
    return [found[1:] for found in _FILE.findall(system or "")]


def sweep_store(folder: Path) -> Store[Trial, TrialResult]:
    """Return the store of a sweep in a folder."""
    return Store(folder, Trial, TrialResult)


# Plan of a sweep: the file ``sweep.toml``.


_REMEDY = "write it as docs/sweep.md shows"
_TABLES = ("seeds", "settings", "grid", "variants", "drives")
_MOST_TRIALS = 100_000


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All combinations of variants, drives and seeds."""

    variants: Mapping[str, Settings]
    drives: Mapping[str, PairOfDrives]
    seeds: tuple[int, ...]
    systems: Mapping[str, str] = field(default_factory=dict)

    def trials(self) -> dict[ListedTrial, Trial]:
        """Hash every input once, and return all trials by their names.

        Raises
        ------
        UsageError
            If an input cannot be read.
        """
        files = {file for drives in self.drives.values() for file in drives.files}
        files |= {file for system in self.systems.values() for file in _files_of(system)}
        hashes = {file: content_hash(Path(file)) for file in sorted(files)}
        found = {}
        for (drive, drives), (name, settings), seed in itertools.product(
            self.drives.items(), self.variants.items(), self.seeds
        ):
            system = self.systems.get(name)
            trial = Trial(
                settings=replace(settings, seed=seed).to_dict(),
                drives=drives,
                inputs=tuple(hashes[file] for file in (*drives.files, *_files_of(system))),
                system=system,
            )
            found[ListedTrial(variant=name, drives=drive, seed=seed, key=trial.key)] = trial
        return found


def read_plan(path: Path) -> Plan:
    """Read a plan; paths in it are relative to its folder.

    Parameters
    ----------
    path : Path
        TOML: ``seeds`` (a number, or a list); ``[settings]`` of all variants; ``[grid]`` with a
        list of values for each setting, every combination of which is a variant;
        ``[variants.NAME]`` with additional variants; ``[drives.NAME]`` with the fields of
        `PairOfDrives`. ``system`` beside the settings is the name of a baseline.

    Raises
    ------
    UsageError
        If the file cannot be read, or a name or value in it is wrong.
    """
    values = read_toml(path, "a sweep", _REMEDY)
    _check_names(values, _TABLES, str(path))
    tables = {name: _table(values, name, path) for name in _TABLES[1:]}
    drives = {
        name: _drives(one, f"{path}: drives.{name}", path.parent)
        for name, one in tables["drives"].items()
    }
    if not drives:
        raise UsageError(f"{path} names no drives: {_REMEDY}")
    seeds = _seeds(values.get("seeds", 1), path)
    for name, choices in tables["grid"].items():
        if not isinstance(choices, list) or not choices:
            raise UsageError(f"{path}: grid.{name} is {choices!r}: give a list of values")
    combined = math.prod(map(len, tables["grid"].values())) + len(tables["variants"])
    if combined * len(drives) * len(seeds) > _MOST_TRIALS:
        raise UsageError(f"{path} asks for more than {_MOST_TRIALS:,} trials: split it")
    found = list(_variants(tables, path))
    return Plan(
        variants={name: settings for name, settings, _ in found},
        drives=drives,
        seeds=seeds,
        systems={name: system for name, _, system in found if system is not None},
    )


def content_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of all files of a folder.

    Raises
    ------
    UsageError
        If a file cannot be read.
    """
    try:
        if not path.is_dir():
            with open_input(path) as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        whole = hashlib.sha256()
        for inner in sorted(file for file in path.rglob("*") if file.is_file()):
            whole.update(f"{inner.relative_to(path)}\0{content_hash(inner)}\n".encode())
        return whole.hexdigest()
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}): check the path") from error


def _variants(tables: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Settings, str | None]]:
    common, grid = tables["settings"], tables["grid"]
    # without a grid and without variants, the settings are the only variant
    if grid or not tables["variants"]:
        for values in itertools.product(*grid.values()):
            changes = dict(zip(grid, values, strict=True))
            name = " ".join(f"{key}={_word(value)}" for key, value in changes.items())
            yield name or "settings", *_resolved(common, changes, f"{path}: grid", path.parent)
    for name, changes in tables["variants"].items():
        if not isinstance(changes, Mapping):
            raise UsageError(f"{path}: variants.{name} is {changes!r}: give settings")
        yield name, *_resolved(common, changes, f"{path}: variants.{name}", path.parent)


def _resolved(
    common: Mapping[str, Any], own: Mapping[str, Any], where: str, folder: Path
) -> tuple[Settings, str | None]:
    """Return the settings of a variant, and the name of its baseline, if it is one."""
    values = {**common, **own}
    preset, system = values.pop("preset", "default"), values.pop("system", None)
    if "seed" in values:
        raise UsageError(f"{where} sets seed: name the seeds of all variants as seeds = [...]")
    known = {one.key for one in SETTING_FIELDS.values()} | set(SETTING_FIELDS)
    _check_names(values, ("preset", "system", *sorted(known)), where)
    try:
        settings, system = resolve_settings(preset, None, values), _system(system, folder)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None
    if system is not None and settings.window_parts > 1:
        raise UsageError(
            f"{where}: setting places_per_window = {settings.places_per_window} with system = "
            f"{system}: systems compare one place per window; leave places_per_window out"
        )
    return settings, system


def _system(given: object, folder: Path) -> str | None:
    """Return the name of a baseline with paths from a folder, after a try to open it."""
    if given is None:
        return None
    if not isinstance(given, str):
        raise UsageError(f"system is {given!r}: give the name of a baseline, such as hog")
    system = _FILE.sub(lambda found: f":{folder / found[0][1:]}", given)
    open_baseline(system)
    return system


def _drives(values: object, where: str, folder: Path) -> PairOfDrives:
    if not isinstance(values, Mapping):
        raise UsageError(f"{where} is {values!r}: give reference, query and ground_truth")
    _check_names(values, tuple(one.name for one in fields(PairOfDrives)), where)
    given = dict(values)
    for name in ("start", "end", "start_offset"):
        if isinstance(given.get(name), list):
            given[name] = [str(value) for value in given[name]]
    if isinstance(given.get("ground_truth"), str):
        given["ground_truth"] = [given["ground_truth"]]
    if isinstance(given.get("tolerance"), int | float):
        given["tolerance"] = [given["tolerance"]]
    try:
        drives = from_json(PairOfDrives, given)
    except RecordError as error:
        raise UsageError(f"{where}: {error}: {_REMEDY}") from None
    return replace(
        drives,
        reference=str(folder / drives.reference),
        query=str(folder / drives.query),
        ground_truth=tuple(str(folder / file) for file in drives.ground_truth),
    )


def _seeds(given: object, path: Path) -> tuple[int, ...]:
    if type(given) is int and given > _MOST_TRIALS:
        raise UsageError(f"{path} asks for more than {_MOST_TRIALS:,} trials: split it")
    seeds = list(range(given)) if type(given) is int and given > 0 else given
    if (
        not isinstance(seeds, list)
        or not seeds
        or not all(type(seed) is int and 0 <= seed < 1 << 32 for seed in seeds)
        or len(set(seeds)) < len(seeds)
    ):
        raise UsageError(
            f"{path}: seeds is {given!r}: give how many, or a list of different whole numbers"
        )
    return tuple(seeds)


def _table(values: Mapping[str, Any], name: str, path: Path) -> Mapping[str, Any]:
    table = values.get(name, {})
    if not isinstance(table, Mapping):
        raise UsageError(f"{path}: {name} is {table!r}: {_REMEDY}")
    return table


def _check_names(values: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for name in values:
        if name not in known:
            raise UsageError(
                f"{where} has the unknown name {name!r}{did_you_mean(name, known)} (known: "
                f"{', '.join(known)})"
            )


def _word(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
