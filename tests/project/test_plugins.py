"""Parts of other packages: the examples of docs/recipes.md, and packages that fail."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from lab.baselines import baseline_names, compare, open_baseline

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from tests.live.devices import sent_by
from tests.streams import Drive, random_events, read_events

_, PAGE = (Path(__file__).parents[2] / "docs/recipes.md").read_text().split("## Add your own parts")
SENSOR = Sensor(24, 20)
GROUPS = {
    "edge_vpr.formats": "broken = my_broken",
    "edge_vpr.baselines": "broken = my_broken:Baseline",
    "edge_vpr.protocols": "broken = my_broken",
}


def install(folder, monkeypatch, entries, **modules):
    """Install a package of modules for this test, without pip."""
    info = folder / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "\n".join(f"[{group}]\n{names}" for group, names in entries.items())
    )
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(folder)


@pytest.fixture
def as_the_page_says(tmp_path_factory, monkeypatch):
    """The package of docs/recipes.md, word for word."""
    (toml,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    baseline, pairs, protocol = re.findall(r"```python[^\n]*\n(.*?)```", PAGE, re.DOTALL)
    declared = tomllib.loads(toml)["project"]["entry-points"]
    entries = {
        group: "\n".join(f"{name} = {value}" for name, value in names.items())
        for group, names in declared.items()
    }
    folder = tmp_path_factory.mktemp("package")
    install(folder, monkeypatch, entries, my_parts=baseline, my_pairs=pairs, my_protocol=protocol)


@pytest.fixture
def drive():
    rng = np.random.default_rng(1)
    return Drive(random_events(rng, 20_000, SENSOR, 9_000_000), SENSOR)


@pytest.mark.usefixtures("as_the_page_says")
def test_a_baseline_of_another_package_is_compared():
    rng = np.random.default_rng(1)
    images = rng.poisson(rng.gamma(0.6, 6.0, (12, 30, 40))).astype(np.uint16)
    assert baseline_names()[-1] == "columns"
    for name in ("columns", "columns@1,2", "strategy:random"):
        compared = compare(open_baseline(name, 3), images, images)
        assert compared.distances.argmin(axis=0).tolist() == list(range(12))


def test_a_baseline_that_is_no_callable_is_left_out_and_named(tmp_path, monkeypatch, capsys):
    install(tmp_path, monkeypatch, {"edge_vpr.baselines": "module = my_module"}, my_module="")
    assert "module" not in baseline_names()
    assert "baseline 'module' is a module: expected a callable" in capsys.readouterr().err


@pytest.mark.usefixtures("as_the_page_says")
def test_a_format_of_another_package_is_read_by_its_suffix_or_name(tmp_path, run):
    rows = np.array([(5, 1, 2), (9, 3, 4)], [("t", "<i8"), ("x", "<u2"), ("y", "<u2")])
    for name in ("a.pairs", "a.bin"):
        rows.tofile(tmp_path / name)
    events = read_events(tmp_path / "a.pairs", sensor=SENSOR)
    assert events["t"].tolist() == [0, 4] and events["x"].tolist() == [1, 3]
    named = open_recording(tmp_path / "a.bin", sensor=SENSOR, format="pairs")
    assert np.array_equal(join_events(list(named)), events)
    shown = run("info", tmp_path / "a.pairs", "--sensor", "24x20").out
    assert "pairs (pairs of time and pixel)" in shown
    (tmp_path / "short.pairs").write_bytes(rows.tobytes()[:-1])
    with pytest.raises(RecordingError, match="11 bytes too many or too few at its end"):
        list(open_recording(tmp_path / "short.pairs", sensor=SENSOR))
    with pytest.raises(UsageError, match="cannot be written"):
        write_recording(tmp_path / "b.pairs", events, sensor=SENSOR)
    with pytest.raises(UsageError, match=r"format 'pears' is unknown: .*, pairs"):
        open_recording(tmp_path / "a.bin", sensor=SENSOR, format="pears")
    with pytest.raises(RecordingError, match="no known format"):
        open_recording(tmp_path / "a.bin", sensor=SENSOR)


TALLY = """
SUFFIXES = (".tally",)

class open_sink:
    def __init__(self, path, sensor, start_us):
        self._path, self._events = path, 0

    def write(self, events):
        self._events += len(events)

    def close(self):
        self._path.write_text(f"{self._events} events")
