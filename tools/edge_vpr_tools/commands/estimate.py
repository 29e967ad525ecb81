"""`edge-vpr estimate`: estimate the cost of a design before it is built."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.arguments.estimate_request import question_of
from edge_vpr_tools.estimate.estimation import Question, estimate
from edge_vpr_tools.estimate.pareto import draw
from edge_vpr_tools.estimate.show import show
from edge_vpr_tools.output.provenance import write_json
from edge_vpr_tools.output.results import check_parent
from edge_vpr_tools.output.tables import say
from edge_vpr_tools.report.style import save


def run(args: argparse.Namespace) -> None:
    """Count, model, and print."""
    question = question_of(args)
    figure = _figure(args, question)
    for written in (figure, args.json and Path(args.json)):
        if written is not None:
            check_parent(written)
    found = estimate(question)
    show(found, with_sources=args.sources)
    if figure is not None and question.alone is not None and found.answers is not None:
        save(draw(found.answers.candidates[question.alone.name], question.alone), figure)
        say(f"drawn: {figure}")
    if args.json is not None:
        write_json(Path(args.json), found)


def _figure(args: argparse.Namespace, question: Question) -> Path | None:
    """Return the file for the figure of accuracy against cost; None without a figure."""
    if args.figure is not None:
        return Path(args.figure)
    alone = args.pareto is not None and question.alone is not None
    return Path(args.pareto) / "pareto.png" if alone else None
