"""A map of a reference drive: its data, their checks and codes, and its file.

`ReferenceMap.build` and `update` are of `map_making`, `match` of `match_result`, and `localiser` of
`online`: modules that take maps, and are imported when one of these is called.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import (
    EqualByValue,
    archive_errors,
    check_array,
    check_range,
    present,
    read_archive,
    write_archive,
)
from edge_vpr.confidence import Acceptance, Confidence
from edge_vpr.descriptors.activity import activity_of_drive
from edge_vpr.descriptors.codes import counted_events, encode, saturated
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, check_descriptors, narrow
from edge_vpr.errors import MapError, UsageError, expect
from edge_vpr.events import Sensor, SensorSize
from edge_vpr.odometry import MOST_MM, check_distance_driven
from edge_vpr.recordings.reading import Camera
from edge_vpr.route import Route, along_columns, length_m
from edge_vpr.settings import MatchingChanges, Preset, SettingChanges, Settings
from fixedpoint.formats import packed_bytes
from fixedpoint.own_mean import FULL_SCALE

if TYPE_CHECKING:
    from edge_vpr.descriptors.counting import Removed
    from edge_vpr.drive_inputs import AnyRecording
    from edge_vpr.evaluation.tables import AnyOdometry
    from edge_vpr.evaluation.track_files import AnyTrack
    from edge_vpr.learning import MapUpdate
    from edge_vpr.match_result import MatchResult
    from edge_vpr.online.localiser import Localiser
    from edge_vpr.online.schedule import MatchSchedule

KIND = "reference map"
#: arrays that only some maps have
_OPTIONAL = ("mean", "limits", "odometer_mm", "learnt_mean", "drives")


@dataclass(frozen=True, eq=False)
class ReferenceMap(EqualByValue):
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
    mean : ndarray of int32, shape (J,), optional
        Mean logarithm of each counter over this drive in units of 1/256 octave, of contrast codes.
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

    settings: Settings
    pixel_map: PixelMap
    places: Descriptors
    saliency: npt.NDArray[np.float32]
    hot: npt.NDArray[np.bool_]
    mean: npt.NDArray[np.int32] | None = None
    limits: npt.NDArray[np.int32] | None = None
    confidence: Confidence | None = None
    route: Route | None = None
    odometer_mm: npt.NDArray[np.int64] | None = None
    frame_period: Fraction | None = None
    learnt_mean: npt.NDArray[np.int32] | None = None
    drives: npt.NDArray[np.uint8] | None = None
    start_us: int = 0
    clock_us: int = 0

    def __post_init__(self) -> None:
        self.check()

    def __len__(self) -> int:
        return len(self.places)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({len(self)} places, {len(self.pixel_map)} pixels of "
            f"{self.pixel_map.sensor}, {self.counter_bits} bits a counter)"
        )

    def check(self) -> None:
        """Check that all parts fit each other, as they did when the map was made."""
        settings, pixel_map, places = self.settings, self.pixel_map, self.places
        expect(settings, Settings, "settings", "Settings, or build the map with ReferenceMap.build")
        expect(pixel_map, PixelMap, "pixel_map", "a PixelMap, as of select_pixels")
        expect(places, Descriptors, "places", "Descriptors, as of describe")
        if settings.pixels != len(pixel_map):
            raise MapError(
                f"the settings say {settings.pixels} pixels and the pixel map has "
                f"{len(pixel_map)}: expected the same number"
            )
        counters = len(pixel_map)
        check_descriptors(places, counters)
        shape = (pixel_map.sensor.height, pixel_map.sensor.width)
        check_array(self.saliency, "saliency", (np.float32, np.float64), shape)
        if not np.isfinite(self.saliency).all():
            raise MapError("saliency holds values that are not finite: expected variances or means")
        check_array(self.hot, "hot", (np.bool_,), shape)
        if self.route is not None and len(self.route.along_m) != len(places):
            raise MapError(f"position has {len(self.route.along_m)} rows for {len(places)} places")
        if self.odometer_mm is not None:
            check_distance_driven(self.odometer_mm, len(places))
        if self.learnt_mean is not None and self.drives is not None:
            check_array(self.learnt_mean, "learnt_mean", (np.int32,), places.counts.shape)
            check_array(self.drives, "drives", (np.uint8,), (len(places),))
        code, most = settings.contrast_code, settings.most_counted
        if code is None:
            if most is not None:
                check_range(places.counts, "counts", 0, most)
            return
        if self.mean is None:
            raise MapError("the map has contrast codes and lacks mean: make the map again")
        check_array(self.mean, "mean", (np.int32,), (counters,))
        check_range(self.mean, "mean", 0, int(code.levels[-1]))
        if self.limits is None:
            raise MapError("the map has contrast codes and lacks limits: make the map again")
        check_array(self.limits, "limits", (np.int32,), (counters,))
        check_range(self.limits, "limits", 0, FULL_SCALE)
        check_range(places.counts, "counts", 0, (1 << code.bits) - 1)

    @classmethod
    def build(
        cls,
        recording: AnyRecording,
        settings: Settings | Preset | Path | None = "default",
        *,
        sensor: SensorSize | None = None,
        pixel_map: PixelMap | str | Path | None = None,
        hot: npt.NDArray[np.bool_] | str | Path | None = None,
        track: AnyTrack | None = None,
        odometry: AnyOdometry | None = None,
        removed: Removed | None = None,
        **changes: Unpack[SettingChanges],
    ) -> ReferenceMap:
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
            If the recording has events at fewer pixels than `pixels` asks for.

        Examples
        --------
        >>> ReferenceMap.build("monday.raw", track="monday.nmea", tau="500ms")  # doctest: +SKIP
        """
        from edge_vpr.map_making import build

        return build(
            recording, settings, changes, sensor=sensor, pixel_map=pixel_map, hot=hot, track=track,
            odometry=odometry, removed=removed,
        )  # fmt: skip

    def update(
        self,
        recording: AnyRecording,
        *,
        track: AnyTrack | None = None,
        odometry: AnyOdometry | None = None,
        same_route: bool = False,
        removed: Removed | None = None,
    ) -> MapUpdate:
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
            The drive is known to be of the route: it may leave it for most of its windows.
        removed : Removed, optional
            Filled with what cleaning removed.

        Returns
        -------
        MapUpdate
            Its `reference` is the new map; it also tells which windows could be aligned, and which
            places were learnt.

        Raises
        ------
        UsageError
            If the drive may not be of the route: fewer than half of its windows can be aligned, or
            fewer than one in ten has a match that is certain. If it shows less than nine tenths of
            the places at which the map's drive moved, the rest of which would suffer in its light.

        Examples
        --------
        >>> from edge_vpr.simulation import simulate_pair
        >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
        >>> update = ReferenceMap.build(monday, pixels=50).update(tuesday, track=tuesday.track)
        """
        from edge_vpr.map_making import update

        return update(
            self, recording, track=track, odometry=odometry, same_route=same_route, removed=removed
        )

    def match(
        self,
        recording: AnyRecording,
        *,
        settings: Settings | None = None,
        every: str | MatchSchedule | None = None,
        odometry: AnyOdometry | None = None,
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
        from edge_vpr.match_result import match

        return match(self, recording, changes, settings=settings, every=every, odometry=odometry)

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

        Examples
        --------
        >>> localiser = route.localiser("50ms", precision=0.9)  # doctest: +SKIP
        >>> matches = localiser.update(events)  # doctest: +SKIP
        """
        from edge_vpr.online.localiser import Localiser

        return Localiser(self.causal_with(settings, changes, "localiser"), every=every)

    def with_settings(
        self, settings: Settings | None, changes: Mapping[str, Any], by: str
    ) -> ReferenceMap:
        """Return the map with other settings of matching.

        Parameters
        ----------
        settings : Settings, optional
            Settings that the changes are made to instead of the map's.
        changes : dict
            Single settings, by name.
        by : str
            Who asks, for error messages.
        """
        if settings is not None:
            expect(settings, Settings, "settings", "Settings, or keywords such as precision=0.99")
        chosen = (settings or self.settings).at_places_of(self.settings).replaced(changes, by)
        for name, own in self.settings.of_map.items():
            wanted = getattr(chosen, name)
            if wanted != own:
                raise UsageError(
                    f"{by}: setting {name} = {wanted!r}, and the map was made with {own!r}: match "
                    "with the map's, or build another map"
                )
        matched = self.matched_with(chosen)
        asks_for_another = chosen.stays_on_map and not self.settings.stays_on_map
        if asks_for_another and matched.confidence is not None:
            raise UsageError(
                "stays_on_map=True chooses a shipped table of probabilities, and the "
                "map has a table of its own (edge-vpr calibrate), which is used: leave it out"
            )
        # a precision that the table cannot reach is an error before any work
        Acceptance.of(chosen, matched.confidence)
        return matched

    def causal_with(
        self, settings: Settings | None, changes: Mapping[str, Any], by: str
    ) -> ReferenceMap:
        """Return the map with settings for matching while events come, see `with_settings`."""
        if changes.get("smooth"):
            raise UsageError(
                "smooth=True needs all later windows: leave it out, or match the whole recording"
            )
        return self.with_settings(settings, {**changes, "smooth": False}, by)

    def causal(self) -> ReferenceMap:
        """Return the map with settings that need no windows after the one to match."""
        return self.matched_with(replace(self.settings, smooth=False))

    def info(self) -> MapInfo:
        """Return what the map holds; ``print(route.info())`` shows it as ``edge-vpr info`` does."""
        windows, route, along_m = self.windows, self.route, self.along_m
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
            route_m=None if along_m is None else length_m(along_m, self.settings.window_parts),
            settings=self.settings.to_dict(),
        )

    @property
    def camera(self) -> Camera:
        """The camera of the drive; see `open_recording`."""
        return Camera(self.pixel_map.sensor, self.frame_period)

    @property
    def place_time_us(self) -> npt.NDArray[np.int64]:
        """Centres of the windows of the places, from the recording's start, shape (K,)."""
        return self.places.centre_us + self.start_us

    @property
    def windows(self) -> Descriptors:
        """The places whose windows do not overlap: every one, or every second of half windows."""
        number = self.settings.window_parts
        return self.places if number == 1 else self.places.take(slice(None, None, number))

    @property
    def mean_activity(self) -> int:
        """Mean of the counted events of the reference's windows, see `activity_of_drive`."""
        return activity_of_drive(self.windows.counted_events)

    @property
    def along_mm(self) -> npt.NDArray[np.int64] | None:
        """Millimetres driven at each place, shape (K,), from odometry or else from the track.

        At places that the track did not cover, the distance is interpolated. None if the map has
        neither.
        """
        if self.odometer_mm is not None or self.route is None:
            return self.odometer_mm
        along_m = self.route.along_m
        placed = np.flatnonzero(np.isfinite(along_m))
        along_m = np.interp(np.arange(len(along_m)), placed, along_m[placed])
        return None if along_m[-1] * 1e3 > MOST_MM else np.rint(along_m * 1e3).astype(np.int64)

    @property
    def along_m(self) -> npt.NDArray[np.float64] | None:
        """Metres along the route to each place, shape (K,), by the track or else by odometry.

        NaN at places that the track did not cover. None if the map has neither.
        """
        if self.route is not None:
            return self.route.along_m
        return None if self.odometer_mm is None else self.odometer_mm / 1e3

    def where(
        self, place: npt.NDArray[np.integer], within: int
    ) -> dict[str, npt.NDArray[np.float64]]:
        """Return where matched places are, as columns of a table of matches by name, in order.

        By the track of the map, else by its odometry; without either, there is no column.

        Parameters
        ----------
        place : ndarray of int, shape (n,)
            Index of the matched place, for each match.
        within : int
            See `Route.locate`: the exclusion zone's places.

        Returns
        -------
        dict of str to ndarray of float64, shape (n,)
            The coordinates of a track, metres along the route, and the interval around it; NaN
            where not known.
        """
        if self.route is not None:
            return self.route.columns(place, within)
        return {} if self.along_m is None else along_columns(self.along_m, place, within)

    @property
    def acceptance(self) -> Acceptance:
        """The map's own table of probabilities; with the place filter, else the shipped one."""
        return Acceptance.of(self.settings, self.confidence)

    def matched_with(self, settings: Settings) -> ReferenceMap:
        """Return the map with other settings for matching.

        Its own table of probabilities is removed if the scale of the trust changes.
        """
        expect(settings, Settings, "settings", "Settings, as of map.settings.replaced")
        settings = settings.at_places_of(self.settings)
        if settings == self.settings:
            return self
        kept = settings.of_trust == self.settings.of_trust
        return replace(self, settings=settings, confidence=self.confidence if kept else None)

    def coded(self, counted: Descriptors) -> Descriptors:
        """Replace the counts of a query by the codes of this map."""
        settings, code = self.settings, self.settings.contrast_code
        if code is None:
            return saturated(counted, settings.most_counted)
        # as on a robot; smoothed drives and sequences subtract the mean of the whole query drive
        start = self.mean if settings.matching == "filter" and not settings.smooth else None
        counted = replace(counted, counted=self.counted_events(counted))
        return encode(counted, code, self.mean_activity, settings.hypotheses, start)

    def counted_events(self, counted: Descriptors) -> npt.NDArray[np.int64]:
        """Return the events of each window of counts that count, shape (n,)."""
        if self.limits is None:
            return counted.counted_events
        return counted_events(counted.counts, self.limits)

    def decoded(self, descriptors: Descriptors) -> Descriptors:
        """Replace contrast codes by typical counts, for plots."""
        code = self.settings.contrast_code
        if code is None or self.mean is None:
            return descriptors
        return replace(descriptors, counts=narrow(code.decode(descriptors.counts, self.mean)))

    @property
    def bytes_per_place(self) -> int:
        """Size of a descriptor as stored and compared here, in bytes."""
        return self.places.counts.shape[1] * self.places.counts.itemsize

    @property
    def counter_bits(self) -> int:
        """Number of bits of the code of a counter, or of its stored count."""
        code, most = self.settings.contrast_code, self.settings.most_counted
        if code is not None:
            return code.bits
        return 8 * self.places.counts.itemsize if most is None else most.bit_length()

    @property
    def packed_bytes_per_place(self) -> int:
        """Size of a place in bytes: codes packed without gaps, and the filter's activity."""
        codes = packed_bytes(self.places.counts.shape[1], self.counter_bits)
        return codes + (self.settings.matching == "filter")

    @property
    def packed_bytes_per_window(self) -> int:
        """Packed size of all places that begin in a window, in bytes."""
        return self.packed_bytes_per_place * self.settings.window_parts

    @property
    def size_text(self) -> str:
        """Packed size, as text."""
        return _size_text(self.packed_bytes_per_window, self.windows.window_us)

    def save(
        self, path: str | Path, *, overwrite: bool = False, others: Iterable[str | Path] = ()
    ) -> None:
        """Write as ``.npz``, atomically; `load` gives an equal map back.

        Parameters
        ----------
        path : path
            The file to write.
        overwrite : bool
            Replace a file that exists.
        others : iterable of path
            Files that were read: one that holds this map is linked instead.
        """
        arrays = {
            "pixel_x": self.pixel_map.x,
            "pixel_y": self.pixel_map.y,
            **self.places.to_arrays(),
            "saliency": self.saliency,
            "hot": self.hot,
        }
        arrays |= present(**{name: getattr(self, name) for name in _OPTIONAL})
        meta: dict[str, Any] = {
            "settings": self.settings.to_dict(),
            "sensor": list(self.pixel_map.sensor),
        }
        if self.confidence is not None:
            arrays |= self.confidence.to_arrays()
        if self.route is not None:
            arrays |= self.route.to_arrays()
            meta["position_kind"] = self.route.kind
        if self.frame_period is not None:
            meta["frame_period"] = str(self.frame_period)
        if self.start_us:
            meta["start_us"] = self.start_us
        if self.clock_us:
            meta["clock_us"] = self.clock_us
        write_archive(path, KIND, arrays, meta, overwrite=overwrite, others=others)

    @classmethod
    def load(cls, path: str | Path) -> ReferenceMap:
        """Read a saved map.

        Raises
        ------
        MapError
            If the file is missing, unreadable, damaged, not a map, or of another version.
        """
        arrays, meta = read_archive(path, KIND)
        with archive_errors(path, "make the map again"):
            return cls(
                settings=Settings.from_dict(meta["settings"]),
                pixel_map=PixelMap(Sensor(*meta["sensor"]), arrays["pixel_x"], arrays["pixel_y"]),
                places=Descriptors.from_arrays(arrays),
                saliency=arrays["saliency"],
                hot=arrays["hot"],
                confidence=Confidence.from_arrays(arrays),
                route=Route.from_arrays(arrays, meta),
                frame_period=Fraction(meta["frame_period"]) if "frame_period" in meta else None,
                start_us=meta.get("start_us", 0),
                clock_us=meta.get("clock_us", 0),
                **{name: arrays.get(name) for name in _OPTIONAL},
            )


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
    #: Length of the route, to the end of its last window, if the map has positions or odometry.
    route_m: float | None
    settings: dict[str, Any]

    @property
    def lines(self) -> dict[str, str]:
        """Lines of text by their headings."""
        positions = "none"
        if self.route_m is not None and self.places_with_position:
            positions = f"{self.places_with_position:,} places, along {self.route_m:,.0f} m"
        elif self.route_m is not None:
            positions = f"none; {self.route_m:,.0f} m by odometry"
        return {
            "sensor": self.sensor,
            "places": f"{self.places:,}",
            "pixels": f"{self.pixels:,}, {self.counter_bits} bits each",
            "size": _size_text(self.packed_bytes_per_place * self.window_parts, self.window_us),
            "duration": f"{self.duration_us / 1e6:.6f} s, windows of {self.window_us / 1e6:g} s",
            "positions": positions,
            "matching": str(self.settings["matching"]),
        }

    def __str__(self) -> str:
        return "\n".join(f"{name:<9} {text}" for name, text in self.lines.items())


def _size_text(bytes_per_window: int, window_us: int) -> str:
    return f"{bytes_per_window * 1e6 / window_us:,.0f} bytes per second of the route, packed"
