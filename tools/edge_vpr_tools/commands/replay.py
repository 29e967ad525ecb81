"""`edge-vpr replay`: show a match as a film."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import MapError, UsageError
from edge_vpr_tools.console import summary

EXAMPLES = """\
  edge-vpr replay tuesday -o match.gif
  edge-vpr replay tuesday -o match.html --frames 600
  edge-vpr replay tuesday -o match.gif --all-events --start 20 --end 60"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "results", metavar="RESULTS", help="folder that edge-vpr match or demo wrote"
    )
    output = parser.add_argument_group("output")
    output.add_argument(
        "-o", "--output", metavar="FILE", required=True,
        help="film to write: an animated picture (.gif), or a page with a slider (.html)",
    )  # fmt: skip
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    output.add_argument(
        "--frames", type=int, default=150, metavar="N",
        help="largest number of frames; with more windows, some are left out, evenly",
    )  # fmt: skip
    output.add_argument("--fps", type=float, default=10.0, help="frames per second")
    shown = parser.add_argument_group("what is shown")
    shown.add_argument(
        "--start",
        type=float,
        metavar="S",
        help="first second of the query to show (default: the beginning)",
    )
    shown.add_argument(
        "--end", type=float, metavar="S", help="last second of the query to show (default: the end)"
    )
    shown.add_argument(
        "--all-events", action="store_true",
        help="show the events of all pixels behind the selected ones; needs the recording of the "
        "query, where run.json says it is",
    )  # fmt: skip


_SUFFIXES = (".gif", ".html")


def run(args: argparse.Namespace) -> None:
    """Compute the costs again, draw the frames and write the film."""
    from edge_vpr.files import read_json
    from edge_vpr.results import RUN, check_new_file
    from edge_vpr_tools.inputs import RecordedInputs
    from edge_vpr_tools.progress import status
    from edge_vpr_tools.report.replay import frames, load_replay, write_gif, write_html

    output = Path(args.output)
    if output.suffix not in _SUFFIXES:
        raise UsageError(
            f"output {output} does not end in {' or '.join(_SUFFIXES)}: name it for example "
            "match.gif"
        )
    if args.frames < 1:
        raise UsageError(f"--frames {args.frames}: expected 1 or more")
    if not 0.1 <= args.fps <= 50:
        raise UsageError(f"--fps {args.fps:g}: expected 0.1 to 50 frames per second")
    check_new_file(output, [], args.overwrite)
    folder = Path(args.results)
    if not folder.is_dir():
        raise MapError(f"{folder} is not a folder of results: run edge-vpr match first")
    with status("reading the matches") as show:
        replay = load_replay(
            folder,
            RecordedInputs(read_json(folder / RUN, "the run", "match again")),
            args.frames,
            start_s=args.start,
            end_s=args.end,
            all_events=args.all_events,
        )
        pictures = []
        for picture in frames(replay):
            pictures.append(picture)
            show(f"frame {len(pictures)} of {len(replay)}")
        if output.suffix == ".gif":
            write_gif(output, pictures, args.fps)
        else:
            write_html(output, pictures, replay.captions(), args.fps)
    size = output.stat().st_size / 1e6
    summary(f"{output}: {len(pictures)} frames, {len(pictures) / args.fps:.0f} s, {size:.1f} MB")
