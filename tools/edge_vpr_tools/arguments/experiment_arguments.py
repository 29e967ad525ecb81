"""Arguments of `edge-vpr experiment`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.experiments import EXPERIMENTS, STREETS_ONLY

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
