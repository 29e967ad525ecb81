"""Settings that the place filter is compared by, and drives of simulated streets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from edge_vpr.settings.choices import Score
from edge_vpr.simulate import QUERY, Drive, Light

_FILTER = {"matching": "filter", "anchor": "end", "score": None}
_SMOOTH = {"smooth": True}
_LOG = {"counter_code": "log", "score": None}
_OWN = {**_LOG, "counter_scaling": "own-mean"}
_ROBOT = {**_FILTER, **_OWN, "query_mean": "running"}
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "sequences of 5, counts (the paper)": {"sequence_length": 5},
    "sequences of 5, 3-bit log": {**_LOG, "sequence_length": 5},
    "sequences of 10, 3-bit log": {**_LOG, "sequence_length": 10},
    "sequences of 10, own mean": {**_OWN, "sequence_length": 10},
    "place filter, counts": _FILTER,
    "place filter, 3-bit log": {**_FILTER, **_LOG},
    "place filter, own mean": {**_FILTER, **_OWN},
    "place filter, running mean (robot)": _ROBOT,
    "place filter, running mean (robot), 4 windows late": {**_ROBOT, "delay": 4},
    "place filter, own mean, smoothed (default)": {**_FILTER, **_OWN, **_SMOOTH},
}
BEST = "place filter, own mean, smoothed (default)"
ROBOT = "place filter, running mean (robot)"
SCORES: tuple[Score, ...] = ("distance", "ratio", "margin", "trust")
#: values of the sensitivity plot, around the default
SWEEPS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "price of a restart": {str(p): {"filter_restart": p} for p in (8, 12, 16, 24, 32, 64)},
    "price of standing and of double pace": {
        str(p): {"filter_steps": (p, 0, p)} for p in (0, 1, 2, 3, 4)
    },
    "bits of a code": {str(bits): {"counter_bits": bits} for bits in (2, 3, 4, 5)},
}


class Second(NamedTuple):
    """A second drive along the street.

    Attributes
    ----------
    drive : Drive
    contrast : float
        Thresholds of the camera, as a multiple of those in the reference drive.
    """

    drive: Drive
    contrast: float = 1.0


#: as in the demo, in two other lights, with stops, and with a camera that fires sooner or later
STREETS: Mapping[str, Second] = {
    "street": Second(QUERY),
    "street, low sun": Second(
        replace(
            QUERY,
            light=Light(sun=0.2, ambient=0.15, azimuth_deg=110.0, elevation_deg=15.0, glare=0.06),
        )
    ),
    "street, noon": Second(
        replace(
            QUERY,
            light=Light(sun=0.9, ambient=0.2, azimuth_deg=-160.0, elevation_deg=70.0, glare=0.0),
        )
    ),
    "street, 3 stops": Second(replace(QUERY, stops=3, stop_s=10.0)),
    "street, thresholds x 1.3": Second(QUERY, 1.3),
    "street, thresholds x 0.75": Second(QUERY, 0.75),
}
