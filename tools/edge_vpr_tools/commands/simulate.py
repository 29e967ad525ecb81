"""`edge-vpr simulate`: write simulated recordings of two drives, with ground truth."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path

from edge_vpr_tools.console import summary, with_progress
from edge_vpr_tools.flags import add_output_flags

SENSORS = ("default", "tiny", "davis346", "speck")
EXAMPLES = """\
  edge-vpr simulate -o street
  edge-vpr simulate -o short --length 200 --sensor tiny --seed 3 --stops 2"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_output_flags(
        parser,
        help="folder to write the recordings reference.npz and query.npz to, each with its track "
        "and its wheel odometry as .csv",
    )
    drives = parser.add_argument_group("the two drives")
    drives.add_argument(
        "--sensor", choices=SENSORS, default="default",
        help="camera: default and speck have 128 x 128 pixels, davis346 346 x 260, tiny 32 x 32 "
        "(default: %(default)s)",
    )  # fmt: skip
    drives.add_argument(
        "--seed", type=int, default=0, help="seed of the street, the camera and the drives"
    )
    drives.add_argument(
        "--length", type=float, default=900.0, metavar="M", help="length of the route in metres"
    )
    drives.add_argument(
        "--speed", type=float, default=6.0, metavar="MPS",
        help="typical speed of both drives in metres per second",
    )  # fmt: skip
    drives.add_argument(
        "--speed-range", type=float, default=2.0, metavar="F",
        help="the speed of the query varies between 1/F and F times that of the reference",
    )  # fmt: skip
    drives.add_argument(
        "--stops", type=int, default=0, metavar="N", help="number of stops of the query"
    )


_WHEEL = 51  # random stream of the odometer


def run(args: argparse.Namespace) -> None:
    """Simulate both drives and write them."""
    import numpy as np

    from edge_vpr.evaluation.tables import save_odometry
    from edge_vpr.evaluation.track_files import save_track
    from edge_vpr.recordings import write_recording
    from edge_vpr.records import write_json
    from edge_vpr.results import RUN, check_output_folder, results_folder, run_record
    from edge_vpr.simulation import QUERY, REFERENCE, simulate_pair
    from edge_vpr.simulation.drive import wheel_odometry

    output = Path(args.output)
    check_output_folder(output, args.overwrite)
    pair = simulate_pair(
        args.seed,
        args.sensor,
        length_m=args.length,
        reference=replace(REFERENCE, speed_mps=args.speed),
        query=replace(QUERY, speed_mps=args.speed, speed_range=args.speed_range, stops=args.stops),
    )
    lines = []
    with results_folder(output, args.overwrite) as folder:
        for name, recording in zip(("reference", "query"), pair, strict=True):
            path = folder / f"{name}.npz"
            written = write_recording(
                path, with_progress(recording, f"driving the {name}"), sensor=recording.sensor
            )
            save_track(folder / f"{name}_track.csv", recording.track)
            wheel = wheel_odometry(recording.track, np.random.default_rng((recording.seed, _WHEEL)))
            save_odometry(folder / f"{name}_odometry.csv", wheel)
            seconds = recording.duration_us / 1e6
            lines.append(
                f"{output / path.name}: {written:,} events of {recording.sensor} over "
                f"{args.length:g} m in {seconds:.1f} s; ground truth in {name}_track.csv"
            )
        settings = {
            name: {
                "world": asdict(recording.world),
                "camera": asdict(recording.camera),
                "drive": asdict(recording.drive),
                "seed": recording.seed,
                "device": recording.device,
            }
            for name, recording in zip(("reference", "query"), pair, strict=True)
        }
        write_json(folder / RUN, run_record(settings, ()))
    for line in lines:
        summary(line)
