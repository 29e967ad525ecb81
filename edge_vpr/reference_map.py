"""Maps of drives, and the matches of other drives with them: the public entry point."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar, Unpack, cast

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import archive_kind, read_archive, write_archive
from edge_vpr.confidence import OFF_MAP_MISFIT, OFF_MAP_TEXT
from edge_vpr.descriptors.cleaning import load_hot_pixels
from edge_vpr.descriptors.counting import (
    AnyRecording,
    DescriptorStream,
    EventSource,
    Removed,
    WindowSource,
    check_sensor,
    cleaned,
    count_places,
    end_of,
    opened,
    window_of,
)
from edge_vpr.descriptors.pixels import PixelMap, load_pixel_map
from edge_vpr.descriptors.windows import Descriptors, WindowCounts, collect
from edge_vpr.errors import EdgeVprWarning, MapError, UsageError, as_path, expect, kind_of
from edge_vpr.evaluation.facts import Drive, facts
from edge_vpr.evaluation.ground_truth import Alignment, GroundTruth, from_tracks
from edge_vpr.evaluation.metrics import Evaluation, RecallDenominator, evaluate
from edge_vpr.evaluation.tables import TableData, load_odometry
from edge_vpr.evaluation.track_files import AnyTrack, load_track
from edge_vpr.evaluation.tracks import UNIX_US, Track, with_positions
from edge_vpr.events import TIME_LIMIT_US, SensorSize
from edge_vpr.learning import MapUpdate, learn_drive
from edge_vpr.map_record import (
    KIND,
    MapRecord,
    check_matchable,
    describe_query,
    map_traverse,
    size_text,
)
from edge_vpr.matching.drive import match_query
from edge_vpr.matching.matches import Matches, write_csv
from edge_vpr.online.localiser import Localiser, OdometryFeed
from edge_vpr.online.runs import join_matches
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.recordings import Faults, Recording, open_recording
from edge_vpr.recordings.memory import FORMAT as MEMORY
from edge_vpr.recordings.memory import column_names
from edge_vpr.recordings.reading import Camera
from edge_vpr.results import (
    MAP,
    MATCHES,
    MATCHES_CSV,
    METRICS,
    QUERIES,
    QUERIES_KIND,
    RUN,
    WINDOWS,
    RemovedEvents,
    read_run,
    results_folder,
    run_record,
    write_json,
)
from edge_vpr.route import Odometry, length_m
from edge_vpr.settings import (
    SETTING_FIELDS,
    MatchingChanges,
    Preset,
    Score,
    SettingChanges,
    Settings,
    resolve_settings,
)

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

#: path of a file
PathName = str | Path


@dataclass(frozen=True, eq=False, repr=False)
class ReferenceMap(MapRecord):
    """Map of a reference drive, which queries are matched against.

    >>> from edge_vpr import ReferenceMap
    >>> from edge_vpr.simulation import simulate_pair
    >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
    >>> route = ReferenceMap.build(monday, pixels=50)
    >>> route
    ReferenceMap(12 places, 50 pixels of 32x32, 3 bits a counter)
    >>> route.match(tuesday).matches.place.tolist()
    [0, 1, 1, 3, 4, 6, 9, 10]

    `build` makes a map of a recording, `match` finds the places of another recording, and
    `localiser` follows events while they come. Two maps are equal if all their data are.

    Attributes
    ----------
    settings : Settings
        With which it was made; a query is described with the same.
    places : Descriptors
        One a place, K in all.
    saliency : ndarray of float32, shape (height, width)
        Variance (or mean) that the pixels were drawn from; for figures.
    hot : ndarray of bool, shape (height, width)
        Pixels that were left out.
    full_scale : ndarray of uint16, shape (J,), optional
        Of each counter's code, where the settings scale it to each pixel; with polarity (2 J,).
    mean : ndarray of int32, shape (J,), optional
        Mean logarithm of each counter over this drive in units of 1/256 octave, where the settings
        take codes against it; with polarity (2 J,).
    confidence : Confidence, optional
        Probability of matches with these settings, learnt from an evaluated drive.
    route : Route, optional
        Where the K places are.
    odometer_mm : ndarray of int64, shape (K,), optional
        Millimetres that the reference had driven at each place by its own odometry.
    frame_period : Fraction, optional
        Seconds a frame, of a map made of count frames; taken for queries that do not say. A map of
        the same events in memory has none, and so is another map.
    learnt_mean : ndarray of int32, shape (K, J), optional
        Of a map of several drives (`update`): the mean of their codes, in units of 1/256. The codes
        of the places are this mean, rounded.
    drives : ndarray of uint8, shape (K,), optional
        How many drives each place was learnt from; larger numbers than 4 count as 4.
    start_us : int
        Where the part that was mapped (`Recording.cropped`, ``--start``) begins in the recording.
    clock_us : int
        Start of the recording, where its clock counts from 1970; else 0.
    """

    @classmethod
    def build(
        cls,
        recording: AnyRecording,
        settings: Settings | Preset | Path | None = "default",
        *,
        sensor: SensorSize | None = None,
        pixel_map: PixelMap | PathName | None = None,
        hot: npt.NDArray[np.bool_] | PathName | None = None,
        track: AnyTrack | None = None,
        odometry: Odometry | TableData | PathName | None = None,
        removed: Removed | None = None,
        **changes: Unpack[SettingChanges],
    ) -> Self:
        """Make a map of one drive.

        Parameters
        ----------
        recording : EventSource or WindowSource or path or EventData
            For example from `open_recording`, which also opens a path, or events in memory: an
            array, four columns, a DataFrame, an item of a tonic data set.
        settings : Settings or {"default", "paper", "seed-code", "tiny"} or Path or None
            Settings, the name of a preset, or a TOML file with settings (text that ends with
            ``.toml`` too, but type checkers know presets only); None is "default".
        sensor : Sensor or (int, int) or str, optional
            Width and height, where the recording does not state them, as events in memory do not.
        pixel_map : PixelMap or path, optional
            Pixels to use, or a file with a line ``x, y`` for each, or a map that has them; by
            default they are selected as the settings say.
        hot : ndarray of bool, shape (height, width), or path, optional
            Hot pixels, or a file that lists them. By default they are found, if the settings ask
            for it and at least half of the pixels fire.
        track : Track or path or table, optional
            Of this drive; gives each place its position. See `load_track`.
        odometry : Odometry or path or table, optional
            Of this drive; gives each place its distance along the drive.
        removed : Removed, optional
            Filled with what cleaning removed.
        **changes
            Single settings that replace those of `settings`, for example ``pixels=50`` or
            ``tau="500ms"``, by the names of docs/settings.md or the attributes of `Settings`.

        Raises
        ------
        UsageError
            If the recording is too short for the settings, or too few pixels can be selected.
        RecordingError, EventError, GroundTruthError
            If a file cannot be read or is faulty.

        Warns
        -----
        EdgeVprWarning
            For each reason to doubt the unit of the recording's times, or the settings.

        Examples
        --------
        >>> ReferenceMap.build("monday.raw", track="monday.nmea", tau="500ms")  # doctest: +SKIP
        """
        _check_reading(changes, "build")
        chosen = _settings_of(settings, changes)
        drive = opened(recording, sensor=sensor)
        if isinstance(hot, str | Path):
            hot = load_hot_pixels(hot, drive.sensor)
        if isinstance(pixel_map, str | Path):
            is_map = archive_kind(pixel_map) == KIND
            pixel_map = (
                cls.load(pixel_map).pixel_map if is_map else load_pixel_map(pixel_map, drive.sensor)
            )
        track, odometry = _track_of(track), _odometry_of(odometry)
        removed = Removed() if removed is None else removed
        found = map_traverse(drive, chosen, pixel_map=pixel_map, hot=hot, removed=removed)
        made = replace(
            cls.of(found),
            frame_period=getattr(drive, "frame_period", None),
            start_us=getattr(drive, "cropped_us", 0),
            clock_us=_unix_start(drive),
        )
        check_matchable(made)
        if "pixels" in changes and pixel_map is None and made.settings.pixels < chosen.pixels:
            warnings.warn(
                f"pixels={chosen.pixels}, and the recording has events at {made.settings.pixels} "
                "pixels alone: the map has these",
                EdgeVprWarning,
                stacklevel=2,
            )
        if track is not None:
            clock_us = getattr(drive, "start_us", made.start_us) - made.start_us
            made = with_positions(made, track, clock_us)
        if odometry is not None:
            made = replace(made, odometer_mm=_of_part(drive, odometry).along(made.places.centre_us))
        return made

    def update(
        self,
        recording: AnyRecording,
        *,
        track: AnyTrack | None = None,
        odometry: Odometry | TableData | PathName | None = None,
        same_route: bool = False,
        removed: Removed | None = None,
    ) -> MapUpdate[Self]:
        """Update the map with another drive: average it into the codes of the places it shows.

        Its windows are aligned with the places by matching both ways, or by positions where both
        the map and the drive have them. Descriptors stay as large as they are. The newest drive
        weighs as much as each of the last four. Probabilities of its own that the map has learnt
        are dropped, because they do not hold for the new codes.

        Parameters
        ----------
        recording : EventSource or WindowSource or path or EventData
            Of the drive, from the camera of the map; see `build`.
        track : Track or path or table, optional
            Of this drive.
        odometry : Odometry or path or table, optional
            Of this drive; only a map with distances takes it.
        same_route : bool
            The drive is known to be of the route: it is never refused for its looks.
        removed : Removed, optional
            Filled with what cleaning removed.

        Returns
        -------
        MapUpdate
            Its `reference` is the new map; it also tells which windows could not be aligned and
            which places look different, and its `warnings` why the new map may be worse.

        Raises
        ------
        UsageError
            If the drive may not be of the route: fewer than half of its windows can be aligned, or
            fewer than one in ten has a match that is certain.

        Examples
        --------
        >>> from edge_vpr.simulation import simulate_pair
        >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
        >>> update = ReferenceMap.build(monday, pixels=50).update(tuesday, track=tuesday.track)
        """
        drive = opened(recording, default=self.camera)
        check_sensor(drive.sensor, self.pixel_map.sensor)
        track = _of_part(drive, _track_of(track))
        odometry = _of_part(drive, _odometry_of(odometry))
        counted = count_places(drive, self.pixel_map, self.settings, removed)
        return learn_drive(self, counted, track=track, odometry=odometry, same_route=same_route)

    def match(
        self,
        recording: AnyRecording,
        *,
        settings: Settings | None = None,
        every: str | MatchSchedule | None = None,
        odometry: Odometry | TableData | PathName | None = None,
        **changes: Unpack[MatchingChanges],
    ) -> MatchResult:
        """Match a query drive with this map.

        Parameters
        ----------
        recording : EventSource or WindowSource or path or EventData
            Of the query, from the camera of the map; see `build`.
        settings : Settings, optional
            Settings of matching to use instead of the map's.
        every : str or MatchSchedule, optional
            Match event by event as `localiser` does, and give a match as this says: see there. By
            default every window of the drive is matched, also by the windows after it.
        odometry : Odometry or path or table, optional
            Of the query drive; only the place filter takes it.
        **changes
            Single settings of matching that replace the map's, for example ``precision=0.99``.

        Raises
        ------
        UsageError
            If the recording is too short to be matched.

        Examples
        --------
        >>> route = ReferenceMap.load("monday.npz")  # doctest: +SKIP
        >>> route.match("tuesday.raw", precision=0.99).save("tuesday")  # doctest: +SKIP
        """
        _check_reading(changes, "match")
        if every is not None:
            _check_causal(changes, "match, of every=")
        asked = self._asked(settings, changes, "match")
        given = (recording, odometry)
        drive = opened(recording, default=self.camera)
        inputs = tuple(str(each) for each in given if isinstance(each, str | Path))
        if isinstance(drive, Recording) and drive is recording and drive.format != MEMORY:
            inputs = (str(drive.path), *inputs)
        odometry = _of_part(drive, _odometry_of(odometry))
        check_sensor(drive.sensor, self.pixel_map.sensor)
        matched = self._with(asked, "match")
        if every is None:
            result = _match_windows(matched, drive, odometry)
        elif isinstance(drive, WindowSource):
            raise UsageError(
                "matching event by event (every=) needs events, and this file holds "
                "counts of windows: leave it out"
            )
        else:
            result = _match_events(matched.causal(), drive, every, odometry)
        _warn_if_strange(result.matches)
        # the map as it was given: what is asked of one run is no part of it
        start_us = getattr(drive, "cropped_us", 0)
        windows = None if result.windows is None else self.coded(result.windows)
        return replace(
            result, reference=self, inputs=inputs, start_us=start_us,
            clock_us=_unix_start(drive), windows=windows,
        )  # fmt: skip

    def localiser(
        self,
        every: str | MatchSchedule | None = None,
        *,
        settings: Settings | None = None,
        **changes: Unpack[MatchingChanges],
    ) -> Localiser:
        """Return a localiser, which matches events with this map while they come.

        Parameters
        ----------
        every : str or MatchSchedule, optional
            When to give a match: ``"event"``, a number of events such as ``"100"``, a time such as
            ``"50ms"``, ``"window"``, or ``"change"`` of the place. By default after each event.
        settings : Settings, optional
            Settings of matching to use instead of the map's.
        **changes
            Single settings of matching that replace the map's.

        Warns
        -----
        EdgeVprWarning
            If the times of the first events are hardly in microseconds.

        Examples
        --------
        >>> localiser = route.localiser("50ms", precision=0.9)  # doctest: +SKIP
        >>> matches = localiser.update(events)  # doctest: +SKIP
        """
        _check_causal(changes, "localiser")
        asked = self._with(self._asked(settings, changes, "localiser"), "localiser")
        return Localiser(asked.causal(), every=every)

    def changed(self, changes: Mapping[str, Any], by: str) -> Self:
        """Return the map with other settings of matching, by name; `by` is named in errors."""
        _check_causal(changes, by)
        return self._with(self._asked(None, changes, by), by)

    def causal(self) -> Self:
        """Return the map with settings that need no windows after the one to match."""
        return self.matched_with(replace(self.settings, smooth=False))

    def info(self) -> MapInfo:
        """Return what the map holds; ``print(route.info())`` shows it as ``edge-vpr info`` does."""
        windows, route = self.windows, self.route
        return MapInfo(
            sensor=str(self.pixel_map.sensor),
            places=len(self),
            pixels=len(self.pixel_map),
            counter_bits=self.counter_bits,
            packed_bytes_per_place=self.packed_bytes_per_place,
            duration_us=int(windows.end_us[-1]),
            window_us=windows.window_us,
            window_parts=self.settings.window_parts,
            places_with_position=0 if route is None else int(np.isfinite(route.along_m).sum()),
            route_m=None if route is None else length_m(route.along_m, self.settings.window_parts),
            settings=self.settings.to_dict(),
        )

    @property
    def camera(self) -> Camera:
        """The camera of the drive; see `open_recording`."""
        return Camera(self.pixel_map.sensor, self.frame_period)

    def _asked(
        self, settings: Settings | None, changes: Mapping[str, Any], by: str
    ) -> dict[str, Any]:
        """Return the settings of matching to use, by name, where they are not the map's own.

        Parameters
        ----------
        by : str
            Name of the method, for error messages.
        """
        if settings is not None:
            expect(settings, Settings, "settings", "Settings, or keywords such as precision=0.99")
        chosen = (settings or self.settings).at_places_of(self.settings).replaced(changes, by)
        asked = {
            name: getattr(chosen, name)
            for name in SETTING_FIELDS
            if getattr(chosen, name) != getattr(self.settings, name)
        }
        for name, value in asked.items():
            if name in chosen.of_map:
                raise UsageError(
                    f"{by}: setting {name} = {value!r}, and the map was made with "
                    f"{getattr(self.settings, name)!r}: match with the map's, or build another map"
                )
        self.check_asked(chosen)
        # a precision that the table cannot reach is an error before any work
        _ = self._with(asked, by).acceptance
        return asked

    def _with(self, asked: dict[str, Any], by: str) -> Self:
        return self.matched_with(self.settings.replaced(asked, by))


@dataclass(frozen=True, kw_only=True)
class MapInfo:
    """Contents of a map, from `ReferenceMap.info`; the keys of ``edge-vpr info --json``."""

    sensor: str
    places: int
    pixels: int
    counter_bits: int
    packed_bytes_per_place: int
    duration_us: int
    window_us: int  #: Length of a window; the median, if windows are of a number of events.
    window_parts: int  #: Places that begin in a window.
    places_with_position: int
    #: Length of the route, to the end of its last window, if the map has positions.
    route_m: float | None
    settings: dict[str, Any]

    @property
    def lines(self) -> dict[str, str]:
        """Lines of text by their headings."""
        positions = "none"
        if self.route_m is not None:
            positions = f"{self.places_with_position:,} places, along {self.route_m:,.0f} m"
        return {
            "sensor": self.sensor,
            "places": f"{self.places:,}",
            "pixels": f"{self.pixels:,}, {self.counter_bits} bits each",
            "size": size_text(self.packed_bytes_per_place * self.window_parts, self.window_us),
            "duration": f"{self.duration_us / 1e6:.6f} s, windows of {self.window_us / 1e6:g} s",
            "positions": positions,
            "matching": str(self.settings["matching"]),
        }

    def __str__(self) -> str:
        return "\n".join(f"{name:<9} {text}" for name, text in self.lines.items())


@dataclass(frozen=True, kw_only=True)
class MatchMetrics:
    """Sizes and times of a run, the first part of `metrics.json`.

    The times of a first call hold those of compiling; after `edge_vpr.warm_up` they do not.

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
            _loaded(reference_track),
            _loaded(query_track),
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
        windows = self.windows if self.queries is None else self.queries
        tracks = (None, None) if truth is None or truth.tracks is None else truth.tracks
        drives = {
            "reference": (self.reference.windows, self.reference.start_us, self.reference.clock_us),
            "query": (windows, self.start_us, self.clock_us),
        }
        sensor = self.reference.pixel_map.sensor
        return facts(
            {
                name: Drive.of_windows(counted, sensor, start_us, clock_us, track)
                for (name, (counted, start_us, clock_us)), track in zip(
                    drives.items(), tracks, strict=True
                )
                if counted is not None
            },
            truth,
        )

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
        table = self.matches.to_frame(self.reference.route)
        if evaluation is not None:
            self._check_evaluation(evaluation)
            correct = evaluation.correct.astype(object)
            correct[~evaluation.evaluated] = None
            table["correct"] = correct
            table["correct"] = table["correct"].astype("boolean")
            table["error"] = evaluation.error
        return table

    @property
    def along_m(self) -> npt.NDArray[np.float64]:
        """Metres along the route to each matched place, shape (n,); NaN where not known.

        By the track of the map, else by its odometry.
        """
        route, driven = self.reference.route, self.reference.along_mm
        if route is not None:
            return route.along_m[self.matches.place]
        if driven is not None:
            return driven[self.matches.place] / 1e3
        return np.full(len(self), np.nan)

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
        folder: PathName,
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

    def save(self, folder: PathName, *, overwrite: bool = False) -> None:
        """Write the folder of ``edge-vpr match``, without its report and figures.

        ``edge-vpr evaluate`` and ``compare`` read it; `load` gives the result back.

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

    def write(self, folder: Path, inputs: Sequence[str | Path]) -> None:
        """Write the files of `save` into an empty folder.

        Parameters
        ----------
        inputs : sequence of path
            Files that were read, for `run.json`.
        """
        write_matched(folder, self.reference, self.matches, self.queries, inputs)
        if self.windows is not None:
            write_queries(folder / WINDOWS, self.windows)
        left_out = removed_record(self.removed, int(self.reference.hot.sum()))
        settings = self.matches.settings.to_dict()
        run = run_record(settings, inputs, left_out, self.start_us, self.clock_us)
        write_json(folder / RUN, run)
        write_json(folder / METRICS, {} if self.metrics is None else self.metrics)

    @classmethod
    def load(cls, folder: PathName) -> MatchResult:
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


def write_matched(
    folder: Path,
    reference: MapRecord,
    matches: Matches,
    queries: Descriptors | None = None,
    inputs: Sequence[str | Path] = (),
) -> None:
    """Write map, matches and queries into a folder of results; link a map that was read."""
    reference.save(folder / MAP, others=inputs)
    matches.save(folder / MATCHES)
    write_csv(folder / MATCHES_CSV, matches, reference.route)
    if queries is not None:
        write_queries(folder / QUERIES, queries)


def write_queries(path: Path, queries: Descriptors) -> None:
    """Write the windows of a drive."""
    write_archive(path, QUERIES_KIND, queries.to_arrays(), {})


def read_queries(folder: Path, name: str = QUERIES) -> Descriptors | None:
    """Read the windows of a match; None of a match event by event."""
    if not (folder / name).is_file():
        return None
    arrays, _ = read_archive(folder / name, QUERIES_KIND)
    return Descriptors.from_arrays(arrays)


def removed_record(removed: Removed, hot_pixels: int) -> RemovedEvents:
    """Return what cleaning removed, for `run.json`."""
    return RemovedEvents(removed.events, removed.burst_events, removed.burst_share, hot_pixels)


def _track_of(given: AnyTrack | None) -> Track | None:
    """Return a track, read from its file if that is given."""
    return None if given is None else _loaded(given)


def _loaded(track: AnyTrack) -> Track:
    if isinstance(track, Track):
        return track
    if column_names(track) is None:
        give = "the path of a log, a table with time_s and x_m, y_m, or Track(time_us, position)"
        expect(track, (str, Path), "track", give)
    return load_track(track)


def _odometry_of(given: Odometry | TableData | PathName | None) -> Odometry | None:
    """Return odometry, read from its file if that is given."""
    return given if given is None or isinstance(given, Odometry) else load_odometry(given)


_Timed = TypeVar("_Timed", bound=Track | Odometry | None)


def _of_part(drive: object, readings: _Timed) -> _Timed:
    """Return readings whose times count from where the part of a recording begins."""
    start_us = getattr(drive, "cropped_us", 0)
    if readings is None or not start_us:
        return readings
    moved: Any = (
        readings.shifted(-start_us / 1e6)
        if isinstance(readings, Track)
        else replace(readings, time_us=readings.time_us - start_us)
    )
    return moved


def _unix_start(drive: object) -> int:
    """Return where a whole recording begins on its clock, if that counts from 1970; else 0."""
    start_us = int(getattr(drive, "start_us", 0)) - int(getattr(drive, "cropped_us", 0))
    return start_us if start_us >= UNIX_US else 0


def _check_reading(changes: Mapping[str, Any], by: str) -> None:
    """Refuse, among settings, what says how a file is read."""
    for name in changes.keys() & signature(open_recording).parameters:
        raise UsageError(
            f"{by}: {name} is no setting, and says how a recording is read: give "
            f"open_recording(recording, {name}={changes[name]!r}) in its place"
        )


def _check_causal(changes: Mapping[str, Any], by: str) -> None:
    """Refuse to smooth what is matched while events come."""
    if changes.get("smooth"):
        raise UsageError(
            f"{by}: smooth=True needs all later windows: leave it out, or match the recording"
        )


def _settings_of(settings: Settings | str | Path | None, changes: Mapping[str, Any]) -> Settings:
    if isinstance(settings, Settings):
        return settings.replaced(changes, "build")
    if settings is None:
        settings = "default"
    expect(
        settings,
        (str, Path),
        "settings",
        "Settings, the name of a preset, or a TOML file; single settings as keywords: pixels=50",
    )
    is_file = isinstance(settings, Path) or settings.endswith(".toml")
    if is_file:
        return resolve_settings(config=settings, flags=changes, source="build")
    return resolve_settings(cast("Preset", str(settings)), flags=changes, source="build")


def _match_windows(
    asked: ReferenceMap,
    drive: EventSource | WindowSource,
    odometry: Odometry | None,
) -> MatchResult:
    """Count the windows of a drive and match all of them."""
    removed = Removed()
    start = time.perf_counter()
    queries = describe_query(asked, drive, removed=removed)
    counting_s = time.perf_counter() - start
    start = time.perf_counter()
    matches = match_query(asked, queries, odometry)
    matching_s = time.perf_counter() - start
    metrics = MatchMetrics(
        queries=len(matches),
        places=len(asked),
        pixels=len(asked.pixel_map),
        bytes_per_place=asked.bytes_per_place,
        packed_bytes_per_place=asked.packed_bytes_per_place,
        events=int(queries.events.sum()),
        counting_s=counting_s,
        matching_s=matching_s,
        tied_queries=int((matches.ties > 0).sum()),
        faults_dropped=getattr(drive, "faults", Faults()),
    )
    return MatchResult(asked, matches, queries, metrics, removed)


def _match_events(
    asked: ReferenceMap,
    drive: EventSource,
    every: str | MatchSchedule,
    odometry: Odometry | None,
) -> MatchResult:
    """Feed the events of a drive to a localiser, and count its windows in the same pass."""
    localiser = Localiser(asked, every=every)
    stream: DescriptorStream | None = DescriptorStream(
        asked.pixel_map, window_of(asked.settings), polarity=asked.settings.polarity
    )
    windows: list[WindowCounts] = []
    found: list[npt.NDArray[np.void]] = []
    events_fed, busy_s = 0, 0.0
    removed, fed = Removed(), OdometryFeed(localiser, odometry)
    for events in cleaned(drive, asked.settings, removed):
        start = time.perf_counter()
        found += fed.update(events)
        busy_s += time.perf_counter() - start
        events_fed += events.size
        if stream is not None:
            try:
                windows += stream.windows(events)
            except UsageError:  # more than are kept, which matching does not need
                stream, windows = None, []
    end_us = end_of(drive)
    start = time.perf_counter()
    found += fed.finish(end_us)
    busy_s += time.perf_counter() - start
    if stream is not None and end_us is not None:
        windows += stream.advance(end_us)
    rows = join_matches(found)
    if rows.size == 0:
        raise UsageError(
            f"the recording ended before a sequence of {asked.settings.windows_per_match} windows "
            "was complete: take shorter windows or a longer drive"
        )
    metrics = OnlineMetrics(
        matches=len(rows),
        events=events_fed,
        every=every if isinstance(every, str) else repr(every),
        localising_s=busy_s,
        times_real_time=float(rows["time_us"][-1] / 1e6) / busy_s,
        faults_dropped=getattr(drive, "faults", Faults()),
    )
    matches = Matches.of_rows(rows, asked.settings, len(asked))
    counted = collect(windows, len(asked.pixel_map) * (2 if asked.settings.polarity else 1))
    counted = replace(counted, selected=counted.selected_events)
    return MatchResult(
        asked, matches, None, metrics, removed, windows=counted if len(counted) else None
    )


#: share of strange matches about which nothing is said
_MUCH_OFF_MAP = 0.25


def _warn_if_strange(matches: Matches) -> None:
    """Warn if the views of more than a quarter of the matches are unlike those of the map."""
    share = float((matches.misfit >= OFF_MAP_MISFIT).mean())
    if share > _MUCH_OFF_MAP:
        warnings.warn(
            f"{OFF_MAP_TEXT}, by {share:.0%} of the matches: check that the drive and the map are "
            "of one route, or map the route in this light too",
            EdgeVprWarning,
            stacklevel=3,
        )
