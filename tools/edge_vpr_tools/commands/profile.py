"""`edge-vpr profile`: measure what a match takes on this machine."""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr_tools.arguments.profile_load import load_of
from edge_vpr_tools.energy import profiling, show
from edge_vpr_tools.energy.intervals import LEAST_PAIRS
from edge_vpr_tools.energy.measurement import LEAST_S, Plan
from edge_vpr_tools.energy.sensors.search import choose_sensor
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import is_quiet, summary
from edge_vpr_tools.output.provenance import write_json

_LEAST_QUICK_S = 0.1


def run(args: argparse.Namespace) -> None:
    """Profile this machine.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, or a sensor fails.
    """
    if (args.map is None) != (args.recording is None):
        raise UsageError("--map and --recording belong together: name both, or neither")
    if args.ground_truth is not None and args.map is None:
        raise UsageError("--ground-truth is of a recording: name --map and --recording too")
    if args.meter and args.meter_port is not None:
        raise UsageError("--meter is for a CSV that comes later, --meter-port for now: name one")
    least_s = _LEAST_QUICK_S if args.quick else LEAST_S
    window_s = args.window_s
    if window_s is None:
        window_s = 1.0 if args.quick else LEAST_S
    if not (args.mission_rate > 0 and window_s >= least_s and args.pairs >= LEAST_PAIRS):
        raise UsageError(
            f"{args.pairs} pairs of {window_s:g} s at {args.mission_rate:g} matches a second: "
            f"expected {LEAST_PAIRS} pairs or more, {least_s:g} s or more (shorter: --quick), and "
            "a positive rate"
        )
    output = Path(args.output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    inputs = [args.map, args.recording, *(args.ground_truth or ())]
    results.check_output_folder(output, args.overwrite, inputs)
    plan = Plan(args.pairs, window_s, args.quick)
    with terminated_as_interrupted():
        found = _profile(args, plan)
        _write(args, output, found)
    if not is_quiet():
        show.table(found)
    summary(f"see {output / (profiling.PROFILE if args.no_figures else results.REPORT)}")


def _profile(args: argparse.Namespace, plan: Plan) -> dict[str, Any]:
    request = profiling.Request(
        every=args.every,
        packet=args.packet,
        mission_rate=args.mission_rate,
        designs=not args.no_designs,
        meter=args.meter,
        root=Path(args.sysroot),
    )
    sensor, missing = choose_sensor(
        request.root,
        name=args.sensor_name,
        meter_port=args.meter_port,
        shunt_mohm=args.shunt_mohm,
    )
    try:
        return profiling.profile(load_of(args), request, plan, sensor, missing)
    finally:
        if sensor is not None:
            sensor.close()


def _write(args: argparse.Namespace, output: Path, found: dict[str, Any]) -> None:

    with results.results_folder(output, args.overwrite) as folder:
        write_json(folder / profiling.PROFILE, found)
        write_json(folder / results.RUN, found["run"])
        show.write_csv(found, folder / "profile.csv")
        if not args.no_figures:
            show.write_report(found, folder)


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, so that nothing half written is left."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
