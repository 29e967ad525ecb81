"""Arguments of `edge-vpr estimate`."""

from __future__ import annotations

import argparse

#: events a second of a street seen by a DAVIS346, about; stated with every estimate
EVENTS_PER_S = 1e5
PLACES = 1_000
#: defaults of the flags that make a design; a map or a file has its own
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
    design = parser.add_argument_group("design", "of a map, of a file, or of these flags")
    design.add_argument("--map", metavar="MAP.npz", help="take design and event rates from a map")
    design.add_argument("--design", metavar="FILE.toml", help="design of a device")
    design.add_argument("--sensor", metavar="WxH", help=f"size of the sensor {_default('sensor')}")
    design.add_argument(
        "--pixels", type=int, metavar="J", help=f"number of selected pixels {_default('pixels')}"
    )
    design.add_argument(
        "--places",
        type=int,
        metavar="K",
        help=f"number of places (default: of the route, the map, or {PLACES})",
    )
    design.add_argument(
        "--sequence-length",
        "-L",
        type=int,
        metavar="L",
        help="windows in a sequence (default: 5)",
    )
    design.add_argument(
        "--matching", metavar="KIND", help=f"sequence or filter {_default('matching')}"
    )
    design.add_argument(
        "--counter-code",
        metavar="KIND",
        help=f"linear, sqrt, log or own-mean {_default('counter_code')}",
    )
    design.add_argument(
        "--counter-bits", type=int, metavar="B", help=f"bits of a code {_default('counter_bits')}"
    )
    design.add_argument(
        "--polarity", action="store_true", default=None, help="count ON and OFF apart"
    )
    design.add_argument("--tau", metavar="TIME", help=f"length of a window {_default('tau')}")
    design.add_argument(
        "--window-events", type=int, metavar="N",
        help="windows of so many events at the selected pixels instead of a time (default: none)",
    )  # fmt: skip
    design.add_argument(
        "--lanes", type=int, metavar="P", default=8, help="parallel lanes of an FPGA"
    )
    mission = parser.add_argument_group("mission")
    mission.add_argument(
        "--event-rate",
        type=float,
        metavar="N",
        help=f"events a second of the sensor (default: the map's, or {EVENTS_PER_S:g})",
    )
    mission.add_argument(
        "--selected-share", type=float, metavar="S",
        help="of them at selected pixels (default: as of any J pixels)",
    )  # fmt: skip
    mission.add_argument(
        "--match-rate", type=float, metavar="N", help="matches a second (default: one a window)"
    )
    mission.add_argument(
        "--every", metavar="WHEN", default="window",
        help="when to match, as of edge-vpr match: window, event, a number of events, 100ms",
    )  # fmt: skip
    mission.add_argument(
        "--route-km",
        type=float,
        metavar="KM",
        help="length of the route in kilometres, in place of --places",
    )
    mission.add_argument(
        "--places-per-metre",
        type=float,
        metavar="N",
        default=0.1,
        help="places on a metre of the route",
    )
    asked = parser.add_argument_group("answers")
    asked.add_argument(
        "--target", action="append", metavar="NAME",
        help="a target, or a TOML file of your own; may be repeated (default: all)",
    )  # fmt: skip
    asked.add_argument(
        "--vs", metavar="DESIGN", help="compare with all-pixels, or with the design in a TOML file"
    )
    asked.add_argument(
        "--fit", action="append", metavar="LIMIT", default=[],
        help="what fits 64KiB, or 10mW: the largest J, K and bits of one --target; may be repeated",
    )  # fmt: skip
    asked.add_argument(
        "--calibrate", metavar="PROFILE.json", help="energy of a cycle from your board's profile"
    )
    asked.add_argument(
        "--pareto", metavar="DIR",
        help="accuracy of the evaluated runs below DIR against energy and bytes, drawn",
    )  # fmt: skip
    asked.add_argument(
        "--accuracy-on", nargs="+", metavar="DRIVE",
        help="try designs on two drives now: REFERENCE QUERY with --ground-truth, or `simulated`",
    )  # fmt: skip
    asked.add_argument("--ground-truth", nargs="+", metavar="FILE", help="as of edge-vpr evaluate")
    asked.add_argument("--tolerance", type=float, metavar="T", help="as of edge-vpr evaluate")
    asked.add_argument(
        "--figure", metavar="FILE.png",
        help="where accuracy against cost is drawn (DIR/pareto.png); needs one --target",
    )  # fmt: skip
    asked.add_argument(
        "--sources", action="store_true",
        help="print what is assumed, and the source of each constant",
    )  # fmt: skip
    asked.add_argument("--json", metavar="FILE", help="write everything as JSON too")
