"""`edge-vpr experiment`: compute the figures that the documentation quotes."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr_tools.experiments import EXPERIMENTS, SOURCES
from edge_vpr_tools.output.progress import status
from edge_vpr_tools.report.formats import read_formats


def run(args: argparse.Namespace) -> None:
    """Run one experiment and print its table as Markdown.

    Raises
    ------
    EdgeVprError
        If the data is not there.
    """
    if args.seeds < 1:
        raise UsageError(f"{args.seeds} seeds: expected 1 or more")
    module = import_module(f"edge_vpr_tools.experiments.{EXPERIMENTS[args.name]}")
    folder = getattr(module, "FOLDER", None)
    data = None if args.data is None else Path(args.data)
    if args.figure is not None and not hasattr(module, "draw"):
        raise UsageError(f"experiment {args.name} draws no figure: leave --figure out")
    if args.figures is not None and args.figure is None:
        raise UsageError("--figures says how to write the figure of --figure: name a file there")
    if args.table is not None and args.name != "calibration":
        raise UsageError(f"experiment {args.name} writes no table: leave --table out")
    if folder is not None and (data is None or not (data / folder).is_dir()):
        raise UsageError(
            f"experiment {args.name} reads the folder {folder}, {SOURCES[folder]}, which is not in "
            f"{args.data or 'any folder given'}: name the folder that holds it with --data"
        )
    with status("starting") as show:
        more = [] if args.figure is None else _figure_files(Path(args.figure), args.figures)
        more += [] if args.table is None else [Path(args.table)]
        table = module.run(data, args.seeds, show, *more)
    print(table)


def _figure_files(named: Path, formats: str | None) -> list[Path]:
    """Return the given file, or one with its stem for each format."""
    if formats is None:
        return [named]
    return [named.with_suffix(f".{kind}") for kind in read_formats(formats)]
