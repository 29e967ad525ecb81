"""Arguments of `edge-vpr estimate`."""

from __future__ import annotations

import argparse

#: rough number of events per second of a DAVIS346 on a street; printed with every estimate
EVENTS_PER_S = 1e5
PLACES = 1_000
#: defaults of the flags that make a design; not used with --map or --design
DESIGN_FLAGS = {
    "sensor": "346x260",
    "pixels": 150,
    "matching": "sequence",
    "sequence_length": 0,
    "counter_code": "log",
    "counter_bits": 4,
    "polarity": False,
    "tau": "1s",
    "window_events": None,
}
EXAMPLES = """\
  edge-vpr estimate --pixels 83 --places 2000 --target cortex-m4
  edge-vpr estimate --map monday.npz --vs all-pixels
  edge-vpr estimate --target cortex-m0plus --fit 20KiB --fit 5mW"""


def _default(name: str) -> str:
    return f"(default: {DESIGN_FLAGS[name]})"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    design = parser.add_argument_group("design", "given by a map, by a file, or by the other flags")
    design.add_argument("--map", metavar="MAP.npz", help="take design and event rates from a map")
    design.add_argument("--design", metavar="FILE.toml", help="read the design from a file")
    design.add_argument("--sensor", metavar="WxH", help=f"size of the sensor {_default('sensor')}")
    design.add_argument(
        "--pixels", type=int, metavar="J", help=f"number of selected pixels {_default('pixels')}"
    )
    design.add_argument(
        "--places", type=int, metavar="K",
        help=f"number of places (default: that of the route or of the map, else {PLACES})",
    )  # fmt: skip
    design.add_argument(
        "--sequence-length", "-L", type=int, metavar="L", help="windows in a sequence (default: 5)"
    )
    design.add_argument(
        "--matching", metavar="KIND", help=f"method: sequence or filter {_default('matching')}"
    )
    design.add_argument(
        "--counter-code", metavar="KIND",
        help=f"code of the counters: linear, sqrt, log or own-mean {_default('counter_code')}",
    )  # fmt: skip
    design.add_argument(
        "--counter-bits", type=int, metavar="B", help=f"bits per code {_default('counter_bits')}"
    )
    design.add_argument(
        "--polarity", action="store_true", default=None, help="count ON and OFF events separately"
    )
    design.add_argument("--tau", metavar="TIME", help=f"length of a window {_default('tau')}")
    design.add_argument(
        "--window-events", type=int, metavar="N",
        help="number of events at the selected pixels in a window, instead of a fixed time "
        "(default: none)",
    )  # fmt: skip
    design.add_argument(
        "--lanes", type=int, metavar="P", default=8, help="parallel lanes of an FPGA"
    )
    mission = parser.add_argument_group("mission")
    mission.add_argument(
        "--event-rate", type=float, metavar="N",
        help=f"events per second of the sensor (default: the map's, or {EVENTS_PER_S:g})",
    )  # fmt: skip
    mission.add_argument(
        "--selected-share", type=float, metavar="S",
        help="share of these events at the selected pixels, 0 to 1 (default: the map's, or their "
        "share of all pixels)",
    )  # fmt: skip
    mission.add_argument(
        "--match-rate", type=float, metavar="N",
        help="matches per second (default: one in each window)",
    )  # fmt: skip
    mission.add_argument(
        "--every", metavar="WHEN", default="window",
        help="when to match, as in edge-vpr match: window, event, a number of events, or a time "
        "such as 100ms",
    )  # fmt: skip
    mission.add_argument(
        "--route-km", type=float, metavar="KM",
        help="length of the route in kilometres, in place of --places",
    )  # fmt: skip
    mission.add_argument(
        "--places-per-metre", type=float, metavar="N", default=0.1,
        help="number of places per metre of the route",
    )  # fmt: skip
    asked = parser.add_argument_group("answers")
    asked.add_argument(
        "--target", action="append", metavar="NAME",
        help="processor or FPGA to estimate for, or a TOML file that describes one; may be "
        "repeated (default: all)",
    )  # fmt: skip
    asked.add_argument(
        "--vs", metavar="DESIGN", help="compare with all-pixels, or with the design in a TOML file"
    )
    asked.add_argument(
        "--fit", action="append", metavar="LIMIT", default=[],
        help="find the largest J, K and bits that stay below a limit, such as 64KiB or 10mW; needs "
        "one --target; may be repeated",
    )  # fmt: skip
    asked.add_argument(
        "--calibrate", metavar="PROFILE.json",
        help="take the energy per clock cycle from a profile of your board",
    )  # fmt: skip
    asked.add_argument(
        "--pareto", metavar="DIR",
        help="draw the accuracy of all evaluated runs below DIR against energy and bytes",
    )  # fmt: skip
    asked.add_argument(
        "--accuracy-on", nargs="+", metavar="DRIVE",
        help="run designs on two drives and evaluate them: REFERENCE QUERY together with "
        "--ground-truth, or `simulated`",
    )  # fmt: skip
    asked.add_argument(
        "--ground-truth", nargs="+", metavar="FILE", help="same as in edge-vpr evaluate"
    )
    asked.add_argument("--tolerance", type=float, metavar="T", help="same as in edge-vpr evaluate")
    asked.add_argument(
        "--figure", metavar="FILE.png",
        help="file for the figure of accuracy against cost (default: DIR/pareto.png); needs one "
        "--target",
    )  # fmt: skip
    asked.add_argument(
        "--sources", action="store_true",
        help="print all assumptions, and the source of each constant",
    )  # fmt: skip
    asked.add_argument("--json", metavar="FILE", help="also write all results as JSON")
