"""`edge-vpr golden`: write golden vectors, with which devices are tested."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.whole_files import check_output, replacing_folder
from edge_vpr_tools.arguments.reading import open_from
from edge_vpr_tools.device.design_errors import design_errors
from edge_vpr_tools.device.vectors import check_vectors_folder, missed_corners, recorded_case
from edge_vpr_tools.estimate.of_map import design_of
from edge_vpr_tools.output.messages import note, summary
from firmware_model import Design
from firmware_model.vectors import Case, standard_suites, write_suites


@design_errors()
def run(args: argparse.Namespace) -> None:
    """Make vectors and write them."""
    if (args.design is None) == (args.map is None):
        raise UsageError("golden needs either --design or --map: give one of them")
    if args.recording is not None and args.map is None:
        raise UsageError("--recording needs a map: name it with --map")
    if "recording" in args.suite and args.recording is None:
        raise UsageError("--suite recording needs a drive: name one with --recording")
    output = Path(args.output)
    check_output(output, (args.design, args.map, args.recording))
    check_vectors_folder(output, args.overwrite)
    recorded: list[Case] = []
    if args.map is None:
        design = Design.load(args.design)
    else:
        reference = ReferenceMap.load(args.map)
        design = design_of(reference, args.lanes)
        if args.recording is not None:
            recording = open_from(args, args.recording)
            recorded = [recorded_case(reference, design, recording, args.max_events)]
    suites = _suites(args, design, recorded)
    with replacing_folder(output) as folder:
        manifest = write_suites(folder, design, suites, args.seed, rtl=args.rtl)
    for suite in manifest.suites:
        missed = missed_corners(suite)
        if missed:
            note(f"no case of this design reaches these corners: {', '.join(missed)}")
    for suite in manifest.suites:
        events, windows, matches = (
            sum(getattr(case, what) for case in suite.cases)
            for what in ("events", "windows", "matches")
        )
        reached = sum(number > 0 for number in suite.coverage.values())
        summary(
            f"{args.output}/{suite.name}: {len(suite.cases)} cases, {events:,} events, "
            f"{windows} windows, {matches} matches, {reached} of {len(suite.coverage)} corners"
        )


def _suites(
    args: argparse.Namespace, design: Design, recorded: list[Case]
) -> dict[str, list[Case]]:
    """Make the suites that are wanted, by default all."""
    if not args.suite:
        suites = standard_suites(design, args.seed)
        return suites | {"recording": recorded} if recorded else suites
    suites = {}
    for name in args.suite:
        made = {name: recorded} if name == "recording" else standard_suites(design, args.seed, name)
        if not made:
            raise UsageError(f"--suite {name}: this design has no place filter and no own means")
        suites |= made
    return suites
