"""`edge-vpr experiment`: compute the figures that the documentation quotes."""

from __future__ import annotations

import argparse
import inspect
from pathlib import Path
from types import ModuleType
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import summary
from edge_vpr_tools.research.experiments import EXPERIMENTS, SOURCES, STREETS_ONLY

EXAMPLES = """\
  edge-vpr experiment simulated
  edge-vpr experiment codes --data recordings --figure codes.png
  edge-vpr experiment rivals frames --data recordings --report paper.html
  edge-vpr experiment rivals --with model:netvlad.onnx@1,2,4"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "names", nargs="+", metavar="NAME", choices=(*EXPERIMENTS, "all"),
        help=f"experiments: {', '.join(EXPERIMENTS)}, or all",
    )  # fmt: skip
    group = parser.add_argument_group("experiment")
    group.add_argument(
        "--data",
        metavar="DIR",
        help="folder of recorded drives: Brisbane-Event-VPR or QCR-Event-VPR under their published "
        f"names, or others (docs/datasets.md); {', '.join(STREETS_ONLY)} read none, since all of "
        "their drives are simulated",
    )
    group.add_argument("--figure", metavar="FILE", help="also draw the figure of the experiment")
    group.add_argument(
        "--figures",
        metavar="FORMATS",
        help="with --figure, formats of the figure: png, pdf, svg, or several separated by commas "
        "(default: by the suffix of FILE)",
    )
    group.add_argument(
        "--report", metavar="FILE", help="also write tables and figures to one page of HTML"
    )
    group.add_argument(
        "--with",
        dest="baselines",
        action="append",
        default=[],
        metavar="SYSTEM",
        help="compare this system too (rivals, frames): lens:FILE.pth, model:FILE.onnx, "
        "NAME@1,2,4 for an ensemble of windows, NAME+NAME of systems; repeatable",
    )
    group.add_argument(
        "--table", metavar="DIR",
        help="folder to write the tables of probabilities to (calibration only)",
    )  # fmt: skip
    group.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="number of trials with different seeds"
    )


def run(args: argparse.Namespace) -> None:
    """Run experiments and print their tables as Markdown."""
    from importlib import import_module

    from edge_vpr.results import check_parent
    from edge_vpr_tools.progress import status
    from edge_vpr_tools.report.experiment_page import ExperimentPage
    from edge_vpr_tools.research.experiments.drives import check_logs

    if args.seeds < 1:
        raise UsageError(f"{args.seeds} seeds: expected 1 or more")
    if args.figures is not None and args.figure is None:
        raise UsageError("--figures says how to write the figure of --figure: name a file there")
    names = list(EXPERIMENTS) if "all" in args.names else list(dict.fromkeys(args.names))
    if len(names) > 1 and args.figure is not None:
        raise UsageError(
            f"--figure names one file, and {len(names)} experiments were named: use --report"
        )
    data = None if args.data is None else Path(args.data)
    if data is not None and not data.is_dir():
        raise UsageError(f"--data {data} is not a folder: name the one that holds the recordings")
    if data is not None and set(names) <= set(STREETS_ONLY):
        others = ", ".join(dict.fromkeys(STREETS_ONLY[name] for name in names))
        raise UsageError(
            f"{', '.join(names)} drives simulated streets only and reads no --data: leave it out, "
            f"or compare recorded drives by {others}"
        )
    modules = {
        name: import_module(f"edge_vpr_tools.research.experiments.{EXPERIMENTS[name]}")
        for name in names
    }
    for name, module in modules.items():  # before hours of work
        _check(name, module, args, data)
    if data is not None:
        check_logs(data)
    for written in (args.figure, args.report, args.table and Path(args.table, "tables")):
        if written is not None:
            check_parent(Path(written))
    page = None if args.report is None else ExperimentPage(args.seeds)
    for name, module in modules.items():
        more: dict[str, Any] = {"baselines": args.baselines} if args.baselines else {}
        if args.table is not None:
            more["table"] = Path(args.table)
        files = [] if args.figure is None else _figure_files(Path(args.figure), args.figures)
        with status("starting") as show:
            if page is None:
                table = module.run(data, args.seeds, show, *files, **more)
            else:
                with page.figures() as kept:
                    table = module.run(data, args.seeds, show, *files, kept, **more)
                    page.add(name, _summary(module), table)
        for line in (f"{name}:\n\n{table}\n" if len(names) > 1 else table).split("\n"):
            summary(line)
        if page is not None:  # what is done is kept, if a later one fails
            page.write(Path(args.report))


def _check(name: str, module: ModuleType, args: argparse.Namespace, data: Path | None) -> None:
    """Refuse what the experiment has not got."""
    folder = getattr(module, "FOLDER", None)
    if args.table is not None and "table" not in inspect.signature(module.run).parameters:
        raise UsageError(f"experiment {name} writes no table: leave --table out")
    if args.baselines and "baselines" not in inspect.signature(module.run).parameters:
        raise UsageError(f"experiment {name} compares no systems: leave --with out")
    if hasattr(module, "check_data"):
        module.check_data(data)
    if folder is not None and (data is None or not (data / folder).is_dir()):
        raise UsageError(
            f"experiment {name} reads the folder {folder}, {SOURCES[folder]}, which is not in "
            f"{args.data or 'any folder given'}: name the folder that holds it with --data"
        )


def _summary(module: ModuleType) -> str:
    """Return the first line of a module's docstring."""
    return (module.__doc__ or "").strip().split("\n")[0]


def _figure_files(named: Path, formats: str | None) -> list[Path]:
    """Return the given file, or one with its stem for each format."""
    from edge_vpr_tools.report.formats import read_formats

    if formats is None:
        return [named]
    return [named.with_suffix(f".{kind}") for kind in read_formats(formats)]
