"""`edge-vpr calibrate`: how probable is it that a match is right? Learns it from a drive."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.calibration import learn_confidence, reliability
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.whole_files import check_output
from edge_vpr_tools.arguments.truth import load_evaluated
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import note, summary

#: with fewer, even matches that were all right would not promise a precision of 0.99
FEW_MATCHES = 100


def run(args: argparse.Namespace) -> None:
    """Learn the table of probabilities and write it with the map.

    Raises
    ------
    EdgeVprError
        If the folder, the ground truth or the output cannot be used.
    """
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
    found = evaluate(matches, truth)
    trust, correct = matches.trust[found.evaluated], found.correct[found.evaluated]
    confidence = learn_confidence(trust, correct)
    if reference.settings.of_trust != matches.settings.of_trust:
        changed = matches.settings.to_dict()
        kept = {name: reference.settings.to_dict()[name] for name in ("precision", "query_mean")}
        settings = reference.settings.replaced(changed | kept, "the matches")
        reference = replace(reference, settings=settings)
        note(f"{output} has the settings that the drive was matched with, which the table is of")
    replace(reference, confidence=confidence).save(output)

    if trust.size < FEW_MATCHES:
        note(f"{trust.size} matches are few to learn probabilities from: calibrate with more")
    if not (folder / results.QUERIES).is_file():
        note(
            "matches event by event repeat one another, so that the probabilities are bolder than "
            "the drive allows: calibrate from matches without --online, or with --every window"
        )
    if found.rejection.off_map == 0:
        note(
            "every query of this drive is on the map: of drives that leave it, the probabilities "
            "will be too high"
        )
    before = "" if found.reliability is None else (
        f"; the table used before was off by {found.reliability.expected_calibration_error:.3f} "
        "on average"
    )  # fmt: skip
    within = reliability(confidence.probability_of(trust), correct)
    summary(
        f"{output}: probabilities in {len(confidence.trust)} steps from {trust.size} matches, "
        f"{correct.sum()} of them right{before}"
    )
    summary(
        f"they are from {confidence.probability[0]:.3f} to {confidence.probability[-1]:.3f}, and "
        f"on the drive they were learnt from off by {within.expected_calibration_error:.3f}"
    )
