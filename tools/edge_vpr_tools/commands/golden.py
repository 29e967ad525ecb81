"""`edge-vpr golden`: write golden vectors, with which devices are tested."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import note, number_of, status, summary
from edge_vpr_tools.flags import add_design_flags, add_output_flags

if TYPE_CHECKING:
    from firmware_model import Design
    from firmware_model.vectors import Case


EXAMPLES = """\
  edge-vpr golden --design design.toml -o vectors
  edge-vpr golden --map monday.npz --recording tuesday.raw -o vectors
  edge-vpr golden verify vectors --results device.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_design_flags(parser)
    vectors = parser.add_argument_group("vectors")
    vectors.add_argument(
        "--recording", metavar="QUERY",
        help="with --map, also write vectors of a recorded drive, as suite `recording`",
    )  # fmt: skip
    vectors.add_argument(
        "--max-windows", metavar="N", type=int, default=20,
        help="number of windows to take from the start of the recording",
    )  # fmt: skip
    vectors.add_argument(
        "--vectors", metavar="SIZE", default="all",
        help="size of the folder, about, such as 20MB: golden leaves out cases, but shows as "
        "many facts as possible",
    )  # fmt: skip
    vectors.add_argument(
        "--suite",
        action="append",
        choices=("corners", "random", "filter", "own", "recording"),
        default=[],
        help="make this suite only; may be repeated (default: all)",
    )
    vectors.add_argument("--seed", type=int, default=0, help="seed of the random vectors")
    vectors.add_argument(
        "--rtl", action="store_true",
        help="also write the hardware core, its parameters for each case, and a testbench",
    )  # fmt: skip
    add_output_flags(parser)


def run(args: argparse.Namespace) -> None:
    """Make vectors and write them."""
    from edge_vpr.files import check_output, replacing_folder
    from edge_vpr.recordings import open_recording
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.estimate.of_map import design_of
    from edge_vpr_tools.golden_vectors import (
        aimed_facts,
        check_vectors_folder,
        recorded_case,
        vectors_size,
    )
    from firmware_model import Design
    from firmware_model.vectors import (
        FLASH_BYTES,
        FLASHED,
        cases_within,
        estimated_bytes,
        write_suites,
    )

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
            recording = open_recording(args.recording, default=reference.camera)
            with status("windows of the recording"):
                recorded = [recorded_case(reference, design, recording, args.max_windows)]
    with replacing_folder(output, args.overwrite) as folder, status("cases") as show_case:
        suites = _suites(args, design, recorded)
        made = {name: cases for name, cases in suites.items() if name != "recording"}
        show_case("which cases to keep")
        chosen = cases_within(made, vectors_size(args.vectors))
        if "recording" in suites:
            chosen["recording"] = suites["recording"]
        manifest = write_suites(folder, design, chosen, args.seed, rtl=args.rtl, on_case=show_case)
    left_out = {
        name: number for name, cases in made.items()
        if (number := len(cases) - len(chosen.get(name, [])))
    }  # fmt: skip
    if left_out:
        each = ", ".join(
            f"{number} of {len(made[name])} of {name}" for name, number in left_out.items()
        )
        size = sum(estimated_bytes(case) for cases in made.values() for case in cases)
        note(
            f"--vectors {args.vectors} leaves cases out: {each}; "
            f"--vectors {math.ceil(size / 1e6)}MB keeps all"
        )
    for case in (suite.cases[0] for suite in manifest.suites if suite.name == "recording"):
        if case.windows < args.max_windows:
            note(
                f"the recording's case has {case.windows} of --max-windows {args.max_windows}: the "
                "drive is shorter"
            )
        if "image.bin" in case.files and "case.h" not in case.files:
            size = sum(case.files[name].bytes for name in FLASHED)
            note(
                f"the recording's case has no case.h: its image takes "
                f"{case.files['image.bin'].bytes:,} bytes, with events and records {size:,}, and "
                f"the flash of the example {FLASH_BYTES:,}: give fewer --max-windows, or a smaller "
                "map"
            )
    for suite in manifest.suites:
        missed = [fact for fact, number in aimed_facts(suite, design).items() if number == 0]
        if missed:
            cases = "case that is left" if left_out else "case of this design"
            note(f"{suite.name}: no {cases} shows these facts: {', '.join(missed)}")
    for suite in manifest.suites:
        events, windows, matches = (
            sum(getattr(case, what) for case in suite.cases)
            for what in ("events", "windows", "matches")
        )
        aimed = aimed_facts(suite, design)
        reached = f", {sum(map(bool, aimed.values()))} of its {len(aimed)} facts" if aimed else ""
        of = f"{len(suite.cases)} of " if left_out.get(suite.name) else ""
        every = len(made.get(suite.name, suite.cases))
        held = ((every, "case"), (events, "event"), (windows, "window"))
        numbers = [number_of(*one) for one in (*held, (matches, "match"))]
        summary(f"{Path(args.output) / suite.name}: {of}{', '.join(numbers)}{reached}")


def _suites(
    args: argparse.Namespace, design: Design, recorded: list[Case]
) -> dict[str, list[Case]]:
    """Make the suites that are wanted, by default all."""
    from firmware_model.vectors import standard_suites

    if not args.suite:
        suites = standard_suites(design, args.seed)
        return suites | {"recording": recorded} if recorded else suites
    suites = {}
    for name in args.suite:
        made = {name: recorded} if name == "recording" else standard_suites(design, args.seed, name)
        if not made:
            raise UsageError(
                f"--suite {name}: this design has neither place filter nor contrast codes"
            )
        suites |= made
    return suites
