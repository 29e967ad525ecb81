"""Make the pictures of the README and of the pages, by the commands.

python tools/site/pictures.py [DATA], with edge-vpr on the path; Chromium draws the report. It
simulates, maps and matches in a temporary folder, and writes to `docs/images`:

- `brisbane.svg`, if DATA has `brisbane_sparse49`: live matches on a recorded route, from above;
- `pipeline.svg`: one window, from events to a match, with its numbers;
- `match.gif`: the film of `edge-vpr replay`;
- `report.png`: the beginning of the report of the live matches;
- `live.svg`: the view of `edge-vpr stream` while a bridge replays the query.
"""

from __future__ import annotations

import io
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
from edge_vpr_tools.commands.replay import RecordedInputs
from edge_vpr_tools.report.figures import total_counts
from edge_vpr_tools.report.replay import Replay, replay_of
from edge_vpr_tools.report.style import BLUE, GREY, ORANGE, panels, save
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.patches import ConnectionPatch
from rich.console import Console
from rich.style import Style
from rich.terminal_theme import SVG_EXPORT_THEME
from rich.text import Text

from edge_vpr.match_result import MatchResult
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.results import read_run
from tests.tools.terminals import Terminal

ROOT = Path(__file__).parents[2]

IMAGES = ROOT / "docs" / "images"
TRACKS = ("street/reference_track.csv", "street/query_track.csv")
TOLERANCE_M = 10
#: the paper's drives, here the first one on a map of the second
BRISBANE = ("sunset2", "sunset1")
#: share of the drive after which its window is shown
_SHOWN = 0.8
#: columns and rows, and how long the view is watched before it is drawn
_TERMINAL = (80, 7)
_WATCHED_S = 25
#: time that the bridge takes to listen, in seconds
_STARTING_S = 5.0
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
COMMANDS = (
    "edge-vpr simulate -o street",
    "edge-vpr map street/reference.npz -o map.npz --track street/reference_track.csv",
    "edge-vpr match map.npz street/query.npz -o results",
    "edge-vpr match map.npz street/query.npz -o live --online --every window --precision 0.99",
    f"edge-vpr evaluate live --ground-truth {' '.join(TRACKS)} --tolerance {TOLERANCE_M}",
    "edge-vpr replay live -o match.gif --all-events",
)


def main(folder: Path, data: Path | None) -> None:
    """Run the commands and write the pictures."""
    if data is not None:
        brisbane(data, folder, IMAGES / "brisbane.svg")
    for line in COMMANDS:
        subprocess.run(line.split(), cwd=folder, check=True)
    shutil.copy(folder / "match.gif", IMAGES / "match.gif")
    pipeline(folder, IMAGES / "pipeline.svg")
    screenshot(folder / "live" / "report.html", IMAGES / "report.png")
    live_view(folder, IMAGES / "live.svg")


def brisbane(data: Path, folder: Path, path: Path) -> None:
    """Draw the route of two recorded drives from above, with the live matches of the second."""
    drives = data / "brisbane_sparse49"
    logs = [str(drives / f"{name}.nmea") for name in BRISBANE]
    reference, query = (str(drives / f"{name}.npz") for name in BRISBANE)
    for command in (
        ["map", reference, "--frames-as-windows", "--track", logs[0], "-o", "brisbane.npz",
         "--pixels", "49"],
        ["match", "brisbane.npz", query, "--frames-as-windows", "--no-smooth",
         "--precision", "0.99", "-o", "brisbane"],
        ["evaluate", "brisbane", "--ground-truth", *logs, "--tolerance", "70"],
    ):  # fmt: skip
        subprocess.run(["edge-vpr", *command], cwd=folder, check=True)
    shutil.copy(folder / "brisbane" / "route.svg", path)


