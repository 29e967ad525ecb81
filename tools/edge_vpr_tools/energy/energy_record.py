"""Energy of a match: measured, void because of throttling, or not measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

from edge_vpr_tools.energy.sampling import Window
from edge_vpr_tools.energy.sensors.sensor import About
from edge_vpr_tools.output.json_records import (
    LEFT_OUT,
    fields_from_json,
    fields_to_json,
    from_json,
    to_json,
)

Bounds = tuple[float, float]
#: the figures that have an interval
BOUNDED = (
    "marginal_j_per_match", "saturated_j_per_match", "mission_j_per_match", "matches_per_joule",
    "idle_w",
)  # fmt: skip


class Bounded(NamedTuple):
    """Figure with its 95 % interval; None if it is not resolved or not known."""

    value: float | None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures on the energy of a match, from idle and load periods.

    Attributes
    ----------
    marginal_j_per_match : float or None
        Joules under load minus joules at rest; None if the difference is not resolved.
    marginal_j_per_match_interval : pair of float
        95 % interval, like all intervals here.
    marginal_j_per_match_interval_with_gain : pair of float
        The same interval, widened by the gain error of the meter.
    pairs_needed : int or None
        Number of pairs that would resolve the difference if the spread stays the same; None if it
        is resolved, or if no number would resolve it.
    saturated_j_per_match, mission_j_per_match : float
        Joules of the whole board, at full speed and at the match rate of the mission.
    matches_per_joule : float or None
        Computed from the marginal energy.
    idle_w, load_w : float
        Power at rest and under load, in watts.
    """

    marginal_j_per_match: float | None
    marginal_j_per_match_interval: Bounds
    marginal_j_per_match_interval_with_gain: Bounds
    pairs_needed: int | None
    saturated_j_per_match: float
    saturated_j_per_match_interval: Bounds
    mission_j_per_match: float
    mission_j_per_match_interval: Bounds
    matches_per_joule: float | None
    matches_per_joule_interval: Bounds | None
    idle_w: float
    idle_w_interval: Bounds
    load_w: float

    @property
    def resolved(self) -> bool:
        """Whether the energy of the work is larger than the noise."""
        return self.marginal_j_per_match is not None

    def bounded(self, name: str) -> Bounded:
        """Return one of the figures `BOUNDED` with its interval."""
        return Bounded(getattr(self, name), *(getattr(self, f"{name}_interval") or ()))


class PowerTrace(NamedTuple):
    """Power over time, with few points for a figure; seconds since the first window, and watts."""

    time_s: tuple[float, ...]
    watts: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Readings and their sensor, which are kept even if the figures are void.

    Attributes
    ----------
    sensor : About
    differences_w : tuple of float
        Power under load minus power at rest, one value for each pair.
    windows : tuple of Window
        Times are in seconds since the first window.
    trace : PowerTrace
    """

    sensor: About
    differences_w: tuple[float, ...]
    windows: tuple[Window, ...]
    trace: PowerTrace


@dataclass(frozen=True, kw_only=True)
class Energy:
    """Measured energy of a match.

    In JSON, the fields of `figures` and `readings` are on the same level as the others.

    Attributes
    ----------
    pairs : int
        Number of pairs of an idle and a load window.
    window_s : float
        Median length of a window.
    native_samples_per_window : int
        Number of readings that differ from the previous one.
    saturated_matches_per_s, mission_matches_per_s : float
        Matches per second at full speed, and in the mission.
    figures : Figures or None
        None if the machine was throttled, since figures would then mislead.
    readings : Readings or None
        None for a design other than the main load.
    quick : bool
        Whether windows were too short for a figure that can be published.
    cpu_s_per_match, sampler_cpu_share : float or None
        Processor time of a match, and share of a core that sampling took; not known with an
        external meter.
    """

    pairs: int
    window_s: float
    native_samples_per_window: int
    saturated_matches_per_s: float
    mission_matches_per_s: float
    figures: Figures | None
    readings: Readings | None = None
    quick: bool = False
    cpu_s_per_match: float | None = field(default=None, metadata=LEFT_OUT)
    sampler_cpu_share: float | None = field(default=None, metadata=LEFT_OUT)

    @property
    def resolved(self) -> bool:
        """Whether there are figures, and they resolve the energy of the work."""
        return self.figures is not None and self.figures.resolved

    def void(self) -> Energy:
        """Return the same without figures, because the machine was throttled."""
        return replace(self, figures=None)

    def brief(self) -> Energy:
        """Return the same without the readings, which are shown only for the main load."""
        return replace(self, readings=None)

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        values = fields_to_json(self)
        figures, readings = values.pop("figures"), values.pop("readings")
        figures = figures or dict.fromkeys(one.name for one in fields(Figures))
        return {"measured": True, "resolved": self.resolved} | values | figures | (readings or {})

    @classmethod
    def from_json(cls, values: Mapping[str, Any], where: str) -> Energy:
        """Read an object from values of JSON; see `json_records.from_json`."""
        void = all(values.get(one.name) is None for one in fields(Figures))
        nested = {
            "figures": None if void else from_json(Figures, values, where),
            "readings": from_json(Readings, values, where) if "trace" in values else None,
        }
        return fields_from_json(cls, {**values, **nested}, where)


@dataclass(frozen=True)
class NotMeasured:
    """The reason why no energy was measured.

    Attributes
    ----------
    not_measured_because : tuple of str
    windows : tuple of Window
        Windows that were run for an external meter, on the monotonic clock.
    """

    not_measured_because: tuple[str, ...]
    windows: tuple[Window, ...] = ()

    @property
    def resolved(self) -> bool:
        """Always False."""
        return False

    def void(self) -> NotMeasured:
        """Return the same object, since there are no figures to remove."""
        return self

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        because = list(self.not_measured_because)
        values = {"measured": False, "resolved": False, "not_measured_because": because}
        return values | ({"windows": to_json(self.windows)} if self.windows else {})


#: in the order in which the types are tried when a file is read
Outcome = NotMeasured | Energy
