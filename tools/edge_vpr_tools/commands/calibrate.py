"""`edge-vpr calibrate`: learn the probability of a correct match from a drive."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import note, summary
from edge_vpr_tools.flags import add_output_flags

if TYPE_CHECKING:
    from edge_vpr.confidence import Confidence
    from edge_vpr.evaluation.ground_truth import GroundTruth
    from edge_vpr.matching.matches import Matches
    from edge_vpr.reference_map import ReferenceMap

EXAMPLES = """\
  edge-vpr calibrate tuesday
  edge-vpr calibrate tuesday -o calibrated.npz"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "results", metavar="RESULTS", help="folder of matches, after edge-vpr evaluate"
    )
    add_output_flags(
        parser,
        "MAP.npz",
        "map to write, with the learnt table of probabilities (default: the map in RESULTS)",
        required=False,
    )


class Calibrated(NamedTuple):
    """A map with a table of probabilities, and their error."""

    reference: ReferenceMap
    confidence: Confidence  #: The table, as the map has it.
    #: Whether the map took over the settings that the drive was matched with.
    settings_changed: bool
    #: matches, correct, off_map: that were learnt from, those of them that are correct, and queries
    #: off the map.
    matches: int
    correct: int
    off_map: int
    error_before: float | None  #: Expected calibration error of the table used before.
    error: float  #: Expected calibration error on the drive that it was learnt from.


def calibrate(reference: ReferenceMap, matches: Matches, truth: GroundTruth) -> Calibrated:
    """Learn the probability that a match is correct."""
    from edge_vpr.evaluation.calibration import learn_confidence, reliability
    from edge_vpr.evaluation.metrics import evaluate

    evaluation = evaluate(matches, truth)
    trust, correct = (
        matches.net_trust[evaluation.evaluated],
        evaluation.correct[evaluation.evaluated],
    )
    confidence = learn_confidence(trust, correct)
    changed = reference.settings.of_trust != matches.settings.of_trust
    if changed:
        taken = matches.settings.to_dict()
        of_map = reference.settings.to_dict()
        kept = {name: of_map[name] for name in ("precision", "stays_on_map")}
        settings = reference.settings.replaced(taken | kept, "the matches")
        reference = replace(reference, settings=settings)
    before = evaluation.reliability
    within = reliability(confidence.probability_of(trust), correct)
    return Calibrated(
        reference=replace(reference, confidence=confidence),
        confidence=confidence,
        settings_changed=changed,
        matches=int(trust.size),
        correct=int(correct.sum()),
        off_map=evaluation.rejection.off_map,
        error_before=None if before is None else before.expected_calibration_error,
        error=within.expected_calibration_error,
    )


def run(args: argparse.Namespace) -> None:
    """Learn the table of probabilities and write it with the map."""
    from edge_vpr import results
    from edge_vpr.files import check_new_map
    from edge_vpr_tools.truth_files import evaluated_truth, load_evaluated

    folder = Path(args.results)
    output = folder / results.MAP if args.output is None else Path(args.output)
    files = evaluated_truth(folder)
    if files is None:
        raise UsageError(
            f"{folder} was not evaluated: run edge-vpr evaluate {quote(str(folder))} first"
        )
    if args.output is not None:
        check_new_map(output, [folder, *files.files], args.overwrite)
    result, truth, _ = load_evaluated(folder, files)
    calibration = calibrate(result.reference, result.matches, truth)
    if calibration.settings_changed:
        note(
            f"{output} has the settings that the drive was matched with; the table holds for these"
        )
    # without -o, the results' own map gets the table
    calibration.reference.save(output, overwrite=args.overwrite or args.output is None)

    before = ""
    if calibration.error_before is not None:
        before = f"; the table used before was off by {calibration.error_before:.3f} on average"
    table = calibration.confidence
    summary(
        f"{output}: probabilities in {len(table.trust)} steps from {calibration.matches} matches, "
        f"{calibration.correct} of them correct and {calibration.off_map} off the map{before}"
    )
    summary(
        f"they range from {table.probability[0]:.3f} to {table.probability[-1]:.3f}, and are off "
        f"by {calibration.error:.3f} on the drive that they were learnt from"
    )
