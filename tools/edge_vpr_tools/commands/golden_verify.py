"""`edge-vpr golden verify`: check vectors, and compare the results of a device with them."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr_tools.console import note, number_of, status, summary

if TYPE_CHECKING:
    from firmware_model.vectors import Returned
    from firmware_model.vectors.manifest import Manifest

EXAMPLES = """\
  edge-vpr golden verify vectors
  edge-vpr golden verify vectors --results device.csv --only match
  edge-vpr golden verify vectors --port /dev/ttyACM0"""
#: between two lines of progress where there is no terminal
_PROGRESS_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("vectors", metavar="VECTORS", help="folder that edge-vpr golden wrote")
    group = parser.add_argument_group("results of a device")
    one = group.add_mutually_exclusive_group()
    one.add_argument(
        "--results", metavar="FILE",
        help="results of the device: .csv with a record per line, or .bin with records of 32-bit "
        "words (default: check the vectors only)",
    )  # fmt: skip
    one.add_argument(
        "--port", metavar="PORT",
        help="serial port of a board that runs the reference firmware's vpr_replay_line: send it "
        "the cases that fit its memory, compare its results, and count the other cases",
    )  # fmt: skip
    group.add_argument(
        "--baud", type=int, default=115_200, metavar="N", help="bits per second of the port"
    )
    group.add_argument(
        "--timeout", type=float, default=60.0, metavar="SECONDS",
        help="give up a board that neither sends nor accepts a byte for so long",
    )  # fmt: skip
    group.add_argument(
        "--case", metavar="SUITE/NAME",
        help="case that results without a `case` record belong to; with --port, the only one to "
        "run",
    )  # fmt: skip
    group.add_argument(
        "--only", metavar="KINDS", default="event,window,match",
        help="kinds of result that the device returns, separated by commas",
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Verify vectors, and the results of a device if they are given."""
    from firmware_model.vectors import Returned, check_files, load_manifest, read_results, verify
    from firmware_model.vectors.verify import COMPARED

    folder = Path(args.vectors)
    files = check_files(folder)
    source = args.results or args.port
    if source is None:
        summary(f"{folder}: {files} files are as they were made")
        return
    kinds = tuple(args.only.split(","))
    if not set(kinds) <= set(COMPARED):
        raise UsageError(f"--only {args.only}: choose from {', '.join(COMPARED)}")
    returned = _from_board(args, folder) if args.port else Returned(read_results(args.results))
    if returned.too_large and not returned.records:
        raise EdgeVprError(f"{source}: no case was run: {_too_large(returned)}")
    verdict = verify(folder, returned.records, case=args.case, kinds=kinds)
    compared = ", ".join(f"{number} of {kind}" for kind, number in verdict.compared.items())
    if verdict.differences:
        for difference in verdict.differences[1:]:
            summary(difference)
        raise EdgeVprError(
            f"{source}: {len(verdict.differences)} of {verdict.cases} cases differ from the "
            f"vectors in {folder}, first in {verdict.differences[0]}"
        )
    if verdict.missing and args.case is None and args.port is None:
        raise EdgeVprError(
            f"{source}: {verdict.cases} of {verdict.total} cases are equal, and "
            f"{len(verdict.missing)} were not verified, such as {verdict.missing[0]}: return "
            "them too, or name the only one with --case"
        )
    summary(f"{source}: {verdict.cases} of {verdict.total} cases, equal records: {compared}")
    if verdict.cases == verdict.total:
        _tell_what_is_not_shown(load_manifest(folder))
    if returned.too_large:
        note(_too_large(returned))


def _tell_what_is_not_shown(manifest: Manifest) -> None:
    """Say how much of each suite these vectors have: a device may be equal, and wrong elsewhere."""
    from edge_vpr_tools.golden_vectors import aimed_facts

    for suite in manifest.suites:
        aimed = aimed_facts(suite, manifest.design)
        if not all(aimed.values()):
            shown = sum(map(bool, aimed.values()))
            note(
                f"{suite.name} shows {shown} of its {len(aimed)} facts, and no fault in the others"
            )
    if not any(suite.name == "own" for suite in manifest.suites):
        note("these vectors lack the suite own, without which many faults are not found")


def _too_large(returned: Returned) -> str:
    name, size = min(returned.too_large.items(), key=lambda one: one[1])
    return (
        f"{number_of(len(returned.too_large), 'case')} of more memory than the board has: the "
        f"smallest, {name}, needs {size:,} bytes"
    )


def _in_lines(show: Callable[[str], None]) -> Callable[[str], None]:
    """Also print a line every `_PROGRESS_S` if standard error is no terminal."""
    if sys.stderr.isatty():
        return show
    last = time.monotonic()

    def shown(text: str) -> None:
        nonlocal last
        if time.monotonic() - last >= _PROGRESS_S:
            last = time.monotonic()
            note(text)

    return shown


def _from_board(args: argparse.Namespace, folder: Path) -> Returned:
    """Run the cases on the board at the port."""
    if not args.timeout > 0:
        raise UsageError(f"--timeout {args.timeout:g}: expected seconds above 0")
    import serial

    from firmware_model.vectors import run_on_board

    try:
        with (
            serial.serial_for_url(
                args.port, args.baud, timeout=args.timeout, write_timeout=args.timeout
            ) as line,
            status("cases on the board") as show,
        ):
            line.reset_input_buffer()
            return run_on_board(line, folder, args.case, _in_lines(show))
    except (serial.SerialException, OSError, ValueError) as error:
        raise EdgeVprError(
            f"cannot talk to a board at {args.port}: {error}: edge-vpr ports lists the ports"
        ) from error
