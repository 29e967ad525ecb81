"""`edge-vpr profile`: measure the cost of a match on this machine."""

from __future__ import annotations

import argparse
import signal
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import handled, summary, with_progress
from edge_vpr_tools.flags import add_json_flag, add_output_flags

if TYPE_CHECKING:
    from edge_vpr_tools.profile.workload import Workload


EXAMPLES = """\
  edge-vpr profile --quick
  edge-vpr profile --map monday.npz --recording tuesday.raw -o results/board
  edge-vpr profile compare results/board/profile.json results/laptop/profile.json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    output = add_output_flags(parser, required=False, default="results/profile")
    add_json_flag(output, "profile.json")
    load = parser.add_argument_group("load", "a simulated street, or a map and a recording")
    load.add_argument("--map", metavar="MAP.npz", help="reference map from edge-vpr map")
    load.add_argument("--recording", metavar="QUERY", help="recording of the query drive")
    how = parser.add_argument_group("measuring")
    how.add_argument(
        "--pairs", type=int, default=5, metavar="N",
        help="number of pairs of an idle and a loaded period",
    )  # fmt: skip
    how.add_argument(
        "--window-s", type=float, metavar="S",
        help="length of each period in seconds (default: 10, or 1 with --quick)",
    )  # fmt: skip
    how.add_argument(
        "--quick", action="store_true",
        help="allow periods shorter than 10 s, and mark the result as quick",
    )  # fmt: skip
    sensor = parser.add_argument_group("power sensor")
    sensor.add_argument(
        "--sensor-name", metavar="NAME",
        help="power sensor to use, of those that edge-vpr doctor lists (default: the first)",
    )  # fmt: skip
    sensor.add_argument(
        "--shunt-mohm", type=float, metavar="R",
        help="resistance of the power monitor's shunt in milliohms, if its driver assumes another "
        "(default: the driver's)",
    )  # fmt: skip
    sensor.add_argument(
        "--meter", action="store_true",
        help="measure with an external meter, whose recording edge-vpr profile trace reads",
    )  # fmt: skip


# The work to be measured, as the flags of `edge-vpr profile` describe it.


#: length of the simulated street, which has about 70 places
STREET_M = 400.0


def _workload_of(args: argparse.Namespace) -> Workload:
    """Open the map and the recording that the flags name, or simulate a street."""
    from edge_vpr.descriptors.counting import check_sensor, cleaned
    from edge_vpr.recordings import open_recording
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.simulation import simulate_pair
    from edge_vpr_tools.profile.workload import Workload

    if args.map is None:
        first, query = simulate_pair(0, length_m=STREET_M)
        first.keep(partial(with_progress, label="simulating the reference"))
        query.keep(partial(with_progress, label="simulating the query"))
        reference = ReferenceMap.build(first)
        events = list(cleaned(query, reference.settings))
        return Workload(f"simulated street of {STREET_M:g} m", reference, events, [])
    reference = ReferenceMap.load(args.map)
    recording = open_recording(args.recording, default=reference.camera)
    check_sensor(recording.sensor, reference.pixel_map.sensor)
    events = list(cleaned(recording, reference.settings))
    return Workload(args.recording, reference, events, [args.map, args.recording])


def run(args: argparse.Namespace) -> None:
    """Profile this machine."""
    from edge_vpr import results
    from edge_vpr.records import json_text, write_json
    from edge_vpr_tools.profile.measurement import Plan
    from edge_vpr_tools.profile.profiling import profile
    from edge_vpr_tools.profile.sensors.search import choose_sensor
    from edge_vpr_tools.profile.sensors.sensor import ROOT
    from edge_vpr_tools.profile.show import show, write_profile

    if (args.map is None) != (args.recording is None):
        raise UsageError("--map and --recording belong together: name both, or neither")
    plan = Plan.checked(args.pairs, args.window_s, args.quick)
    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    results.check_output_folder(output, args.overwrite, [args.map, args.recording])
    # SIGTERM ends it as Ctrl-C does, so that no incomplete file is left
    with handled([signal.SIGTERM], signal.default_int_handler):
        sensor, missing = choose_sensor(ROOT, name=args.sensor_name, shunt_mohm=args.shunt_mohm)
        try:
            measured = profile(
                _workload_of(args), plan, sensor, missing, meter=args.meter, root=ROOT
            )
        finally:
            if sensor is not None:
                sensor.close()
        with results.results_folder(output, args.overwrite) as folder:
            write_json(folder / results.RUN, measured.run)
            write_profile(measured, folder)
    if args.json:
        print(json_text(measured))
    show(measured)
    summary(f"see {output / results.REPORT}")
