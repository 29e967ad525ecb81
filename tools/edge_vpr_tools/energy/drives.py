"""Drives of a profile: the user's map and drive, or a simulated street."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from edge_vpr.events import Events
from edge_vpr.pipeline import EventSource, cleaned, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulate import simulate_pair
from edge_vpr_tools.energy.designs import Compared, of_pair
from edge_vpr_tools.experiments.simulated import truth_of_pair
from edge_vpr_tools.experiments.trial import TruthOf
from edge_vpr_tools.output.progress import keep_shown

#: length of the simulated street, which has about 70 places
_STREET_M = 400.0


@dataclass(frozen=True, eq=False)
class Load:
    """Load: a map, the events of a query drive and, if its truth is known, designs to compare.

    Attributes
    ----------
    name : str
        Name of the recording.
    reference : ReferenceMap
    events : list of ndarray
        Cleaned events of the query drive.
    query : EventSource
    designs : iterable of Compared
    truth_of : callable, optional
    inputs : sequence of path
    """

    name: str
    reference: ReferenceMap
    events: list[Events]
    query: EventSource
    designs: Iterable[Compared]
    truth_of: TruthOf | None
    inputs: Sequence[str]


def simulated_load(seed: int) -> Load:
    """Simulate a street: one drive is mapped, and the query drive is the load."""
    pair = simulate_pair(seed, length_m=_STREET_M)
    for name, drive in zip(("reference", "query"), pair, strict=True):
        keep_shown(drive, f"simulating the {name}")
    # N is the average number of events in a window of tau
    fixed_n = PRESETS["paper"].replaced({"window": "count", "events_per_pixel": None}, "profile")
    reference = map_traverse(pair[0], fixed_n)
    events = list(cleaned(pair[1], reference.settings))
    designs = of_pair(pair[0], reference)
    name = f"simulated street of {_STREET_M:g} m"
    return Load(name, reference, events, pair[1], designs, truth_of_pair(*pair), [])
