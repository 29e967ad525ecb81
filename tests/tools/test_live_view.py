"""The live view in a real pseudo-terminal: notices, what is stale, sizes, and a clean end."""

from __future__ import annotations

import json
import signal
import sys

import numpy as np
import pytest
from edge_vpr_tools.live_view import View

from edge_vpr.events import Sensor
from edge_vpr.live.bridge import open_device_link
from edge_vpr.live.protocols import open_encoder
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from tests.live.devices import greeted, send_all
from tests.streams import Drive, random_events
from tests.tools.terminals import Terminal

pytestmark = pytest.mark.alone

SENSOR = Sensor(64, 48)
EVIL = "\x1b[2J\x1b]0;mine\x07[red]\u202ename"


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    """A map of 29 places."""
    path = tmp_path_factory.mktemp("view") / "map.npz"
    events = random_events(np.random.default_rng(0), 60_000, SENSOR, 3_000_000)
    settings = Settings(pixels=20, sigma=1.0, tau_us=100_000, sequence_length=2)
    ReferenceMap.build(Drive(events, SENSOR), settings).save(path)
    return path


class Camera:
    """A device on a virtual line that sends what it is asked to."""

    def __init__(self, port="virtual"):
        self.link = open_device_link(port)
        self._encoder = open_encoder("evpr", SENSOR)
        self._rng = np.random.default_rng(1)
        self._now = 0

    def send(self, seconds=0.5):
        """Send half a second of events, at once."""
        span = int(seconds * 1e6)
        events = random_events(self._rng, 20_000, SENSOR, span)
        events.t += self._now
        self._now += span
        send_all(self.link, self._encoder.encode(events))


def stream(folder, port, map_file, *words, size=(100, 30)):
    words = ["--port", port, "--protocol", "evpr", "--map", map_file, *words]
    program = [sys.executable, "-m", "edge_vpr_tools.cli", "stream", *map(str, words)]
    # names are short where it runs, so that a line holds them
    return Terminal(program, folder, size)


@pytest.mark.slow
def test_a_terminal_shows_the_place_its_age_and_every_notice_at_any_size(map_file, tmp_path):
    """One run: whole, narrower, silent, lost, and ended by a signal."""
    camera, full = Camera(), tmp_path / "full.bin"
    full.symlink_to("/dev/full")
    port = tmp_path / "camera"
    port.symlink_to(camera.link.address)
    run = stream(
        tmp_path, port.name, map_file, "--overwrite", "--record", full.name, "--every", "10ms"
    )
    greeted(camera.link)
    camera.send()
    shown = run.wait_for(lambda text: "place " in text and "of 29 (" in text and "latency" in text)
    # the disk was full at the first bytes
    assert any("ends early: No space left on device" in line for line in shown)
    assert run.colour_of(" ends early") == "brown"  # a terminal's yellow
    assert run.colour_of("of 29 (") == "default"
    # narrower: what is shown goes on
    for size in ((60, 24), (34, 30), (90, 12)):
        run.resize(*size)
        camera.send()
        run.wait_for(lambda text: "events/s" in text and "place " in text)
    # nothing comes: the place is of the past, and for how long is said
    run.resize(100, 30)
    run.wait_for(lambda text: "nothing came for 2 s" in text)
    run.wait_for(lambda text: "lost, last at place " in text)
    run.wait_for(lambda text: "no bytes for 1 s from" in text)
    assert run.colour_of("of 29 (") == "brightblack"
    assert run.colour_of("no bytes for 1 s") == "brown"
    camera.send()
    run.wait_for(lambda text: "nothing came" not in text)
    assert run.colour_of("of 29 (") == "default"
    # the cable is pulled
    camera.link.close()
    port.unlink()
    shown = run.wait_for(lambda text: "trying again" in text and "the link is lost for" in text)
    assert run.colour_of("trying again") == "brown"
    assert any("lost, last at place " in line and "of 29 (" in line for line in shown)
    assert run.colour_of("of 29 (") == "brightblack"
    assert not any("no faults" in line for line in shown)
    code, left = run.end(signal.SIGTERM)
    assert code == 1  # a file was given up
    for said in (
        "trying again",
        "the link was lost for",
        "no bytes for 1 s",
        "ends early",
        "events in",
        "health: ",
    ):
        assert said in left


def test_bytes_of_another_protocol_are_told_on_a_terminal(map_file, tmp_path):
    camera = Camera()
    run = stream(tmp_path, camera.link.address, map_file)
    greeted(camera.link)
    send_all(camera.link, np.random.default_rng(0).bytes(30_000))
    run.wait_for(lambda text: "are not of this protocol" in text)
    assert run.colour_of("are not of this") == "brown"
    assert run.end(signal.SIGINT)[0] == 1


def test_a_terminal_that_is_closed_ends_a_run_with_its_files_whole(map_file, tmp_path):
    camera, log = Camera(), tmp_path / "run.jsonl"
    run = stream(tmp_path, camera.link.address, map_file, "--log", log)
    greeted(camera.link)
    camera.send()
    run.wait_for(lambda text: "of 29 (" in text)
    run.hang_up()
    assert run.end()[0] == 0
    assert json.loads(log.read_text().splitlines()[-1])["kind"] == "summary"


def test_a_notice_is_text_and_no_mark_up(capsys):
    import io

    from edge_vpr_tools.live_view import Panel
    from rich.console import Console

    shown = io.StringIO()

    class Live:
        console = Console(file=shown)

        def update(self, renderable, *, refresh):
            Console(file=shown, width=80).print(renderable)

    panel = Panel(Live())
    view = View(False, None, None, panel)
    view.say("device", EVIL)
    panel.show({"place": "place [red]1"}, stale=False)
    assert "\\x1b[2J\\x1b]0;mine\\x07[red]\\u202ename" in shown.getvalue()
    assert "place [red]1" in shown.getvalue()
    assert "\x1b" not in shown.getvalue()
    View(False, None, None, None).say("device", EVIL)
    assert capsys.readouterr().out.rstrip("\n").isprintable()
