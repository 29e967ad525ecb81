"""`edge-vpr calibrate`: learn the probability of a right match from a drive."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import note, summary
from edge_vpr_tools.flags import add_truth_flags

EXAMPLES = """\
  edge-vpr calibrate tuesday --ground-truth monday.nmea tuesday.nmea --tolerance 70
  edge-vpr calibrate tuesday --ground-truth pairs.csv --tolerance 3 -o calibrated.npz"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("results", metavar="RESULTS", help="folder that edge-vpr match wrote")
    output = parser.add_argument_group("output")
    output.add_argument(
        "-o",
        "--output",
        metavar="MAP.npz",
        help="map to write, which holds the learnt table of probabilities (default: the map in "
        "RESULTS)",
    )
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    add_truth_flags(parser.add_argument_group("ground truth"))


#: with fewer matches, even if all are right, the table cannot reach a precision of 0.99
FEW_MATCHES = 100


def run(args: argparse.Namespace) -> None:
    """Learn the table of probabilities and write it with the map."""
    from edge_vpr import results
    from edge_vpr.files import check_output
    from edge_vpr_tools.inputs import load_evaluated
    from edge_vpr_tools.runs.mapping import calibrate

    folder = Path(args.results)
    output = folder / results.MAP if args.output is None else Path(args.output)
    if args.output is not None:
        check_output(output, [folder, *args.ground_truth])
        if output.suffix != ".npz":
            raise UsageError(f"output {output} does not end in .npz: name the map, as map.npz")
        if output.exists() and not args.overwrite:
            raise UsageError(f"output {output} exists: name another, or replace with --overwrite")
        results.check_parent(output)
    reference, matches, truth = load_evaluated(args)
    found = calibrate(reference, matches, truth)
    if found.settings_changed:
        note(
            f"{output} has the settings that the drive was matched with; the table holds for these"
        )
    found.reference.save(output)

    if found.matches < FEW_MATCHES:
        note(f"{found.matches} matches are few to learn probabilities from: calibrate with more")
    if not (folder / results.QUERIES).is_file():
        note(
            "matches after every event are almost copies of each other, so that the "
            "probabilities are more extreme than the drive justifies: calibrate from matches "
            "without --online, or with --every window"
        )
    if found.off_map == 0:
        note(
            "every query of this drive is on the map: on drives that leave it, the probabilities "
            "will be too high"
        )
    before = ""
    if found.error_before is not None:
        before = f"; the table used before was off by {found.error_before:.3f} on average"
    table = found.confidence
    summary(
        f"{output}: probabilities in {len(table.trust)} steps from {found.matches} matches, "
        f"{found.right} of them correct{before}"
    )
    summary(
        f"they range from {table.probability[0]:.3f} to {table.probability[-1]:.3f}, and are off "
        f"by {found.error:.3f} on the drive that they were learnt from"
    )
