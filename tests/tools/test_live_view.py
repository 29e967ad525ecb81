"""The live view in a real pseudo-terminal: notices, what is stale, sizes, and a clean end."""

from __future__ import annotations

import json
import signal
import sys
import threading
from contextlib import contextmanager

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
    """A device on a virtual line."""

    def __init__(self):
        self.link = open_device_link("virtual")
        self._encoder = open_encoder("evpr", SENSOR)
        self._rng = np.random.default_rng(1)
        self._now = 0

    @contextmanager
    def sending(self):
        """Send events all the time, so that a machine that stood still sees some again."""
        over = threading.Event()

        def send():
            while not over.wait(0.1):
                events = random_events(self._rng, 4_000, SENSOR, 100_000)
                events.t += self._now
                self._now += 100_000
                send_all(self.link, self._encoder.encode(events))

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


def stream(folder, port, map_file, *words, size=(100, 30)):
    words = ["--port", port, "--protocol", "evpr", "--map", map_file, *words]
    words += ["--max-lag", "60s"]
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
    with camera.sending():
        # the disk was full at the first bytes; brown is a terminal's yellow
        full_disk = " ends early: No space left on device"
        run.wait_for("place ", "latency", brown=full_disk, default="of 29 (")
        # narrower: what is shown goes on
        for size in ((60, 24), (34, 30), (90, 12)):
            run.resize(*size)
            run.wait_for("events/s", "place ")
        run.resize(100, 30)
    # nothing comes: the place is of the past, and for how long is said
    lost = r"lost, last at place \d+ of 29 \("
    run.wait_for(
        r"nothing came for \d+ s", lost, brown="no bytes for 1 s from", brightblack="of 29 ("
    )
    with camera.sending():
        run.wait_for(without="nothing came", default="of 29 (")
    # the cable is pulled
    camera.link.close()
    port.unlink()
    run.wait_for(
        "the link is lost for", lost, without="no faults", brown="trying again",
        brightblack="of 29 (",
    )  # fmt: skip
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
    run.wait_for(brown="are not of this protocol")
    assert run.end(signal.SIGINT)[0] == 1


def test_a_terminal_that_is_closed_ends_a_run_with_its_files_whole(map_file, tmp_path):
    camera, log = Camera(), tmp_path / "run.jsonl"
    run = stream(tmp_path, camera.link.address, map_file, "--log", log)
    greeted(camera.link)
    with camera.sending():
        run.wait_for("of 29 ")
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
