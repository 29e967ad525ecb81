"""What a profile runs: a map and a drive of the user's, or a simulated street."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from edge_vpr.events import Events
from edge_vpr.pipeline import EventSource, check_sensor, cleaned, describe_query, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulate import simulate_pair
from edge_vpr_tools.arguments.reading import open_from
from edge_vpr_tools.arguments.truth import load_truth
from edge_vpr_tools.energy.designs import Compared, of_map, of_pair
from edge_vpr_tools.experiments.simulated import truth_of_pair
from edge_vpr_tools.experiments.trial import Times, TruthOf
from edge_vpr_tools.output.progress import keep_shown

#: of the simulated street: some 70 places
_STREET_M = 400.0


@dataclass(frozen=True, eq=False)
class Load:
    """What is run: a map, the events of a query drive, and designs to compare, if truth is known.

    Attributes
    ----------
    name : str
        Of the recording.
    reference : ReferenceMap
    events : list of ndarray
        Of the query drive, cleaned.
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


def load_of(args: argparse.Namespace) -> Load:
    """Open what the command line of `edge-vpr profile` names, or simulate a street.

    Raises
    ------
    EdgeVprError
        If map, recording or ground truth cannot be used.
    """
    if args.map is None:
        return _simulated(args.seed)

    reference = ReferenceMap.load(args.map)
    recording = open_from(args, args.recording)
    check_sensor(recording.sensor, reference.pixel_map.sensor)
    truth_of = None
    inputs = [args.map, args.recording]
    if args.ground_truth is not None:
        inputs += args.ground_truth

        def truth_of(places_us: Times, queries_us: Times) -> Any:
            return load_truth(
                args.ground_truth, places_us, queries_us, tolerance=args.tolerance, rows=args.rows,
                frame_period=args.frame_period,
            )  # fmt: skip

        # once at the door: it is needed again after minutes of measuring
        queries = describe_query(reference, recording)
        truth_of(reference.places.centre_us, queries.centre_us)
    events = list(cleaned(recording, reference.settings))
    designs = of_map(reference)
    return Load(args.recording, reference, events, recording, designs, truth_of, inputs)


def _simulated(seed: int) -> Load:

    pair = simulate_pair(seed, length_m=_STREET_M)
    for name, drive in zip(("reference", "query"), pair, strict=True):
        keep_shown(drive, f"simulating the {name}")
    # N as a window of tau holds on average
    fixed_n = PRESETS["paper"].replaced({"window": "count", "events_per_pixel": 0.0}, "profile")
    reference = map_traverse(pair[0], fixed_n)
    events = list(cleaned(pair[1], reference.settings))
    designs = of_pair(pair[0], reference)
    name = f"simulated street of {_STREET_M:g} m"
    return Load(name, reference, events, pair[1], designs, truth_of_pair(*pair), [])
