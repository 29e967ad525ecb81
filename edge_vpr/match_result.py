"""Matches of a drive with a map: `ReferenceMap.match`, and the folder of results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_archive, write_archive
from edge_vpr.compiling import working_s
from edge_vpr.confidence import OFF_MAP_MISFIT
from edge_vpr.descriptors.counting import (
    DescriptorStream,
    Removed,
    check_sensor,
    cleaned,
    count_windows,
)
from edge_vpr.descriptors.published import WindowSource
from edge_vpr.descriptors.windows import Descriptors, WindowCounts, collect, window_of
from edge_vpr.drive_inputs import (
    AnyRecording,
    check_reading,
    loaded_track,
    odometry_of,
    of_part,
    opened,
    unix_start,
)
from edge_vpr.errors import MapError, UsageError, as_path, expect, kind_of
from edge_vpr.evaluation.facts import Drive, facts
from edge_vpr.evaluation.ground_truth import Alignment, GroundTruth, from_tracks
from edge_vpr.evaluation.metrics import Evaluation, RecallDenominator, evaluate
from edge_vpr.evaluation.tables import AnyOdometry
from edge_vpr.evaluation.track_files import AnyTrack
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.matching.drive import match_query
from edge_vpr.matching.match import join_matches
from edge_vpr.matching.matches import Matches, write_csv
from edge_vpr.odometry import Odometry
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.odometry_feed import OdometryFeed
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.recordings import Faults, Recording
from edge_vpr.recordings.memory import FORMAT as MEMORY
from edge_vpr.recordings.reading import EventSource
from edge_vpr.records import write_json
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import (
    MAP,
    MATCHES,
    MATCHES_CSV,
    METRICS,
    QUERIES,
    QUERIES_KIND,
    RUN,
    WINDOWS,
    RunRecord,
    read_run,
    results_folder,
    run_record,
)
from edge_vpr.settings import Score, Settings

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


def match(
    reference: ReferenceMap,
    recording: AnyRecording,
    changes: Mapping[str, Any],
    *,
    settings: Settings | None,
    every: str | MatchSchedule | None,
    odometry: AnyOdometry | None,
) -> MatchResult:
    """Match a drive with a map, see `ReferenceMap.match`."""
    check_reading(changes, "match")
    with_settings = reference.with_settings if every is None else reference.causal_with
    matched = with_settings(settings, changes, "match")
    inputs = tuple(str(each) for each in (recording, odometry) if isinstance(each, str | Path))
    drive = opened(recording, default=reference.camera)
    if isinstance(drive, Recording) and drive is recording and drive.format != MEMORY:
        inputs = (str(drive.path), *inputs)
    odometry = of_part(drive, odometry_of(odometry))
    if every is None:
        result = _match_windows(matched, drive, odometry)
    elif isinstance(drive, WindowSource):
        raise UsageError(
            "matching event by event (every=) needs events, and this file holds "
            "counts of windows: leave it out"
        )
    else:
        result = _match_events(matched, drive, every, odometry)
    # the map as it was passed: settings of one run are no part of it
    windows = None if result.windows is None else reference.coded(result.windows)
    return replace(
        result, reference=reference, inputs=inputs, start_us=drive.cropped_us,
        clock_us=unix_start(drive), windows=windows,
    )  # fmt: skip


def _match_windows(
    reference: ReferenceMap,
    drive: EventSource | WindowSource,
    odometry: Odometry | None,
) -> MatchResult:
    """Count the windows of a drive and match all of them."""
    removed = Removed()
    start = working_s()
    queries = describe_query(reference, drive, removed=removed)
    counting_s = working_s() - start
    start = working_s()
    matches = match_query(reference, queries, odometry)
    matching_s = working_s() - start
    metrics = MatchMetrics(
        queries=len(matches),
        places=len(reference),
        pixels=len(reference.pixel_map),
        bytes_per_place=reference.bytes_per_place,
        packed_bytes_per_place=reference.packed_bytes_per_place,
        events=int(queries.events.sum()),
        counting_s=counting_s,
        matching_s=matching_s,
        tied_queries=int((matches.ties > 0).sum()),
        faults_dropped=drive.faults,
    )
    return MatchResult(reference, matches, queries, metrics, removed)


def describe_query(
    reference: ReferenceMap,
    recording: EventSource | WindowSource,
    removed: Removed | None = None,
) -> Descriptors:
    """Describe a query drive in the same way as the places of a map, with its codes.

    Parameters
    ----------
    removed : Removed, optional
        Filled with how much the cleaning took.

    Returns
    -------
    Descriptors
        At least one.
    """
    counted = count_windows(recording, reference.pixel_map, reference.settings, removed)
    return reference.coded(counted)


def _match_events(
    reference: ReferenceMap,
    drive: EventSource,
    every: str | MatchSchedule,
    odometry: Odometry | None,
) -> MatchResult:
    """Feed the events of a drive to a localiser, and count its windows in the same pass."""
    check_sensor(drive.sensor, reference.pixel_map.sensor)
    localiser = Localiser(reference, every=every)
    stream: DescriptorStream | None = DescriptorStream(
        reference.pixel_map, window_of(reference.settings)
    )
    windows: list[WindowCounts] = []
    parts: list[npt.NDArray[np.void]] = []
    events_fed, busy_s = 0, 0.0
    removed, fed = Removed(), OdometryFeed(localiser, odometry)
    for events in cleaned(drive, reference.settings, removed):
        start = working_s()
        parts += fed.update(events)
        busy_s += working_s() - start
        events_fed += events.size
        if stream is not None:
            try:
                windows += stream.windows(events)
            except UsageError:  # more than are kept, which matching does not need
                stream, windows = None, []
    end_us = drive.end_us
    start = working_s()
    parts += fed.finish(end_us)
    busy_s += working_s() - start
    if stream is not None and end_us is not None:
        windows += stream.advance(end_us)
    rows = join_matches(parts)
    if rows.size == 0:
        raise UsageError(
            "the recording ended before a sequence of "
            f"{reference.settings.windows_per_match} windows was complete: take shorter "
            "windows or a longer drive"
        )
    metrics = OnlineMetrics(
        matches=len(rows),
        events=events_fed,
        every=every if isinstance(every, str) else repr(every),
        localising_s=busy_s,
        times_real_time=float(rows["time_us"][-1] / 1e6) / busy_s,
        faults_dropped=drive.faults,
    )
    matches = Matches.of_rows(rows, reference.settings, len(reference))
    counted = collect(windows, len(reference.pixel_map))
    counted = replace(counted, selected=counted.selected_events)
    return MatchResult(
        reference, matches, None, metrics, removed, windows=counted if len(counted) else None
    )


# A result, and its folder.


@dataclass(frozen=True, kw_only=True)
class MatchMetrics:
    """Sizes and times of a run, the first part of `metrics.json`.

    The times are without those of compiling and loading kernels.

    Attributes
    ----------
    queries, places, pixels, bytes_per_place, packed_bytes_per_place, events : int
        Numbers of windows, places and pixels, bytes of a place as stored and packed, and
        events counted.
    counting_s, matching_s : float
        Seconds that counting and matching took.
    tied_queries : int
        Queries with other places at the same smallest distance.
    faults_dropped : Faults
        Faulty entries of the recording that were left out.
    """

    queries: int
    places: int
    pixels: int
    bytes_per_place: int
    packed_bytes_per_place: int
    events: int
    counting_s: float
    matching_s: float
    tied_queries: int
    faults_dropped: Faults


@dataclass(frozen=True, kw_only=True)
class OnlineMetrics:
    """Sizes and times of a run event by event, the first part of `metrics.json`.

    Attributes
    ----------
    matches, events : int
        Numbers of matches given and events read.
    every : str
        When a match was given, as the user wrote it.
    localising_s, times_real_time : float
        Seconds that the run took, and the length of the recording divided by them.
    faults_dropped : Faults
        Faulty entries of the recording that were left out.
    """

    matches: int
    events: int
    every: str
    localising_s: float
    times_real_time: float
    faults_dropped: Faults


@dataclass(frozen=True, eq=False)
class MatchResult:
    """Matches of a query drive with a map, from `ReferenceMap.match`.

    >>> from edge_vpr import ReferenceMap
    >>> from edge_vpr.simulation import simulate_pair
    >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
    >>> result = ReferenceMap.build(monday, pixels=50).match(tuesday)
    >>> result, result.evaluate((monday.track, tuesday.track), 10).precision_at_100_recall
    (MatchResult(Matches(8 queries, 12 places, place filter, 0 tied)), 1.0)

    Two results are equal only if they are one object; maps and `matches` are equal by their values.

    Attributes
    ----------
    reference : ReferenceMap
        The map, with its own settings (those of the run are in `matches`).
    queries : Descriptors or None
        The windows of the query; None where it was matched event by event.
    windows : Descriptors or None
        Where it was matched event by event, its whole windows, for the report; None if there are
        none, or more than `MAX_WINDOWS`.
    metrics : MatchMetrics or OnlineMetrics or None
        Sizes and times of the run; None where the result was loaded.
    removed : Removed
        Events that cleaning removed from the query.
    inputs : tuple of str
        Files that were read, as far as they are known.
    start_us : int
        Where the part that was matched (`Recording.cropped`, ``--start``) begins in the recording.
    clock_us : int
        Start of the recording, where its clock counts from 1970; else 0.
    """

    reference: ReferenceMap
    matches: Matches
    queries: Descriptors | None = None
    metrics: MatchMetrics | OnlineMetrics | None = None
    removed: Removed = field(default_factory=Removed)
    inputs: tuple[str, ...] = ()
    start_us: int = 0
    clock_us: int = 0
    windows: Descriptors | None = None

    def __len__(self) -> int:
        return len(self.matches)

    def __repr__(self) -> str:
        return f"MatchResult({self.matches!r})"

    @property
    def query_time_us(self) -> npt.NDArray[np.int64]:
        """Times of the queries from the recording's start, shape (Q,).

        The centres of all windows, or those of the matches.
        """
        of_part = self.matches.time_us if self.queries is None else self.queries.centre_us
        return of_part + self.start_us

    def truth(
        self,
        reference_track: AnyTrack,
        query_track: AnyTrack,
        tolerance_m: float,
    ) -> GroundTruth:
        """Return the correct places of each query, from the tracks of both drives.

        Parameters
        ----------
        reference_track, query_track : Track or path or table
            See `load_track`. Time 0 of each is the start of its recording.
        tolerance_m : float
            A place is correct if it lies within so many metres of the query.

        Raises
        ------
        GroundTruthError
            If a track cannot be read, or does not cover its drive.
        """
        return from_tracks(
            loaded_track(reference_track),
            loaded_track(query_track),
            self.reference.place_time_us,
            self.query_time_us,
            tolerance_m,
        )

    def facts(self, truth: GroundTruth | None = None) -> dict[str, str]:
        """Return lines of text that show whether drives, tracks and units are those that are meant.

        Parameters
        ----------
        truth : GroundTruth, optional
            Of this result; adds its tracks, and the distance of their routes.

        Examples
        --------
        >>> result.facts(evaluation.truth)["query track"]  # doctest: +SKIP
        '298 m from 0.0 to 57.0 s, 5.2 m/s in the mean and 9.8 m/s at most, ...'
        """
        reference, windows = self.reference, self.windows if self.queries is None else self.queries
        mapped, matched = (None, None) if truth is None or truth.tracks is None else truth.tracks
        drives = {"reference": Drive.of_map(reference, mapped)}
        if windows is not None:
            sensor = reference.pixel_map.sensor
            drives["query"] = Drive.of_windows(
                windows, sensor, self.start_us, self.clock_us, matched
            )
        lines = facts(drives, truth)
        if self.matches.settings.matching == "filter":
            unlike = int(np.count_nonzero(self.matches.misfit >= OFF_MAP_MISFIT))
            lines["views"] = f"{unlike:,} of {len(self):,} matches look unlike the map"
        if windows is not None and windows.counted is not None and windows.selected_events.any():
            beyond = 1 - windows.counted.sum() / windows.selected_events.sum()
            lines["pixels"] = (
                f"{beyond:.1%} of the events at the selected pixels are beyond the map's limits, "
                "as of a hot pixel or a lamp"
            )
        return lines

    def evaluate(
        self,
        truth: GroundTruth | Sequence[AnyTrack],
        tolerance_m: float | None = None,
        *,
        score: Score | None = None,
        recall_denominator: RecallDenominator = "rejected-correct",
    ) -> Evaluation:
        """Compare the matches with the ground truth.

        Parameters
        ----------
        truth : GroundTruth, or two tracks
            Each track is a Track, a path or a table (see `load_track`); that of the reference comes
            first.
        tolerance_m : float, optional
            Needed with two tracks: see `truth`.
        score, recall_denominator
            See `edge_vpr.evaluate`.

        Raises
        ------
        GroundTruthError
            If a track cannot be read, or the truth does not cover the drives.

        """
        if isinstance(truth, Alignment):
            raise UsageError(
                "truth is an Alignment, whose tolerance and times are not given: give "
                "from_alignment(alignment, result.reference.place_time_us, result.query_time_us, "
                "tolerance)"
            )
        judge = partial(evaluate, self.matches, score=score, recall_denominator=recall_denominator)
        if isinstance(truth, GroundTruth):
            within = None if truth.positions is None else truth.positions.tolerance
            if tolerance_m not in (None, within):
                raise UsageError(
                    f"tolerance_m = {tolerance_m:g}, and truth says already which matches are "
                    "correct: leave tolerance_m out, or make the truth anew with it"
                )
            return judge(truth)
        if isinstance(truth, str | Path) or not isinstance(truth, Sequence) or len(truth) != 2:
            raise UsageError(
                f"truth is {kind_of(truth)}: give the track of the reference and that of the "
                "query as a pair, or a GroundTruth, as of from_matrix or "
                "from_alignment(load_alignment(path), ...)"
            )
        if tolerance_m is None:
            raise UsageError(
                "the truth is two tracks, without the distance up to which a match is correct: "
                "give for example tolerance_m=70"
            )
        return judge(self.truth(truth[0], truth[1], tolerance_m))

    def to_frame(self, evaluation: Evaluation | None = None) -> pandas.DataFrame:
        """Return a pandas table with one row for each match; see `Matches.to_frame`.

        Parameters
        ----------
        evaluation : Evaluation, optional
            Of this result; adds the columns ``correct`` (nullable: unknown where the match cannot
            be judged) and ``error``, in the unit of ``evaluation.truth``.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.

        Examples
        --------
        >>> table = result.to_frame(result.evaluate((monday, tuesday), 70))  # doctest: +SKIP
        >>> table.groupby("correct")["probability"].mean()  # doctest: +SKIP
        """
        table = self.matches.to_frame().assign(**self._where)
        if evaluation is not None:
            self._check_evaluation(evaluation)
            correct = evaluation.correct.astype(object)
            correct[~evaluation.evaluated] = None
            table["correct"] = correct
            table["correct"] = table["correct"].astype("boolean")
            table["error"] = evaluation.error
        return table

    @property
    def _where(self) -> dict[str, npt.NDArray[np.float64]]:
        within = self.matches.settings.exclusion_places
        return self.reference.where(self.matches.place, within)

    @property
    def along_m(self) -> npt.NDArray[np.float64]:
        """Metres along the route to each matched place, shape (n,); NaN where not known.

        By the track of the map, else by its odometry.
        """
        along_m = self.reference.along_m
        return np.full(len(self), np.nan) if along_m is None else along_m[self.matches.place]

    @property
    def position(self) -> npt.NDArray[np.float64] | None:
        """Positions of the matched places, shape (n, d), in the form of ``reference.route``.

        None if the map was made without a track.
        """
        route = self.reference.route
        return None if route is None else route.position[self.matches.place]

    @property
    def position_m(self) -> npt.NDArray[np.float64] | None:
        """The same in metres: of latitude and longitude, east and north of the first place."""
        route, position = self.reference.route, self.position
        return None if route is None or position is None else route.metres(position)

    def plot(
        self, evaluation: Evaluation | None = None, *, axes: Axes | Sequence[Axes] | None = None
    ) -> npt.NDArray[Any]:
        """Draw the route, and over time the error (else the place) and the probability.

        Parameters
        ----------
        evaluation : Evaluation, optional
            Of this result; colours correct and wrong matches.
        axes : matplotlib.axes.Axes or sequence of them, optional
            Drawn on in this order, as many as there are; the legend is below them if the layout of
            their figure is "constrained". By default a new figure of pyplot.

        Returns
        -------
        ndarray of matplotlib.axes.Axes
            Those that were drawn on: without the route if the map does not know it, and without the
            probability if none is known.

        Examples
        --------
        >>> route, error, probability = result.plot(evaluation)  # doctest: +SKIP
        >>> error.figure.savefig("tuesday.pdf")  # doctest: +SKIP
        """
        self._check_evaluation(evaluation)
        drawn: npt.NDArray[Any] = _shown().plot(self, evaluation, axes)
        return drawn

    def report(
        self,
        folder: str | Path,
        evaluation: Evaluation | None = None,
        *,
        figures: Sequence[Literal["png", "pdf", "svg"]] = (),
        overwrite: bool = False,
    ) -> None:
        """Write the folder of `save` with its report, ``report.html``.

        Parameters
        ----------
        folder : path
            Written whole or not at all.
        evaluation : Evaluation, optional
            Of this result; the report and ``metrics.json`` then have its figures.
        figures : sequence of {"png", "pdf", "svg"}
            Write each figure as such files too.
        overwrite : bool
            Replace an older folder of results.
        """
        self._check_evaluation(evaluation)
        target = as_path(folder, "a folder of results")
        _shown().write(self, target, evaluation, figures, overwrite)

    def _repr_html_(self) -> str:
        text: str = _shown().html(self)
        return text

    def _check_evaluation(self, evaluation: Evaluation | None) -> None:
        """Refuse what is no evaluation of these matches."""
        if evaluation is None:
            return
        expect(evaluation, Evaluation, "evaluation", "what result.evaluate returned")
        if evaluation.matches != self.matches:
            raise UsageError(
                f"evaluation is of other matches, {evaluation.matches!r}: give that of this result"
            )

    def save(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write the folder of ``edge-vpr match``, without its report and figures.

        ``edge-vpr evaluate`` and ``replay`` read it; `load` gives the result back.

        Parameters
        ----------
        folder : path
            Written whole or not at all.
        overwrite : bool
            Replace an older folder of results.

        Raises
        ------
        UsageError
            If the folder exists and may not be replaced, is not one of results, or holds an input.
        """
        with results_folder(as_path(folder, "a folder of results"), overwrite, self.inputs) as new:
            self.write(new, self.inputs)

    def write(self, folder: Path, inputs: Sequence[str | Path]) -> RunRecord:
        """Write the files of `save` into an empty folder.

        Parameters
        ----------
        inputs : sequence of path
            Files that were read, for `run.json`.

        Returns
        -------
        RunRecord
            As in `run.json`.
        """
        # a map that was read is linked
        self.reference.save(folder / MAP, others=inputs)
        self.matches.save(folder / MATCHES)
        write_csv(folder / MATCHES_CSV, self.matches, self._where)
        for name, windows in ((QUERIES, self.queries), (WINDOWS, self.windows)):
            if windows is not None:
                write_archive(folder / name, QUERIES_KIND, windows.to_arrays(), {})
        left_out = self.removed.record(int(self.reference.hot.sum()))
        settings = self.matches.settings.to_dict()
        run = run_record(settings, inputs, left_out, self.start_us, self.clock_us)
        write_json(folder / RUN, run)
        write_json(folder / METRICS, {} if self.metrics is None else self.metrics)
        return run

    @classmethod
    def load(cls, folder: str | Path) -> MatchResult:
        """Read the matches, their map and their windows from a folder of results.

        Raises
        ------
        MapError
            If it is not a folder of results, or a file in it is damaged.
        """
        path = as_path(folder, "a folder of results")
        if not path.is_dir():
            raise MapError(f"{path} is not a folder of results: run edge-vpr match first")
        run = read_run(path) if (path / RUN).is_file() else None
        start_us, clock_us = (run.start_us or 0, run.clock_us or 0) if run else (0, 0)
        if not 0 <= start_us <= TIME_LIMIT_US:
            raise MapError(f"{path / RUN} has start_us {start_us!r}: match again")
        return cls(
            ReferenceMap.load(path / MAP),
            Matches.load(path / MATCHES),
            read_queries(path),
            start_us=start_us,
            clock_us=clock_us,
            windows=read_queries(path, WINDOWS),
        )


def _shown() -> Any:
    """Return the module that draws results, one of the tools: a robot loads none of them."""
    return import_module("edge_vpr_tools.report.of_result")


def read_queries(folder: Path, name: str = QUERIES) -> Descriptors | None:
    """Read the windows of a match; None of a match event by event."""
    if not (folder / name).is_file():
        return None
    arrays, _ = read_archive(folder / name, QUERIES_KIND)
    return Descriptors.from_arrays(arrays)
