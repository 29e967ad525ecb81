"""`edge-vpr golden verify`: check vectors, and compare the results of a device with them."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr_tools.console import summary

EXAMPLES = """\
  edge-vpr golden verify vectors
  edge-vpr golden verify vectors --results device.csv --only match"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("vectors", metavar="VECTORS", help="folder that edge-vpr golden wrote")
    group = parser.add_argument_group("results of a device")
    group.add_argument(
        "--results", metavar="FILE",
        help="results of the device: .csv with a record per line, or .bin with records of 32-bit "
        "words (default: check the vectors only)",
    )  # fmt: skip
    group.add_argument(
        "--case", metavar="SUITE/NAME", help="case that results without a `case` record belong to"
    )
    group.add_argument(
        "--only", metavar="KINDS", default="event,window,match",
        help="kinds of result that the device returns, separated by commas",
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Verify vectors, and the results of a device if they are given."""
    from firmware_model.vectors import check_files, read_results, verify
    from firmware_model.vectors.verify import COMPARED

    folder = Path(args.vectors)
    files = check_files(folder)
    if args.results is None:
        summary(f"{folder}: {files} files are as they were made")
        return
    kinds = tuple(args.only.split(","))
    if not set(kinds) <= set(COMPARED):
        raise UsageError(f"--only {args.only}: choose from {', '.join(COMPARED)}")
    verdict = verify(folder, read_results(args.results), case=args.case, kinds=kinds)
    compared = ", ".join(f"{number} of {kind}" for kind, number in verdict.compared.items())
    if verdict.differences:
        for difference in verdict.differences:
            summary(difference)
        raise EdgeVprError(
            f"{args.results}: {len(verdict.differences)} of {verdict.cases} cases differ from the "
            f"vectors in {folder}, first in {verdict.differences[0]}"
        )
    if verdict.missing and args.case is None:
        raise EdgeVprError(
            f"{args.results}: {verdict.cases} of {verdict.known} cases are equal, and "
            f"{len(verdict.missing)} were not verified, such as {verdict.missing[0]}: return "
            "them too, or name the only one with --case"
        )
    summary(f"{args.results}: {verdict.cases} of {verdict.known} cases, equal records: {compared}")
