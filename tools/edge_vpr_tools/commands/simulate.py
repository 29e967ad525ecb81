"""`edge-vpr simulate`: two drives of one route as recordings, with their ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edge_vpr.simulate import SimulatedRecording

HELP = "simulate two drives of one route, for trying out and teaching"
SENSORS = ("default", "tiny", "davis346", "speck")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "-o", "--output", metavar="DIR", required=True,
        help="folder to write: reference.npz, query.npz, and their tracks as .csv",
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace the folder if it exists")
    parser.add_argument(
        "--sensor", choices=SENSORS, default="default",
        help="camera: default and speck have 128 x 128 pixels, davis346 346 x 260, tiny 32 x 32",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=0, help="another seed, another world, camera and drives"
    )
    parser.add_argument(
        "--length", type=float, default=900.0, metavar="M", help="length of the route (900 m)"
    )
    parser.add_argument(
        "--speed-range", type=float, default=2.0, metavar="F",
        help="the query's speed wanders from 1/F to F times the reference's (2)",
    )  # fmt: skip
    parser.add_argument(
        "--stops", type=int, default=0, metavar="N", help="how often the query halts (0)"
    )


def run(args: argparse.Namespace) -> None:
    """Simulate both drives and write them.

    Raises
    ------
    UsageError
        If a value is out of range or the folder exists.
    """
    from dataclasses import asdict, replace

    from edge_vpr.recordings import write_recording
    from edge_vpr.simulate import QUERY, simulate_pair
    from edge_vpr_tools.output.progress import tracked
    from edge_vpr_tools.output.provenance import run_record, write_json
    from edge_vpr_tools.output.results import RUN, check_output_folder, results_folder

    output = Path(args.output)
    check_output_folder(output, args.overwrite)
    pair = simulate_pair(
        args.seed,
        args.sensor,
        length_m=args.length,
        query=replace(QUERY, speed_range=args.speed_range, stops=args.stops),
    )
    lines = []
    with results_folder(output, args.overwrite) as folder:
        for name, recording in zip(("reference", "query"), pair, strict=True):
            path = folder / f"{name}.npz"
            written = write_recording(
                path, tracked(recording, f"driving the {name}"), sensor=recording.sensor
            )
            write_track(folder / f"{name}_track.csv", recording)
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
    print("\n".join(lines))


def write_track(path: Path, recording: SimulatedRecording) -> None:
    """Write where the camera was as ``time_s,position_m``, which `edge-vpr evaluate` reads."""
    track = recording.track
    with path.open("w", encoding="utf-8") as file:
        file.write("time_s,position_m\n")
        for time_us, (position_m,) in zip(
            track.time_us.tolist(), track.position.tolist(), strict=True
        ):
            file.write(f"{time_us / 1e6:.6f},{position_m:.4f}\n")
