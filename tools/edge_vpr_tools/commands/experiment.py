"""`edge-vpr experiment`: the figures that the documentation quotes, made anew."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "make the figures that the documentation quotes"
#: each is a module of `experiments` with run(data, seeds, on_start) -> Markdown
EXPERIMENTS = {
    "simulated": "simulated",
    "adaptive": "adaptive",
    "speck-walks": "speck_walks",
    "brisbane": "brisbane",
    "codes": "codes_frontier",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("name", choices=EXPERIMENTS, help="which experiment")
    parser.add_argument(
        "--data", metavar="DIR", help="folder of the real recordings (not needed for simulated)"
    )
    parser.add_argument("--figure", metavar="PNG", help="also draw the figure (codes only)")
    parser.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="trials with different seeds (5)"
    )


def run(args: argparse.Namespace) -> None:
    """Run one experiment and print its table as Markdown.

    Raises
    ------
    EdgeVprError
        If the data is not there.
    """
    from importlib import import_module

    from rich.console import Console

    from edge_vpr.errors import UsageError

    if args.seeds < 1:
        raise UsageError(f"{args.seeds} seeds: expected 1 or more")
    module = import_module(f"edge_vpr_tools.experiments.{EXPERIMENTS[args.name]}")
    folder = getattr(module, "FOLDER", None)
    data = None if args.data is None else Path(args.data)
    if args.figure is not None and args.name != "codes":
        raise UsageError(f"experiment {args.name} draws no figure: leave --figure out")
    if folder is not None and (data is None or not (data / folder).is_dir()):
        raise UsageError(
            f"experiment {args.name} reads the folder {folder}, which is not in "
            f"{args.data or 'any folder given'}: name the folder that holds it with --data"
        )
    with Console(stderr=True).status("starting") as status:
        more = () if args.figure is None else (Path(args.figure),)
        table = module.run(data, args.seeds, status.update, *more)
    print(table)
