"""`edge-vpr profile`: measure the cost of a match on this machine."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr_tools.arguments.profile_load import load_of
from edge_vpr_tools.energy.measurement import Plan
from edge_vpr_tools.energy.profile_files import write_profile
from edge_vpr_tools.energy.profile_record import PROFILE, Profile
from edge_vpr_tools.energy.profiling import Request, profile
from edge_vpr_tools.energy.sensors.search import choose_sensor
from edge_vpr_tools.energy.show import show
from edge_vpr_tools.output import results
from edge_vpr_tools.output.interrupt import check_interrupted, terminated_as_interrupted
from edge_vpr_tools.output.messages import is_quiet, summary
from edge_vpr_tools.output.provenance import write_json


def run(args: argparse.Namespace) -> None:
    """Profile this machine."""
    if (args.map is None) != (args.recording is None):
        raise UsageError("--map and --recording belong together: name both, or neither")
    if args.ground_truth is not None and args.map is None:
        raise UsageError("--ground-truth needs a recording: give --map and --recording too")
    if args.meter and args.meter_port is not None:
        raise UsageError("--meter reads a file later and --meter-port a meter now: give only one")
    plan = Plan.checked(args.pairs, args.window_s, args.quick)
    request = Request(
        every=args.every,
        packet=args.packet,
        mission_rate=args.mission_rate,
        designs=not args.no_designs,
        meter=args.meter,
        root=Path(args.sysroot),
    )
    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    inputs = [args.map, args.recording, *(args.ground_truth or ())]
    results.check_output_folder(output, args.overwrite, inputs)
    with terminated_as_interrupted():
        found = _profile(args, request, plan)
        check_interrupted()
        with results.results_folder(output, args.overwrite) as folder:
            write_json(folder / results.RUN, found.run)
            write_profile(found, folder, report=not args.no_figures)
    if not is_quiet():
        show(found)
    summary(f"see {output / (PROFILE if args.no_figures else results.REPORT)}")


def _profile(args: argparse.Namespace, request: Request, plan: Plan) -> Profile:
    sensor, missing = choose_sensor(
        request.root, name=args.sensor_name, meter_port=args.meter_port, shunt_mohm=args.shunt_mohm
    )
    try:
        return profile(load_of(args), request, plan, sensor, missing)
    finally:
        if sensor is not None:
            sensor.close()
