"""`edge-vpr demo`: simulate, map, match and evaluate a street, in half a minute."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from shlex import quote

from edge_vpr_tools.console import say, status, table
from edge_vpr_tools.flags import add_output_flags

EXAMPLES = """\
  edge-vpr demo
  edge-vpr demo --seed 3 -o results/street3"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_output_flags(parser, help="folder for the report", required=False, default="results/demo")
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated street")


_WIDTH = 100


def run(args: argparse.Namespace) -> None:
    """Simulate, try every variant, print the table and write the report."""
    from edge_vpr import results
    from edge_vpr.results import run_record, write_json
    from edge_vpr.simulation import simulate_pair
    from edge_vpr_tools.inputs import tracked
    from edge_vpr_tools.report.demo_page import (
        HEADER,
        compare_latencies,
        remarks,
        rows,
        write_report,
    )
    from edge_vpr_tools.research.experiments import simulated
    from edge_vpr_tools.research.experiments.pairs import Pair
    from edge_vpr_tools.research.experiments.variants import VariantResult

    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    results.check_output_folder(output, args.overwrite)
    reference, query = simulate_pair(args.seed)
    reference.keep(partial(tracked, label="simulating the reference drive"))
    label = "simulating the query drive: other speed, other light, other traffic"
    query.keep(partial(tracked, label=label))
    pair, trials = Pair.simulated(reference, query), {}
    with status("mapping and matching") as show:
        for variant in simulated.VARIANTS:
            show(variant.name)
            trials[variant.name] = VariantResult.of(variant.of(pair, args.seed))
        show("matching event by event")
        tracks = reference.track, query.track
        latencies = compare_latencies(trials[simulated.DEFAULT], query, tracks)
        show("drawing the report")
        with results.results_folder(output, args.overwrite) as folder:
            metrics = {
                "variants": trials,
                "latency_median_s": {name: found.median_s for name, found in latencies.items()},
            }
            settings = pair.drawn_with(args.seed)
            write_json(folder / results.RUN, run_record(settings.to_dict(), []))
            write_json(folder / results.METRICS, metrics)
            write_report(folder, trials, latencies, reference.track)
    title = "One street, driven twice, the second time at half to double the speed"
    table(HEADER, rows(trials), title=title, width=_WIDTH)
    for line in remarks(trials, latencies):
        say(line, width=_WIDTH, markup=True)
    film = f"edge-vpr replay {quote(str(output))} -o match.gif"
    say(f"See {output / results.REPORT}; as a film: {film}", width=_WIDTH)