"""


def test_a_stream_is_recorded_into_a_format_of_another_package(drive, tmp_path, monkeypatch, run):
    install(tmp_path, monkeypatch, {"edge_vpr.formats": "tally = my_tally"}, my_tally=TALLY)
    sent = tmp_path / "sent.bin"
    sent.write_bytes(sent_by(drive, SENSOR))
    words = ["stream", "--port", sent, "--protocol", "evpr", "--sensor", "24x20"]
    run(*words, "--record", tmp_path / "a.tally")
    assert (tmp_path / "a.tally").read_text() == "20000 events"


@pytest.mark.usefixtures("as_the_page_says")
def test_a_protocol_of_another_package_is_decoded_and_imitated(drive):
    events = join_events(list(drive))
    encoder, decoder = open_encoder("mine", SENSOR), open_decoder("mine", SENSOR)
    sent = bytearray(encoder.encode(events))
    assert sent.startswith(b"%d %d %d %d\n" % events.tolist()[0])
    fault = sent.index(b"\n", 5_000) + 1
    sent[fault : fault + 1] = b"?"
    parts = [decoder.feed(bytes(sent[at : at + 997])) for at in range(0, len(sent), 997)]
    decoded = np.concatenate([*parts, decoder.finish()])
    lost = bytes(sent[:fault]).count(b"\n")
    expected = np.delete(events, lost)
    assert (decoded["t"] - decoded["t"][0]).tolist() == (expected["t"] - expected["t"][0]).tolist()
    assert all(np.array_equal(decoded[name], expected[name]) for name in "xyp")
    health = decoder.health
    assert health.skipped_bytes == sent.index(b"\n", fault) + 1 - fault
    assert health.bytes == len(sent) == health.decoded_bytes + health.skipped_bytes


def test_a_part_that_cannot_be_imported_is_named_and_breaks_nothing_else(
    tmp_path, monkeypatch, capsys, drive
):
    install(tmp_path, monkeypatch, GROUPS, my_broken="import no_such_library")
    assert "broken" not in baseline_names()
    assert "baseline left out: 'broken' of mine" in capsys.readouterr().err
    assert baseline_names() and not capsys.readouterr().err  # said once
    write_recording(tmp_path / "a.npz", iter(drive), sensor=SENSOR)
    assert open_recording(tmp_path / "a.npz").sensor == SENSOR
    (tmp_path / "a.own").write_bytes(bytes(30))
    for use in (
        lambda: open_baseline("broken"),
        lambda: open_recording(tmp_path / "a.own", sensor=SENSOR),
        lambda: open_recording(tmp_path / "a.npz", format="broken"),
        lambda: open_decoder("broken", SENSOR),
    ):
        expected = r"'broken' of mine \(edge_vpr.* cannot be imported .*no_such_library"
        with pytest.raises((UsageError, RecordingError), match=expected):
            use()


def test_a_map_is_made_with_given_pixels_of_a_list_or_of_another_map(drive, tmp_path, run):
    write_recording(tmp_path / "a.npz", iter(drive), sensor=SENSOR)
    (tmp_path / "pixels.txt").write_text("x, y\n3, 4\n0, 0\n23, 19\n")
    made = []
    for pixels, name in (("pixels.txt", "one.npz"), ("one.npz", "two.npz")):
        words = ["map", tmp_path / "a.npz", "-o", tmp_path / name]
        run(*words, "--pixel-map", tmp_path / pixels)
        made.append(ReferenceMap.load(tmp_path / name))
    expected = PixelMap(SENSOR, np.array([3, 0, 23]), np.array([4, 0, 19]))
    assert [each.pixel_map for each in made] == [expected, expected]
    assert made[0].settings.pixels == 3
    assert ReferenceMap.build(drive, pixel_map=tmp_path / "pixels.txt").pixel_map == expected
    (tmp_path / "pixels.txt").write_text("# none\n")
    with pytest.raises(UsageError, match="names no pixel"):
        ReferenceMap.build(drive, pixel_map=tmp_path / "pixels.txt")
    (tmp_path / "pixels.txt").write_text("24, 1\n")
    with pytest.raises(RecordingError, match="off the 24x20 sensor"):
        ReferenceMap.build(drive, pixel_map=tmp_path / "pixels.txt")