def pipeline(folder: Path, path: Path) -> None:
    """Draw one window of the demo's drives, from its events to its match."""
    replay = read_replay(folder)
    i = int(len(replay) * _SHOWN)
    reference, matches = replay.reference, replay.outcome.matches
    place, pixels = int(matches.place[i]), reference.pixel_map
    code = reference.settings.contrast_code
    assert code is not None
    assert replay.images is not None
    along_m = reference.along_mm
    assert along_m is not None
    along = along_m / 1e3
    with panels(1, 5, 13.0, 2.7) as (drawing, (row,)):
        drawing.get_layout_engine().set(wspace=0.16)  # type: ignore[union-attr]
        events, seen, codes, distance, cost = row
        show_events(events, replay.images[i])
        events.set_title(f"{replay.queries.events[i]:,} events in 1 s")
        counts = total_counts(reference, replay.queries)[i]
        seen.scatter(pixels.x, pixels.y, s=60 * np.minimum(counts / np.percentile(counts, 95), 1),
                     color=BLUE, linewidths=0)  # fmt: skip
        seen.scatter(pixels.x, pixels.y, s=2, color=GREY, linewidths=0)
        sensor = pixels.sensor
        frame(seen, sensor.width, sensor.height)
        seen.set_title(f"{len(pixels)} of {sensor.pixels:,} pixels")
        columns = 10
        grid = np.full(-(-len(pixels) // columns) * columns, np.nan)
        grid[: len(pixels)] = replay.queries.counts[i]
        codes.imshow(grid.reshape(-1, columns), cmap="Blues", vmin=0, vmax=2**code.bits - 1,
                     interpolation="nearest")  # fmt: skip
        frame(codes)
        codes.set_title(
            f"counts as {code.bits}-bit codes:\n{reference.packed_bytes_per_place} bytes per place"
        )
        index = ReferenceIndex(reference.places.counts)
        distances = index.matrix(replay.queries.counts[i : i + 1])[:, 0]
        for axes, values in ((distance, distances), (cost, replay.cost[:, i])):
            axes.plot(along, values, color=BLUE, lw=1.2)
            axes.scatter([along[place]], [values[place]], s=50, color=ORANGE, zorder=3)
            axes.set(xlabel="distance (m)", yticks=[])
        distance.set_title(f"distance to each\nof {len(reference)} places")
        cost.set_title(f"cost by the place filter:\nplace {place}, at {along[place]:.0f} m")
        for before, after in pairwise(row):
            drawing.add_artist(
                ConnectionPatch(
                    (1.02, 0.5), (-0.04, 0.5), coordsA="axes fraction", coordsB="axes fraction",
                    axesA=before, axesB=after, arrowstyle="-|>", color=GREY, mutation_scale=14,
                )
            )  # fmt: skip
        for axes in row:
            axes.title.set_fontsize(10)
    save(drawing, path)


def read_replay(folder: Path) -> Replay:
    """Read the smoothed matches, with the events of all pixels."""
    results = folder / "results"
    inputs = RecordedInputs(results, read_run(results))
    matched = MatchResult.load(results)
    recording = inputs.recording("a picture", matched.reference.camera)
    return replay_of(matched, recording, inputs.odometry(), 10_000, all_events=True)


def show_events(axes: Axes, image: np.ndarray) -> None:
    """Draw the number of events of each pixel."""
    most = 2.5 * float(np.percentile(image[image > 0], 95))
    axes.imshow(image, cmap="Greys", norm=PowerNorm(0.5, 0, most))
    frame(axes)


def frame(axes: Axes, width: int = 0, height: int = 0) -> None:
    """Leave only the frame of a picture."""
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set(visible=True, color=GREY)
    if width:
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        axes.set_aspect("equal")


def screenshot(page: Path, path: Path) -> None:
    """Write the beginning of a page as a picture."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        sys.exit("no Chromium is installed, which the picture of the report needs")
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(
            [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             "--window-size=760,1310", f"--user-data-dir={profile}", f"--screenshot={path}",
             page.absolute().as_uri()],
            check=True, stderr=subprocess.DEVNULL,
        )  # fmt: skip


def live_view(folder: Path, path: Path) -> None:
    """Write what `edge-vpr stream` shows in a terminal, some time into the query drive."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    query = ["edge-vpr", "bridge", "street/query.npz", "--start", "60", "--port", address]
    view = ["edge-vpr", "stream", "--port", address, "--protocol", "evpr", "--map", "map.npz"]
    with subprocess.Popen(query, cwd=folder, stdout=subprocess.DEVNULL) as bridge:
        time.sleep(_STARTING_S)  # the view would tell that nobody listens
        terminal = Terminal([*view, "--every", "50ms"], folder, _TERMINAL)
        try:
            terminal.wait_for("% of the route")
            time.sleep(_WATCHED_S)
            screen = terminal.coloured()
        finally:
            terminal.end(signal.SIGINT)
            bridge.terminate()
    console = Console(width=_TERMINAL[0], record=True, file=io.StringIO())
    for line in screen:
        text = Text()
        for letter, colour, bold in line:
            name = {"default": "default", "brown": "yellow", "brightblack": "bright_black"}.get(
                colour, f"#{colour}" if len(colour) == 6 and colour.isalnum() else colour
            )
            text.append(letter, Style(color=name, bold=bold))
        console.print(text, end="\n")
    drawn = console.export_svg(title="edge-vpr stream", theme=SVG_EXPORT_THEME)
    # without the fonts that it would load from the network
    path.write_text(re.sub(r"@font-face \{.*?\}", "", drawn, flags=re.DOTALL), encoding="utf-8")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        main(Path(name), Path(sys.argv[1]).absolute() if len(sys.argv) > 1 else None)
