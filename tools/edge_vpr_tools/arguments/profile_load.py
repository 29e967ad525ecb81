"""The work to be measured, as the flags of `edge-vpr profile` describe it."""

from __future__ import annotations

import argparse
from functools import partial

from edge_vpr.pipeline import check_sensor, cleaned, describe_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.arguments.reading import open_from
from edge_vpr_tools.energy.designs import of_map
from edge_vpr_tools.energy.drives import Load, simulated_load
from edge_vpr_tools.runs.truth_files import load_truth


def load_of(args: argparse.Namespace) -> Load:
    """Open the map and the recording that the flags name, or simulate a street.

    Raises
    ------
    EdgeVprError
        If map, recording or ground truth cannot be used.
    """
    if args.map is None:
        return simulated_load(args.seed)

    reference = ReferenceMap.load(args.map)
    recording = open_from(args, args.recording)
    check_sensor(recording.sensor, reference.pixel_map.sensor)
    truth_of = None
    inputs = [args.map, args.recording]
    if args.ground_truth is not None:
        inputs += args.ground_truth
        truth_of = partial(
            load_truth, args.ground_truth, tolerance=args.tolerance, rows=args.rows,
            frame_period=args.frame_period,
        )  # fmt: skip
        # so that a wrong ground truth is an error now, and not after minutes of measuring
        queries = describe_query(reference, recording)
        truth_of(reference.places.centre_us, queries.centre_us)
    events = list(cleaned(recording, reference.settings))
    designs = of_map(reference)
    return Load(args.recording, reference, events, recording, designs, truth_of, inputs)
