"""The data of a reference map: selected pixels, descriptors of the places, their codes, settings.

How a drive becomes such a record, and another drive its query. All stages of matching take this
record; `ReferenceMap` adds matching to it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Self, TypeVar

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
from edge_vpr.confidence import TRUST_RULE, Acceptance, Confidence
from edge_vpr.descriptors.cleaning import can_be_searched, find_hot_pixels
from edge_vpr.descriptors.codes import (
    codes_of,
    counted_events,
    drive_mean,
    encode_own,
    encode_running,
    limits_of,
)
from edge_vpr.descriptors.counting import (
    DescriptorStream,
    EventSource,
    Removed,
    WindowSource,
    check_counted,
    check_parts,
    check_sensor,
    check_windows_only,
    count_places,
    count_windows,
    event_windows,
    opened,
    too_short,
)
from edge_vpr.descriptors.pixels import (
    PixelMap,
    PixelStatistics,
    informative_pixels,
    plugin_pixels,
    select_pixels,
    shortlist,
    too_few_pixels,
)
from edge_vpr.descriptors.windows import (
    Descriptors,
    FixedTime,
    activity_of_drive,
    check_descriptors,
    narrow,
    overlapping,
)
from edge_vpr.errors import EdgeVprWarning, MapError, UsageError, expect
from edge_vpr.events import Sensor
from edge_vpr.route import MOST_MM, Route
from edge_vpr.settings import PLUGIN, Settings
from fixedpoint.codes import PixelCodes, learn_full_scale, packed_bytes
from fixedpoint.errors import FixedPointError
from fixedpoint.own_mean import FULL_SCALE, OwnMeanCode

# Checks of parts of a reference map that kernels use as indices.


#: frames in a window of a reference of frames that has places at half windows, at least: its halves
#: then differ little in length
LEAST_FRAMES = 20


def check_distance_driven(odometer_mm: npt.NDArray[Any], places: int) -> None:
    """Check that there is a distance of each place, and that it never falls."""
    check_array(odometer_mm, "the distance driven", (np.int64,), (places,))
    check_range(odometer_mm, "the distance driven", 0, MOST_MM)
    if (np.diff(odometer_mm) < 0).any():
        raise MapError("the distance driven falls from place to place: expected that it rises")


def check_codes(
    settings: Settings, counts: npt.NDArray[Any], full_scale: npt.NDArray[Any] | None
) -> None:
    """Check that all codes of the places occur in the tables of their counters."""
    try:
        codes = codes_of(settings, counts.shape[1], full_scale)
    except FixedPointError as error:
        raise MapError(f"the codes of the map: {error}") from error
    if codes is None:
        return
    top = np.array([code.top for code in codes.codes], dtype=np.int64)[codes.row]
    above = np.flatnonzero(counts.max(axis=0) > top)
    if above.size:
        j = int(above[0])
        raise MapError(
            f"counter {j} holds the code {counts[:, j].max()}: expected codes up to {top[j]}"
        )


# The data of a map: checks, codes of queries, save, load.


KIND = "reference map"
#: arrays that only some maps have
_OPTIONAL = ("full_scale", "mean", "limits", "odometer_mm", "learnt_mean", "drives")
#: a map of any class: a function that changes a map returns one of the same class
AnyMap = TypeVar("AnyMap", bound="MapRecord")


def size_text(bytes_per_window: int, window_us: int) -> str:
    """Return the size of a route as text, in the one unit that all messages have."""
    return f"{bytes_per_window * 1e6 / window_us:,.0f} bytes per second of the route, packed"


@dataclass(frozen=True, eq=False)
class MapRecord(EqualByValue):
    """Data of a reference drive, which queries are matched against.

    Its attributes are those of `edge_vpr.ReferenceMap`, and are described there.
    """

    settings: Settings
    pixel_map: PixelMap
    places: Descriptors
    saliency: npt.NDArray[np.float32]
    hot: npt.NDArray[np.bool_]
    full_scale: npt.NDArray[np.uint16] | None = None
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

    @classmethod
    def of(cls, record: MapRecord) -> Self:
        """Return the same map as an instance of this class."""
        if type(record) is cls:
            return record
        return cls(**{field.name: getattr(record, field.name) for field in fields(record)})

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
        counters = len(pixel_map) * (2 if settings.polarity else 1)
        check_descriptors(places, counters)
        shape = (pixel_map.sensor.height, pixel_map.sensor.width)
        check_array(self.saliency, "saliency", (np.float32, np.float64), shape)
        if not np.isfinite(self.saliency).all():
            raise MapError("saliency holds values that are not finite: expected variances or means")
        check_array(self.hot, "hot", (np.bool_,), shape)
        if self.full_scale is not None:
            check_array(self.full_scale, "full_scale", (np.uint16,), (counters,))
        if self.route is not None and len(self.route.along_m) != len(places):
            raise MapError(f"position has {len(self.route.along_m)} rows for {len(places)} places")
        if self.odometer_mm is not None:
            check_distance_driven(self.odometer_mm, len(places))
        self._check_learnt()
        own_mean = self.own_mean_code
        if own_mean is None:
            check_codes(settings, places.counts, self.full_scale)
            return
        if self.mean is None:
            raise MapError("the map has own-mean codes and lacks mean: make the map again")
        check_array(self.mean, "mean", (np.int32,), (counters,))
        check_range(self.mean, "mean", 0, int(own_mean.levels[-1]))
        if self.limits is None:
            raise MapError("the map has own-mean codes and lacks limits: make the map again")
        check_array(self.limits, "limits", (np.int32,), (counters,))
        check_range(self.limits, "limits", 0, FULL_SCALE)
        check_range(places.counts, "counts", 0, (1 << own_mean.bits) - 1)

    def _check_learnt(self) -> None:
        """Check the shapes of what was learnt from several drives, if it is there."""
        if self.learnt_mean is None or self.drives is None:
            return
        check_array(self.learnt_mean, "learnt_mean", (np.int32,), self.places.counts.shape)
        check_array(self.drives, "drives", (np.uint8,), (len(self.places),))

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
    def codes(self) -> PixelCodes | None:
        """Counter codes of the places; None if the places hold event counts.

        Also None with own-mean codes, which have no fixed table (see `own_mean_code`).
        """
        if self.own_mean_code is not None:
            return None
        return codes_of(self.settings, self.places.counts.shape[1], self.full_scale)

    @property
    def own_mean_code(self) -> OwnMeanCode | None:
        """The own-mean code; None if the places hold counts or other codes."""
        return self.settings.own_mean_code

    @property
    def along_mm(self) -> npt.NDArray[np.int64] | None:
        """Millimetres driven at each place, shape (K,), from odometry or else from the track.

        At places that the track did not cover, the distance is interpolated. None if the map has
        neither.
        """
        if self.odometer_mm is not None or self.route is None:
            return self.odometer_mm
        along_m = self.route.along_m
        known = np.flatnonzero(np.isfinite(along_m))
        along_m = np.interp(np.arange(len(along_m)), known, along_m[known])
        return None if along_m[-1] * 1e3 > MOST_MM else np.rint(along_m * 1e3).astype(np.int64)

    @property
    def acceptance(self) -> Acceptance:
        """The map's own table of probabilities; with the place filter, else the shipped one."""
        return Acceptance.of(self.settings, self.confidence)

    def matched_with(self, settings: Settings) -> Self:
        """Return the map with other settings for matching.

        Its own table of probabilities is removed if the scale of the trust changes.
        """
        expect(settings, Settings, "settings", "Settings, as of map.settings.replaced")
        settings = settings.at_places_of(self.settings)
        kept = settings.of_trust == self.settings.of_trust
        return replace(self, settings=settings, confidence=self.confidence if kept else None)

    def with_pixels(self, kept: npt.NDArray[np.bool_], pixel_map: PixelMap) -> Self:
        """Return the map with some of its pixels, and with all that is stored for these.

        Parameters
        ----------
        kept : ndarray of bool, shape (J,)
            Which pixels are kept, at least one.
        pixel_map : PixelMap
            Their positions, in the same order.
        """
        settings, places, left = self.settings, self.places, len(pixel_map)
        counters = np.concatenate([kept, kept]) if settings.polarity else kept
        # codes give roughly the share of events that the remaining counters had
        counts = self.decoded(places).counts
        events = max(1, int(counts[:, counters].sum(dtype=np.int64)))
        share = min(1.0, events / max(1, int(counts.sum(dtype=np.int64))))
        changes: dict[str, float] = {"pixels": left}
        if settings.events_per_pixel is not None:  # so that a window covers the same distance
            changes["events_per_pixel"] = settings.events_per_pixel * share * kept.size / left

        def of_counters(values: npt.NDArray[Any] | None) -> npt.NDArray[Any] | None:
            return None if values is None else np.ascontiguousarray(values[..., counters])

        return replace(
            self,
            settings=settings.replaced(changes, "the pixels that are left"),
            pixel_map=pixel_map,
            places=replace(
                places,
                counts=np.ascontiguousarray(places.counts[:, counters]),
                selected=np.rint(places.selected_events * share).astype(np.int64),
                counted=np.rint(places.counted_events * share).astype(np.int64),
            ),
            full_scale=of_counters(self.full_scale),
            mean=of_counters(self.mean),
            limits=of_counters(self.limits),
            learnt_mean=of_counters(self.learnt_mean),
        )

    def check_asked(self, settings: Settings) -> None:
        """Check that other settings for matching ask for no table in place of the map's own."""
        asks = settings.stays_on_map and not self.settings.stays_on_map
        if asks and self.matched_with(settings).confidence is not None:
            raise UsageError(
                "stays_on_map=True chooses a shipped table of probabilities, and the "
                "map has a table of its own (edge-vpr calibrate), which is used: leave it out"
            )

    def coded(self, counted: Descriptors) -> Descriptors:
        """Replace the counts of a query by the codes of this map."""
        code = self.own_mean_code
        if code is not None and self.mean is not None:
            activity, gains = self.mean_activity, self.settings.hypotheses
            counted = replace(counted, counted=self.counted_events(counted))
            if self.settings.running_mean:
                return encode_running(counted, code, self.mean, activity, gains)
            return encode_own(counted, code, activity, gains)
        counters = counted.counts.shape[1]
        codes = codes_of(self.settings, counters, self.full_scale)
        if codes is None:
            return counted
        described = narrow(codes.encode(counted.counts))
        return replace(counted, counts=described, selected=counted.selected_events)

    def counted_events(self, counted: Descriptors) -> npt.NDArray[np.int64]:
        """Return the events of each window of counts that count, shape (n,)."""
        if self.limits is None:
            return counted.counted_events
        return counted_events(counted.counts, self.limits)

    def decoded(self, descriptors: Descriptors) -> Descriptors:
        """Replace codes by counts for plots, each by the middle of the counts with that code."""
        code = self.own_mean_code
        if code is not None and self.mean is not None:
            return replace(descriptors, counts=narrow(code.decode(descriptors.counts, self.mean)))
        if self.codes is None:
            return descriptors
        return replace(descriptors, counts=narrow(self.codes.decode(descriptors.counts)))

    @property
    def bytes_per_place(self) -> int:
        """Size of a descriptor as stored and compared here, in bytes."""
        return self.places.counts.shape[1] * self.places.counts.itemsize

    @property
    def counter_bits(self) -> int:
        """Number of bits of the code of a counter, or of its stored count."""
        code = self.settings.shared_code
        return 8 * self.places.counts.itemsize if code is None else code.bits

    @property
    def places_text(self) -> str:
        """Number of places for messages, and where they are if not at whole windows."""
        return f"{len(self):,} places" + " (at half windows)" * (self.settings.window_parts == 2)

    @property
    def bytes_text(self) -> str:
        """Size of a second of the route for messages, packed as in the FPGA core."""
        return size_text(self.packed_bytes_per_window, self.windows.window_us)

    @property
    def packed_bytes_per_place(self) -> int:
        """Size of a place in bytes: codes packed without gaps, and the filter's activity."""
        codes = packed_bytes(self.places.counts.shape[1], self.counter_bits)
        return codes + (self.settings.matching == "filter")

    @property
    def packed_bytes_per_window(self) -> int:
        """Packed size of all places that begin in a window, in bytes."""
        return self.packed_bytes_per_place * self.settings.window_parts

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
            meta["trust_rule"] = TRUST_RULE
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
    def load(cls, path: str | Path) -> Self:
        """Read a saved map.

        A table of probabilities that an earlier version has learnt for the place filter is not
        used, because its trust had another scale. A warning says so.

        Raises
        ------
        MapError
            If the file is missing, unreadable, damaged, not a map, or of another version.
        """
        arrays, meta = read_archive(path, KIND)
        with archive_errors(path, "make the map again"):
            found = cls(
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
        earlier = found.settings.matching == "filter" and meta.get("trust_rule") != TRUST_RULE
        if found.confidence is None or not earlier:
            return found
        warnings.warn(
            f"{path}: its probabilities were learnt by an earlier version, with another scale of "
            "trust; the shipped ones are used: calibrate it again (edge-vpr calibrate)",
            EdgeVprWarning,
            stacklevel=2,
        )
        return replace(found, confidence=None)


# Descriptors of a drive, with the codes of a map.


def describe(
    recording: EventSource | WindowSource | str | Path,
    pixel_map: PixelMap,
    settings: Settings,
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window, in one pass.

    Parameters
    ----------
    recording : recording or path
        A path is opened by `open_recording`.
    settings : Settings
        Of the map, with counts or with a code that is the same for all pixels.

    Returns
    -------
    Descriptors
        At least one.

    Raises
    ------
    UsageError
        If the recording is shorter than a window.
    """
    recording = opened(recording)
    expect(pixel_map, PixelMap, "pixel_map", "a PixelMap, as of select_pixels or of a map")
    expect(settings, Settings, "settings", "Settings, as of a map or of resolve_settings")
    counters = len(pixel_map) * (2 if settings.polarity else 1)
    codes = codes_of(settings, counters)
    counted = count_windows(recording, pixel_map, settings)
    if codes is None:
        return counted
    return replace(counted, counts=narrow(codes.encode(counted.counts)))


def describe_query(
    reference: MapRecord,
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
    _warn_of_silence(counted)
    return reference.coded(counted)


#: longest time without any event at which nothing is said
_SILENT_US = 10_000_000


def _warn_of_silence(windows: Descriptors) -> None:
    """Warn of a long time without any event, where a clock may have jumped."""
    silent = np.concatenate([[False], windows.events == 0, [False]])
    edges = np.flatnonzero(silent[1:] != silent[:-1])
    start, end = windows.start_us[edges[::2]], windows.end_us[edges[1::2] - 1]
    at = int(np.argmax(end - start)) if start.size else 0
    if not start.size or end[at] - start[at] < _SILENT_US:
        return
    warnings.warn(
        f"the recording has no event from {start[at] / 1e6:,.0f} to {end[at] / 1e6:,.0f} s, where "
        "a camera that stands still has noise: was it off, or did its clock jump? If it jumped, "
        "later times are wrong: use the parts before and after alone",
        EdgeVprWarning,
        stacklevel=4,
    )


# Making a map of a reference drive: select pixels, and make its windows places.


def map_traverse(
    recording: EventSource | WindowSource,
    settings: Settings,
    *,
    pixel_map: PixelMap | None = None,
    hot: npt.NDArray[np.bool_] | None = None,
    removed: Removed | None = None,
) -> MapRecord:
    """Make a reference map of one drive, in one pass over its events or two.

    A second pass is needed for fixed-count windows, for polarity, and if the images of all windows,
    or of their parts, are too large for a temporary file. If a recording has events
    at few pixels alone, as published counts do, and no more than the settings ask for, all of them
    are the map's.

    Parameters
    ----------
    recording : EventSource or WindowSource
        For example from `open_recording`.
    pixel_map : PixelMap, optional
        Pixels to use; by default they are selected as the settings say.
    hot : ndarray of bool, shape (height, width), optional
        Hot pixels; by default they are found, if the settings ask for it and at least half of the
        pixels fire.
    removed : Removed, optional
        Is filled with what was left out.

    Raises
    ------
    UsageError
        If the recording is shorter than a window (than two, where pixels are selected by their
        variance), or too few pixels can be drawn.
    RecordingError, EventError
        If the recording is faulty.
    """
    recording = opened(recording)
    sensor = recording.sensor
    if removed is not None:
        expect(removed, Removed, "removed", "Removed() to be filled, or leave it out")
    if hot is not None:
        expect(hot, np.ndarray, "hot", "an array of bool, shape (height, width), or a file")
        if hot.dtype != np.bool_:
            raise UsageError(f"hot pixels are an array of {hot.dtype}: give one of bool")
    if hot is not None and hot.shape != (sensor.height, sensor.width):
        raise UsageError(
            f"hot pixels are given for {hot.shape[1]}x{hot.shape[0]} pixels and the recording is "
            f"of a {sensor} sensor: give the list of this camera"
        )
    if pixel_map is not None:
        expect(pixel_map, PixelMap, "pixel_map", "a PixelMap(sensor, x, y)")
        check_sensor(sensor, pixel_map.sensor)
        settings = settings.replaced({"pixels": len(pixel_map)}, "the pixel map")
    if settings.places_per_window is None:
        settings = with_places(settings, recording)
    check_parts(recording, settings)
    # the released code selects by clipped counts; with other codes, pixels are selected by plain
    # counts, so that maps with different codes have the same pixels
    needs_events = settings.window == "count" or settings.polarity
    parts = 1 if needs_events else settings.window_parts
    stream = None
    with PixelStatistics(sensor, clip=settings.clip, parts=parts) as first:
        if isinstance(recording, WindowSource):
            check_windows_only(settings)
            settings = settings.replaced({"tau_us": recording.window_us}, "the published windows")
            if pixel_map is not None:
                check_counted(recording, pixel_map, settings)
            windows = recording.windows()
        else:
            everything = PixelMap.all_of(sensor)
            stream = DescriptorStream(everything, FixedTime(settings.tau_us // parts))
            windows = event_windows(recording, stream, settings, removed)
        for window in windows:
            first.add(window)
        if first.windows == 0:
            raise too_short(FixedTime(settings.tau_us), stream)
        counted = np.ones((sensor.height, sensor.width), dtype=np.bool_)
        if isinstance(recording, WindowSource):
            counted = recording.counted
        # next to pixels that were not counted, all others would look hot
        searched = settings.remove_hot_pixels and counted.all() and can_be_searched(first.totals)
        if hot is None and searched:
            hot = find_hot_pixels(first.totals)
        elif hot is None:
            hot = np.zeros_like(counted)
        saliency = first.mean() if settings.strategy == "seed-code" else first.variance()
        if pixel_map is not None:
            hot = hot & (pixel_map.table() < 0)
        else:
            pixel_map = _choose_pixels(first, recording, settings, saliency, hot, ~counted)
            settings = settings.replaced({"pixels": len(pixel_map)}, "the recording")
        selected = int(first.totals[pixel_map.y, pixel_map.x].sum())
        if settings.window == "time" and selected < first.windows:
            warnings.warn(
                f"windows of {FixedTime(settings.tau_us)} hold {selected / first.windows:.2g} "
                f"events at the {len(pixel_map)} pixels of the map in the mean, and their places "
                f"look alike: take longer windows (tau=), or more pixels (pixels=)",
                EdgeVprWarning,
                stacklevel=3,
            )
        if settings.window == "count" and settings.events_per_pixel is None:
            settings = _with_mean_count(settings, first, pixel_map)
        pieces = None if needs_events else first.pieces(pixel_map)
    if pieces is None:
        places = count_places(recording, pixel_map, settings, removed)
    else:
        places = pieces if parts == 1 else overlapping(pieces, parts)
    _warn_of_silence(places)
    return coded_map(
        MapRecord(settings.uncoded, pixel_map, places, saliency.astype(np.float32), hot),
        settings,
    )


def _choose_pixels(
    first: PixelStatistics,
    recording: EventSource | WindowSource,
    settings: Settings,
    saliency: npt.NDArray[np.float64],
    hot: npt.NDArray[np.bool_],
    uncounted: npt.NDArray[np.bool_],
) -> PixelMap:
    """Choose the pixels of a map by the strategy of its settings."""
    if first.windows == 1 and settings.strategy in ("variance", "top", "information"):
        raise UsageError(
            f"the drive holds one window of {FixedTime(settings.tau_us)}, and pixels can be "
            "selected only from two windows or more: take shorter windows (tau=), or a "
            "longer drive"
        )
    given = _given_pixels(first, settings.pixels, hot)
    if given is not None:
        return given
    excluded = hot | uncounted
    if settings.strategy == "information":
        listed = shortlist(saliency, excluded)
        if len(listed) < settings.pixels:
            varying = int(np.count_nonzero(saliency[hot]))
            raise too_few_pixels(len(listed), varying, settings.pixels, recording.sensor)
        return _most_informative(first, recording, settings, listed)
    if settings.strategy.startswith(PLUGIN):
        return plugin_pixels(first, settings, excluded)
    return select_pixels(
        saliency,
        settings.pixels,
        strategy=settings.strategy,
        sigma=settings.sigma,
        rng=np.random.default_rng(settings.seed),
        exclude=excluded,
    )


def _given_pixels(
    first: PixelStatistics, pixels: int, hot: npt.NDArray[np.bool_]
) -> PixelMap | None:
    """Return the pixels that fire, if they were selected before: few, and busy.

    Counts are often published at selected pixels alone, which are then all of the map. In a drive
    that is too short, few pixels fire too, but most of them not even once a window.
    """
    totals = first.totals
    fires = totals > 0
    few = int(np.count_nonzero(fires))
    busy = int(totals.sum()) >= few * first.windows
    # of a sensor that has no more pixels than are asked for, all are to be taken
    selected = totals.size <= pixels or not can_be_searched(totals)
    if not 0 < few <= pixels or not selected or not busy or (hot & fires).any():
        return None
    y, x = np.nonzero(fires)
    height, width = totals.shape
    return PixelMap(Sensor(width, height), x.astype(np.uint16), y.astype(np.uint16))


def check_matchable(reference: MapRecord) -> None:
    """Raise UsageError if a map has fewer places than its sequences have windows."""
    length, places = reference.settings.windows_per_match, len(reference)
    if length > places:
        raise UsageError(
            f"a sequence of {length} windows does not fit the {places} places of this drive: take "
            "a shorter sequence (sequence_length=), shorter windows (tau=), or a longer drive"
        )


def _most_informative(
    first: PixelStatistics,
    recording: EventSource | WindowSource,
    settings: Settings,
    listed: PixelMap,
) -> PixelMap:
    windows = first.descriptors(listed)
    if windows is None:  # too large for a temporary file: events are counted again
        by_time = settings.uncoded.replaced({"window": "time", "polarity": False}, "the shortlist")
        windows = count_windows(recording, listed, by_time)
    return informative_pixels(listed, windows.counts, settings.pixels)


def coded_map(counted: AnyMap, settings: Settings) -> AnyMap:
    """Code the counts of a reference map, and compute the parameters of its code from them.

    Parameters
    ----------
    counted : MapRecord
        With counts as they are, at least one place.
    settings : Settings
        Of the map to make.
    """
    places, windows = counted.places, counted.windows
    counts, events = places.counts, places.selected_events
    full_scale, mean, limits, that_count = None, None, None, None
    code = settings.own_mean_code
    if code is not None:
        limits = limits_of(windows.counts)
        that_count, of_windows = (counted_events(each.counts, limits) for each in (places, windows))
        windows = replace(windows, counted=of_windows)
        mean = drive_mean(windows, code, activity_of_drive(of_windows))
        coded: npt.NDArray[np.unsignedinteger] = code.encode(counts, mean)
    else:
        full_scale = learn_full_scale(windows.counts) if settings.learns_full_scale else None
        codes = codes_of(settings, counts.shape[1], full_scale)
        coded = counts if codes is None else narrow(codes.encode(counts))
    return replace(
        counted,
        settings=settings,
        places=replace(places, counts=coded, selected=events, counted=that_count),
        full_scale=full_scale,
        mean=mean,
        limits=limits,
    )


def _with_mean_count(settings: Settings, first: PixelStatistics, pixel_map: PixelMap) -> Settings:
    """Set the number of events in a window to the average of a window of tau."""
    events = int(first.totals[pixel_map.y, pixel_map.x].sum())
    number = settings.window_parts  # a window has as many whole parts
    mean = number * max(1, round(events / first.windows / number))
    return settings.replaced({"events_per_pixel": mean / len(pixel_map)}, "the reference")


def with_places(settings: Settings, recording: EventSource | WindowSource | None) -> Settings:
    """Set the number of places per window: two if windows of this recording can overlap.

    None stands for a recording of single events.
    """
    period = getattr(recording, "frame_period", None)
    two = (
        settings.matching == "filter"
        and settings.window == "time"
        and settings.tau_us % 2 == 0
        and not isinstance(recording, WindowSource)
        and (period is None or LEAST_FRAMES * period * 1_000_000 <= settings.tau_us)
    )
    return settings.replaced({"places_per_window": 2 if two else 1}, "the reference")
