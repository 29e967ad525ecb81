"""`edge-vpr golden`: vectors that a device is held against, and the comparison of its results."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr_tools.reading import add_reading_arguments

if TYPE_CHECKING:
    from edge_vpr.settings import Settings
    from firmware_model import Design
    from firmware_model.vectors import Case

HELP = "write golden vectors for firmware and FPGA designs, or verify a device's results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "words",
        nargs="*",
        metavar="verify VECTORS",
        help="check the files of a folder of vectors, and the results of a device (--results)",
    )
    making = parser.add_argument_group("making vectors")
    making.add_argument("--design", metavar="FILE.toml", help="design of the device")
    making.add_argument("--map", metavar="MAP.npz", help="take the design and the places from it")
    making.add_argument(
        "--recording", metavar="QUERY", help="with --map, a drive for the suite `recording`"
    )
    making.add_argument(
        "--max-events",
        metavar="N",
        type=int,
        default=20_000,
        help="events of the recording to take, from its start (default: 20000)",
    )
    making.add_argument("--lanes", type=int, default=8, help="with --map, P (default: 8)")
    making.add_argument("--seed", type=int, default=0, help="of the random suite (default: 0)")
    making.add_argument("-o", "--output", metavar="DIR", help="folder to write")
    verifying = parser.add_argument_group("verifying")
    verifying.add_argument("--results", metavar="FILE", help="what the device returned")
    verifying.add_argument(
        "--case", metavar="SUITE/NAME", help="the case of results that name none"
    )
    verifying.add_argument(
        "--only",
        metavar="KINDS",
        default="event,window,match",
        help="what the device returns: some of event,window,match (default: all)",
    )
    add_reading_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write or verify vectors.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, or the results differ from the vectors.
    """
    from edge_vpr.errors import UsageError

    with _own_errors():
        if not args.words:
            _make(args)
        elif args.words[0] == "verify" and len(args.words) == 2:
            _verify(args, Path(args.words[1]))
        else:
            raise UsageError(
                f"golden {' '.join(args.words)}: expected `golden verify VECTORS`, or to make "
                "them, `golden --design FILE.toml -o DIR`"
            )


@contextmanager
def _own_errors() -> Iterator[None]:
    """Let errors of the firmware model be those of the command line."""
    from edge_vpr.errors import UsageError
    from firmware_model import DesignError, VectorError

    try:
        yield
    except (DesignError, VectorError) as error:
        raise UsageError(str(error)) from error


def _make(args: argparse.Namespace) -> None:
    from edge_vpr.errors import UsageError
    from edge_vpr_tools.results import results_folder
    from firmware_model import Design
    from firmware_model.vectors import standard_suites, write_suites

    if args.output is None or (args.design is None) == (args.map is None):
        raise UsageError("vectors are made of one of --design and --map, to the folder of --output")
    if args.recording is not None and args.map is None:
        raise UsageError("--recording needs a map: name it by --map")
    output = Path(args.output)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise UsageError(f"{output} is not an empty folder: name a new one")
    recorded: list[Case] = []
    if args.map is None:
        design = Design.load(args.design)
    else:
        design, recorded = _from_map(args)
    suites = standard_suites(design, args.seed)
    if recorded:
        suites["recording"] = recorded
    with results_folder(output, overwrite=True) as folder:
        manifest = write_suites(folder, design, suites, args.seed)
    for suite in manifest["suites"]:
        missed = [corner for corner, number in suite["coverage"].items() if number == 0]
        if suite["name"] == "corners" and missed:
            print(f"no corner case of this design reaches: {', '.join(missed)}")
    for suite in manifest["suites"]:
        events, windows, matches = (
            sum(case[what] for case in suite["cases"]) for what in ("events", "windows", "matches")
        )
        reached = sum(number > 0 for number in suite["coverage"].values())
        print(
            f"{args.output}/{suite['name']}: {len(suite['cases'])} cases, {events:,} events, "
            f"{windows} windows, {matches} matches, {reached} of {len(suite['coverage'])} corners"
        )


def _from_map(args: argparse.Namespace) -> tuple[Design, list[Case]]:
    """Design of a map, and the case of its recording, if one is given."""
    import numpy as np

    from edge_vpr.descriptors.windows import narrow
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.estimate.of_map import design_of, device_codes
    from firmware_model import Event, Memories
    from firmware_model.vectors import Case

    reference = ReferenceMap.load(args.map)
    design = design_of(reference, args.lanes)
    if args.recording is None:
        return design, []
    codes, places = device_codes(reference), reference.places.counts
    if reference.codes is None:
        places = narrow(codes.encode(places))
    pixels = np.stack([reference.pixel_map.x, reference.pixel_map.y], axis=1).tolist()
    memories = Memories(design, pixels, places.tolist(), codes.row.tolist())
    clock = 1 << design.timestamp_bits
    events = [Event(t % clock, x, y, bool(p)) for t, x, y, p in _events(args, reference.settings)]
    return design, [Case("drive", memories, tuple(events))]


def _events(args: argparse.Namespace, settings: Settings) -> list[tuple[int, int, int, bool]]:
    """First events of the recording, cleaned as for the pipeline."""
    from edge_vpr.pipeline import cleaned
    from edge_vpr_tools.reading import open_from

    taken: list[tuple[int, int, int, bool]] = []
    for chunk in cleaned(open_from(args, args.recording), settings):
        taken += chunk[: args.max_events - len(taken)].tolist()
        if len(taken) >= args.max_events:
            break
    return taken


def _verify(args: argparse.Namespace, folder: Path) -> None:
    from edge_vpr.errors import EdgeVprError, UsageError
    from firmware_model.vectors import check_files, read_results, verify
    from firmware_model.vectors.verify import COMPARED

    files = check_files(folder)
    if args.results is None:
        print(f"{folder}: {files} files are as they were made")
        return
    kinds = tuple(args.only.split(","))
    if not set(kinds) <= set(COMPARED):
        raise UsageError(f"--only {args.only}: choose from {', '.join(COMPARED)}")
    verdict = verify(folder, read_results(args.results), case=args.case, kinds=kinds)
    compared = ", ".join(f"{number} of {kind}" for kind, number in verdict.compared.items())
    if verdict.differences:
        print("\n".join(verdict.differences))
        raise EdgeVprError(
            f"{args.results}: {len(verdict.differences)} of {verdict.cases} cases differ from the "
            f"vectors in {folder}; the first difference of each is above"
        )
    print(f"{args.results}: {verdict.cases} of {verdict.known} cases, equal records: {compared}")
