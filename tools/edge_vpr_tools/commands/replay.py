"""`edge-vpr replay`: show the matches of a drive as a film."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import UsageError
from edge_vpr_tools.cli import VerbParser, find_verb
from edge_vpr_tools.console import note, status, summary
from edge_vpr_tools.flags import add_output_flags, open_source

if TYPE_CHECKING:
    from edge_vpr.descriptors.published import PublishedWindows
    from edge_vpr.odometry import Odometry
    from edge_vpr.recordings import Recording
    from edge_vpr.recordings.reading import Camera
    from edge_vpr.results import RunRecord
    from edge_vpr.simulation import SimulatedRecording
    from edge_vpr_tools.truth_files import TruthFiles

EXAMPLES = """\
  edge-vpr replay tuesday -o match.gif
  edge-vpr replay tuesday -o match.gif --frames 600
  edge-vpr replay tuesday -o match.gif --all-events --start 20 --end 60"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "results", metavar="RESULTS", help="folder that edge-vpr match or demo wrote"
    )
    output = add_output_flags(parser, "FILE.gif", "film to write, an animated GIF")
    output.add_argument(
        "--frames", type=int, default=150, metavar="N",
        help="largest number of frames; of more windows, replay leaves some out, evenly",
    )  # fmt: skip
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
        help="show the events of all pixels behind the selected ones; needs the query's recording "
        "at the path in run.json (replay simulates the demo's again)",
    )  # fmt: skip


# The inputs of an earlier `edge-vpr match`, opened again with the flags that it had.


class RecordedInputs:
    """The files that a run has read, by its `run.json`; each is opened when it is asked for.

    The demo has read none: it simulates its street, which is simulated once more.
    """

    def __init__(self, folder: Path, run: RunRecord) -> None:
        self._folder, self._run = folder, run
        self._verb, words = find_verb(list(run.command[1:]))
        self._args: argparse.Namespace | None = None
        if self._verb == "match":
            self._args = VerbParser("match").parse(words)

    def recording(
        self, what: str, camera: Camera
    ) -> Recording | PublishedWindows | SimulatedRecording:
        """Open the recording of the query.

        Parameters
        ----------
        what : str
            What needs it, for the message.
        camera : Camera
            Of the map.

        Raises
        ------
        UsageError
            If the run was not of `edge-vpr match`, or the recording has moved or changed.
        """
        if self._verb == "demo":
            from edge_vpr.simulation import simulate_pair

            return simulate_pair()[1]
        if self._args is None:
            raise UsageError(
                f"{what} needs the recording, which the record of this run does not name: replay "
                "results of edge-vpr match"
            )
        return open_source(self._args, self._unchanged(self._args.recording, what), camera)

    def odometry(self) -> Odometry | None:
        """Read the odometry of the query, from where it begins; None if the run had none.

        Raises
        ------
        UsageError
            If the file has moved or changed.
        """
        from edge_vpr.evaluation.tables import load_odometry

        if self._args is None or self._args.odometry is None:
            return None
        file = self._unchanged(self._args.odometry, "a match with --odometry")
        return load_odometry(file).since(self._run.start_us or 0)

    def _unchanged(self, path: str, what: str) -> Path:
        from edge_vpr.results import hash_input
        from edge_vpr_tools.truth_files import read_there

        remedy = "run edge-vpr replay in the folder where edge-vpr match ran, or match again"
        assert self._args is not None
        file = read_there(self._folder, self._args.output, path)
        if not file.exists():
            raise UsageError(f"{path}, which {what} needs, is not there: {remedy}")
        for record in self._run.inputs:
            if record.path == path and replace(hash_input(file), path=path) != record:
                raise UsageError(
                    f"{path}, which {what} needs, has changed since it was matched: {remedy}"
                )
        return file


def _truth(folder: Path) -> TruthFiles | None:
    """Return the ground truth of the last evaluation; a note says if it cannot be used."""
    from edge_vpr_tools.truth_files import evaluated_truth

    try:
        return evaluated_truth(folder)
    except UsageError as error:
        note(f"the film is without the truth: {error}")
        return None


def run(args: argparse.Namespace) -> None:
    """Compute the costs again, draw the frames and write the film."""
    from edge_vpr.files import check_new_file
    from edge_vpr.match_result import MatchResult
    from edge_vpr.results import read_run
    from edge_vpr_tools.report.replay import FPS, frames, replay_of, write_gif

    output = Path(args.output)
    if output.suffix != ".gif":
        raise UsageError(f"output {output} does not end in .gif: name it for example match.gif")
    if args.frames < 1:
        raise UsageError(f"--frames {args.frames}: expected 1 or more")
    check_new_file(output, [], args.overwrite)
    folder = Path(args.results)
    with status("reading the matches") as show:
        result = MatchResult.load(folder)
        inputs = RecordedInputs(folder, read_run(folder))
        recording = None
        if args.all_events or result.queries is None:
            what = "the events of all pixels" if args.all_events else "a match --online"
            recording = inputs.recording(what, result.reference.camera)
        replay = replay_of(
            result,
            recording,
            inputs.odometry(),
            args.frames,
            start_s=args.start,
            end_s=args.end,
            all_events=args.all_events,
            truth=_truth(folder),
        )
        pictures = []
        for picture in frames(replay):
            pictures.append(picture)
            show(f"frame {len(pictures)} of {len(replay)}")
        write_gif(output, pictures)
    size = output.stat().st_size / 1e6
    summary(f"{output}: {len(pictures)} frames, {len(pictures) / FPS:.0f} s, {size:.1f} MB")
