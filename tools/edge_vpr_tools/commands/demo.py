"""`edge-vpr demo`: simulate, map, match and evaluate a street, in a few seconds."""

from __future__ import annotations

import argparse
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import takewhile
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from edge_vpr_tools import cli
from edge_vpr_tools.console import say, status, table, with_progress
from edge_vpr_tools.flags import add_output_flags

if TYPE_CHECKING:
    from edge_vpr.settings import Preset

EXAMPLES = """\
  edge-vpr demo
  edge-vpr demo -o results/street"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_output_flags(
        parser, help="folder for matches and report", required=False, default="results/demo"
    )


#: largest distance of a correct match in metres, and widths of tables in characters
_TOLERANCE_M, _WIDTH = 10.0, 100
#: preset and changes by the name in the table; the matches of the first are written
_METHODS: dict[str, tuple[Preset, dict[str, Any]]] = {
    "place filter, live": ("default", {"smooth": False}),
    "place filter, whole drive (default)": ("default", {}),
    "paper, windows of a time": ("paper", {}),
    "paper, windows of a number of events": ("paper", {"window": "count"}),
}
#: files in the folder, reference first
_TRACKS = ("reference_track.csv", "query_track.csv")


def _evaluate(folder: Path) -> None:
    """Evaluate as a user would, so that `edge-vpr replay` finds the truth."""
    tracks = [str(folder / track) for track in _TRACKS]
    words = [str(folder), "--ground-truth", *tracks, "--tolerance", f"{_TOLERANCE_M:g}"]
    cli.run(["evaluate", *words, "--quiet"])


def run(args: argparse.Namespace) -> None:
    """Match the street as a user would, print a table and write the report."""
    from edge_vpr import results
    from edge_vpr.evaluation.track_files import save_track
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.simulation import simulate_pair
    from edge_vpr_tools.report.verdict import outcome_of

    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    results.check_output_folder(output, args.overwrite)
    first, second = simulate_pair()  # `replay` drives them once more
    # side by side, since most of the time is in kernels; an interrupt ends both
    stopped = threading.Event()
    with ThreadPoolExecutor(1) as beside:
        kept = beside.submit(first.keep, partial(takewhile, lambda _: not stopped.is_set()))
        label = "simulating two drives: other speed, other light, other traffic"
        try:
            second.keep(partial(with_progress, label=label))
            kept.result()
        except BaseException:
            stopped.set()
            raise
    rows, judged_results = [], []
    with status("mapping and matching") as show:
        for name, (preset, changes) in _METHODS.items():
            show(name)
            mapped = ReferenceMap.build(first, preset, track=first.track, **changes)
            result = mapped.match(second)
            judged = result.evaluate((first.track, second.track), _TOLERANCE_M)
            judged_results.append((result, judged))
            share, recall = judged.precision_at_100_recall, judged.recall_at_99_precision
            size = f"{result.reference.packed_bytes_per_window:,}"
            rows.append((name, f"{share:.3f}", f"{recall:.3f}", size))
        result, judged = judged_results[0]
        show("drawing the report")
        with results.results_folder(output, args.overwrite) as folder:
            result.write(folder, ())
            for track, drive in zip(_TRACKS, (first, second), strict=True):
                save_track(folder / track, drive.track)
        _evaluate(output)
    header = ("matched by", "P@100R", "R@99P", "bytes per window")
    table(header, rows, title="One street of 900 m, driven twice", width=_WIDTH)
    for line in (
        "The second drive goes at half to double the first one's speed, in another light.",
        "P@100R: share of correct matches when every window is matched; R@99P: recall at 99 % "
        f"precision, by a threshold that the truth chose; correct is within {_TOLERANCE_M:g} m.",
        outcome_of(result.reference, result.matches, judged).sentence,
        "One street of one seed; docs/results/simulated.csv has ten variants on five.",
        f"See {output / results.REPORT}; as a film: edge-vpr replay {quote(str(output))} "
        "-o match.gif",
    ):
        say(line, width=_WIDTH)
