"""Files of ours that were changed by accident or on purpose: refused, or worth what they say."""

from __future__ import annotations

import io
import json
import sys
import zipfile

import archive_mutants
import fuzz_archives
import numpy as np
import pytest
from archive_mutants import PIXELS, SENSOR, map_of
from edge_vpr_tools.cli import main
from streams import random_events

from edge_vpr.archive import MEMORY_BYTES, read_archive, write_archive
from edge_vpr.descriptors.cleaning import load_hot_pixels
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, FixedCount, FixedTime
from edge_vpr.errors import LONGEST_MESSAGE, EventError, MapError, RecordingError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.online.localiser import Localiser, check_extent
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings, resolve_settings
from fixedpoint.codes import PixelCodes
from fixedpoint.errors import FixedPointError


def rewritten(path, kind, change):
    """Change the arrays and the header of a saved file."""
    arrays, meta = read_archive(path, kind)
    change(arrays, meta)
    write_archive(path, kind, arrays, meta)


@pytest.fixture
def saved_map(tmp_path):
    path = tmp_path / "map.npz"
    map_of({}, np.random.default_rng(3)).save(path)
    return path


@pytest.fixture
def saved_state(tmp_path):
    rng = np.random.default_rng(3)
    localiser = Localiser(map_of({}, rng, largest=20))  # bytes, which most tests compile for
    localiser.update(random_events(rng, 200, SENSOR, 400))
    path = tmp_path / "state.npz"
    localiser.save(path)
    assert len(read_archive(path, "localiser state")[0]["slot"]) > 5
    return path


def put(name, change):
    """A change of one array."""

    def changed(arrays, meta):
        arrays[name] = change(arrays[name])

    return changed


def say(change):
    """A change of the header."""
    return lambda arrays, meta: change(meta)


def shorter_map(arrays, meta):
    for name in ("pixel_x", "pixel_y"):
        arrays[name] = arrays[name][:1]


def odd_scales(arrays, meta):
    meta["settings"].update(counter_code="log", counter_scaling="per-pixel")
    arrays["counts"] = np.minimum(arrays["counts"], 1).astype(np.uint8)
    arrays["full_scale"] = np.array([1, 3, 6, 7], dtype=np.uint16)


@pytest.mark.parametrize(
    "change",
    [
        put("counts", lambda a: a[:, :2]),
        put("counts", lambda a: a[:, :0]),
        put("counts", lambda a: a[:0]),
        put("counts", lambda a: np.repeat(a, 2, axis=1)),
        put("counts", lambda a: a.astype(np.float32)),
        put("counts", lambda a: a.astype(np.int16)),
        put("counts", lambda a: a.astype(np.uint64)),
        put("counts", lambda a: a.T),
        put("counts", lambda a: a[0]),
        put("pixel_x", lambda a: a[:0]),
        put("pixel_x", lambda a: a.astype(np.float64)),
        put("start_us", lambda a: a[:-1]),
        put("start_us", lambda a: a + 2**61),
        put("end_us", lambda a: a - 10**6),
        put("events", lambda a: -a - 1),
        put("saliency", lambda a: a.T),
        put("saliency", lambda a: a + np.float32(np.nan)),
        put("hot", lambda a: a[1:]),
        put("hot", lambda a: a.astype(np.uint8)),
        shorter_map,
        odd_scales,
        say(lambda meta: meta["settings"].update(polarity=True)),
        say(lambda meta: meta["settings"].update(pixels=5)),
        say(lambda meta: meta["settings"].update(clip=1)),
        say(lambda meta: meta["settings"].update(counter_code="log", counter_scaling="per-pixel")),
        say(lambda meta: meta["settings"].update(sigma=10**400)),
        say(lambda meta: meta["settings"].update(sigma=float("nan"))),
        say(lambda meta: meta.update(settings=[1])),
        say(lambda meta: meta.update(settings=None)),
        say(lambda meta: meta.update(sensor=[6, 5, 4])),
        say(lambda meta: meta.update(sensor=[6.0, 5.0])),
        say(lambda meta: meta.update(sensor=[2**40, 1])),
        say(lambda meta: meta.update(sensor=[65_536, 65_536])),
        say(lambda meta: meta.update(sensor=[True, 5])),
        say(lambda meta: meta.pop("sensor")),
        lambda arrays, meta: arrays.pop("saliency"),
    ],
)
def test_a_map_whose_parts_do_not_fit_is_refused_before_a_kernel_sees_it(saved_map, change):
    rewritten(saved_map, "reference map", change)
    with pytest.raises(MapError, match=r"map\.npz.*make the map again"):
        ReferenceMap.load(saved_map)


@pytest.mark.parametrize(
    "change",
    [
        put("slot", lambda a: a + 4),
        put("slot", lambda a: -a - 1),
        put("slot", lambda a: a.astype(np.int64)),
        put("slot", lambda a: a[:-1]),
        put("time", lambda a: a[::-1]),
        put("time", lambda a: a - 300),
        put("time", lambda a: a + 10**6),
        put("time", lambda a: a.astype(np.float64)),
        put("bound", lambda a: a[:-1]),
        put("bound", lambda a: a + (np.arange(a.size) == 1)),
        put("bound", lambda a: a[::-1]),
        put("bound", lambda a: a * 2),
        put("bound", lambda a: a - a[0] - 1),
        put("policy", lambda a: a + 1),
        put("policy", lambda a: a[:1]),
        put("policy", lambda a: a.astype(np.float64)),
        put("policy", lambda a: np.array([0, 10**6])),
        put("places", lambda a: a[:, :2]),
        put("places", lambda a: a[:1]),
        put("places", lambda a: np.repeat(a, 2, axis=1)),
        say(lambda meta: meta.update(now_us=0)),
        say(lambda meta: meta.update(now_us=meta["now_us"] + 60, floor_us=meta["floor_us"] + 60)),
        say(lambda meta: meta.update(floor_us=-1)),
        say(lambda meta: meta.update(now_us=2**70, floor_us=2**70)),
        say(lambda meta: meta.update(recent=-1)),
        say(lambda meta: meta.update(recent=10**6)),
        say(lambda meta: meta.update(recent=0.5)),
        say(lambda meta: meta["every"].update(events=1.5)),
        say(lambda meta: meta["every"].update(events=2**63)),
        say(lambda meta: meta["every"].update(change="no")),
        say(lambda meta: meta["every"].update(often=1)),
        say(lambda meta: meta.update(every=[])),
        say(lambda meta: meta["settings"].update(polarity=True)),
        say(lambda meta: meta["settings"].update(sequence_length=3)),
        say(lambda meta: meta["settings"].update(tau_us=10)),
        say(lambda meta: meta["settings"].update(tau_us=10**15, sequence_length=2000)),
    ],
)
def test_a_state_that_no_run_can_leave_is_refused(saved_state, change):
    rewritten(saved_state, "localiser state", change)
    with pytest.raises(MapError, match=r"state\.npz.*save the state again"):
        Localiser.load(saved_state)


def test_a_map_that_is_changed_in_memory_is_refused_by_the_localiser():
    reference = map_of({}, np.random.default_rng(0))
    object.__setattr__(reference.places, "counts", reference.places.counts[:, :3].copy())
    with pytest.raises(MapError, match=r"counts is .*expected"):
        Localiser(reference)


def test_a_read_only_map_is_followed_like_any_other():
    reference = map_of({}, np.random.default_rng(0), largest=20)
    events = random_events(np.random.default_rng(1), 80, SENSOR, 600)
    expected = Localiser(reference).update(events)
    reference.places.counts.setflags(write=False)
    assert Localiser(reference).update(events).tobytes() == expected.tobytes()
    assert expected.size


@pytest.mark.parametrize(
    "change",
    [
        put("place", lambda a: a + 100),
        put("place", lambda a: -a - 1),
        put("place", lambda a: a[:-1]),
        put("second", lambda a: a - 100),
        put("candidates", lambda a: a[:, :3]),
        put("candidates", lambda a: a + 100),
        put("distance_sum", lambda a: a.astype(np.float64)),
        put("distance_sum", lambda a: -a - 1),
        put("time_us", lambda a: a + 2**61),
        put("ties", lambda a: a - 1),
        say(lambda meta: meta.update(places_in_map=0)),
        say(lambda meta: meta.update(places_in_map=2.5)),
    ],
)
def test_matches_outside_their_map_are_refused(tmp_path, change):
    reference = map_of({}, np.random.default_rng(0))
    path = tmp_path / "matches.npz"
    match_descriptors(reference.places, reference.places, reference.settings).save(path)
    rewritten(path, "set of matches", change)
    with pytest.raises(MapError, match=r"matches\.npz.*match again"):
        Matches.load(path)


def test_descriptors_of_a_file_are_checked():
    columns = map_of({}, np.random.default_rng(0)).places.to_arrays()
    with pytest.raises(MapError, match="lack counts"):
        Descriptors.from_arrays({name: a for name, a in columns.items() if name != "counts"})
    with pytest.raises(MapError, match="expected one window or more"):
        Descriptors.from_arrays({name: a[:0] for name, a in columns.items()})


def test_more_different_scales_than_a_byte_can_name_are_refused():
    with pytest.raises(FixedPointError, match="257 different full scales"):
        PixelCodes.scaled("linear", 4, range(1, 258))
    codes = PixelCodes.scaled("linear", 4, range(1, 257))
    assert codes.row[-1] == 255
    with pytest.raises(FixedPointError, match="expected 0 to 255"):
        PixelCodes(codes.codes, np.array([256]))


@pytest.mark.parametrize("sensor", [(0, 5), (65_537, 1), (-6, 5), (6.0, 5), (2**40, 2**40)])
def test_a_sensor_has_sides_of_1_to_65536(sensor):
    with pytest.raises(UsageError, match="expected sides of 1 to 65536"):
        PixelMap(Sensor(*sensor), PIXELS.x, PIXELS.y)


def test_windows_and_sequences_that_no_integer_holds_are_wrong_use():
    with pytest.raises(UsageError, match="make windows of more than"):
        Settings(window="count", events_per_pixel=1e15)
    with pytest.raises(UsageError, match="take shorter windows"):
        check_extent(10**6, 1, 2_000, 0, FixedTime(10**15))
    with pytest.raises(UsageError, match="take a shorter sequence"):
        check_extent(10**6, 150, 10**5, 0, FixedTime(1))
    check_extent(100_000, 150, 100, 0, FixedTime(10**6))


@pytest.mark.parametrize("window", [FixedTime, FixedCount])
@pytest.mark.parametrize("length", [0, -1, 2**63, 10**30])
def test_a_window_has_a_length_that_fits_the_kernels(window, length):
    with pytest.raises(UsageError, match="expected 1"):
        window(length)


def test_time_cannot_be_let_pass_beyond_its_range():
    localiser = Localiser(map_of({}, np.random.default_rng(0)))
    with pytest.raises(EventError, match="lies beyond"):
        localiser.advance(2**70)


@pytest.mark.parametrize("line", ["inf,1", "1e400,1", "nan,0", "1", "1,2,3", "9,9"])
def test_a_list_of_hot_pixels_that_names_none_is_an_error_of_ours(tmp_path, line):
    (tmp_path / "hot.txt").write_text(f"x,y\n{line}\n")
    with pytest.raises(RecordingError, match=r"hot\.txt"):
        load_hot_pixels(tmp_path / "hot.txt", SENSOR)


@pytest.mark.parametrize(
    "text",
    ["sigma = " + "[" * 50_000, "seed = 0x" + "f" * 5_000, "seed = " + "1" * 5_000, "sigma = nan",
     "sigma = inf", "preset = 7", "preset = []", "a = 1979-13-45", "tau_us = true", "\x00",
     "strategy = 3", "# " + "x" * (1 << 20)],
)  # fmt: skip
def test_settings_that_cannot_be_are_one_line_that_names_the_file(tmp_path, text):
    (tmp_path / "odd.toml").write_text(text)
    with pytest.raises(UsageError) as caught:
        resolve_settings(config=tmp_path / "odd.toml")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) <= LONGEST_MESSAGE
    if "preset" not in text:
        assert "odd.toml" in str(caught.value)


def bomb(path, unpacked):
    """A small archive with our header that announces, and holds, many zeros."""
    ours, header = io.BytesIO(), io.BytesIO()
    np.save(ours, np.array('{"kind": "thing", "version": 1}'))
    shape = {"descr": "|u1", "fortran_order": False, "shape": (unpacked,)}
    np.lib.format.write_array_header_1_0(header, shape)
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("counts.npy", "w", force_zip64=True) as member,
    ):
        member.write(header.getvalue())
        for _ in range(unpacked >> 20):
            member.write(bytes(1 << 20))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("edge_vpr.npy", ours.getvalue())


def test_an_archive_that_unpacks_to_far_more_than_its_size_is_refused_unread(tmp_path):
    bomb(tmp_path / "bomb.npz", MEMORY_BYTES + (1 << 20))
    assert (tmp_path / "bomb.npz").stat().st_size < 2 << 20
    with pytest.raises(MapError, match=r"unpacks to \d+ bytes, more than"):
        read_archive(tmp_path / "bomb.npz", "thing")


def test_an_array_that_announces_more_than_it_holds_takes_no_memory(tmp_path):
    np.savez(tmp_path / "a.npz", counts=np.zeros(3, dtype=np.uint8))
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        member = archive.read("counts.npy")
    for shape in (b"(9**12,)", b"(10**12,)", b"(999999999999,)", b"(-3,)", b"(2, 2)"):
        with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
            archive.writestr("counts.npy", member.replace(b"(3,)", shape))
        with pytest.raises(MapError, match=r"b\.npz"):
            read_archive(tmp_path / "b.npz", "thing")


@pytest.mark.parametrize(
    "header",
    ["[]", "7", "null", "{", "[" * 100_000, '{"kind": "thing"}',
     '{"kind": "thing", "version": true}', '{"kind": "thing", "version": 0}',
     '{"kind": "thing", "version": "1"}',
     '{"kind": "thing", "version": ' + "1" * 5_000 + "}"],
)  # fmt: skip
def test_a_header_that_is_not_ours_is_one_line_that_names_the_file(tmp_path, header):
    np.savez(tmp_path / "a.npz", edge_vpr=np.array(header))
    with pytest.raises(MapError, match=r"a\.npz"):
        read_archive(tmp_path / "a.npz", "thing")


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("name", ["edge_vpr", "route_coordinates"])
def test_numbers_that_are_no_characters_are_one_line_that_names_the_file(tmp_path, name, byteorder):
    """Turned to text, they raise a SystemError, in the message of an error too."""
    header = np.array('{"kind": "thing", "version": 1}')
    text = np.array([sys.maxunicode + 1, 65], dtype=f"{byteorder}u4").view(f"{byteorder}U2")
    np.savez(tmp_path / "a.npz", **{"edge_vpr": header, name: text.reshape(())})
    with pytest.raises(MapError, match=f"a.npz: array {name} holds numbers that are no characters"):
        read_archive(tmp_path / "a.npz", "thing")


def test_pickles_are_never_opened(tmp_path):
    np.savez(tmp_path / "a.npz", edge_vpr=np.array([{"kind": "thing"}], dtype=object))
    with pytest.raises(MapError, match="expected numbers or text"):
        read_archive(tmp_path / "a.npz", "thing")


def test_a_folder_is_not_an_archive(tmp_path):
    with pytest.raises(MapError, match="it is a folder, not a file: name a thing that can"):
        read_archive(tmp_path, "thing")


@pytest.mark.slow
def test_changed_files_of_every_kind_are_refused_or_give_what_the_oracle_gives():
    """A bounded part of `python tests/maps/fuzz_archives.py`."""
    result = fuzz_archives.run(inputs=300, seed=20)
    assert not result.finds
    assert result.most_bytes < fuzz_archives.MEMORY_BYTES
    for kind in ("map", "state"):
        assert result.accepted[kind] > 5
        assert result.refused[kind] > 30


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["raise", "die", "hang"])
def test_the_fuzzer_finds_what_it_is_there_for(tmp_path, monkeypatch, fault):
    """An input that ends in a foreign exception, a dead process or a hang is told by its number."""
    monkeypatch.setattr(fuzz_archives, "TIME_S", 1.0)
    real = fuzz_archives.one

    def faulty(files, folder, seed, number):
        if number == 3 and fault == "raise":
            raise IndexError("foreign")
        if number == 3 and fault == "die":
            import os
            import signal

            os.kill(os.getpid(), signal.SIGSEGV)
        if number == 3 and fault == "hang":
            import time

            time.sleep(60)
        return real(files, folder, seed, number)

    monkeypatch.setattr(fuzz_archives, "one", faulty)
    result = fuzz_archives.run(inputs=6, seed=0)
    assert [find.number for find in result.finds] == [3]
    what = {"raise": "IndexError", "die": "SIGSEGV", "hang": "took more than"}[fault]
    assert what in result.finds[0].what
    assert sum(result.accepted.values()) + sum(result.refused.values()) == 5


NESTED = "a = " + "[" * 5_000 + "]" * 5_000
DIGITS = "9" * 5_000


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        *((kind, text) for kind in ("layout", "design", "target") for text in (NESTED, DIGITS)),
        ("profile", "[" * 50_000),
        ("profile", "[]"),
        ("design", 'width = 4\nheight = 4\npixels = 2\nplaces = 9\nsteps = "x"'),
        ("design", f"width = 4\nheight = 4\npixels = 2\nplaces = {DIGITS[:4200]}"),
        ("design", "width = 4\nheight = 4\npixels = 2\nplaces = 9\npolarity = 3"),
        ("target", 'name = "a"\nkind = "processor"\nclock_hz = "fast"'),
        ("target", 'name = "a"\nkind = "fpga"\nclock_hz = 1e6\nblock_shapes = [[1]]'),
        ("target", 'name = "a"\nkind = ["fpga"]\nclock_hz = 1e6'),
        ("target", 'name = "a"\nkind = "fpga"\nclock_hz = nan'),
        ("meter", "time,power\n" + "1" * 200_000 + ",1\n2,1\n"),
        ("meter", ""),
    ],
)
def test_files_of_plain_values_end_in_one_error_whatever_they_hold(kind, text, tmp_path):
    path = tmp_path / f"file.{'json' if kind == 'profile' else 'toml'}"
    path.write_text(text)
    assert not archive_mutants.outcome(kind, path)


@pytest.mark.parametrize("change", [("throughput", 5), ("energy", []), ("run", {}), ("load", 1)])
def test_a_profile_with_another_value_is_refused_before_anything_is_written(
    change, tmp_path, capsys
):
    path, out = tmp_path / "profile.json", tmp_path / "out.csv"
    found = archive_mutants.plain_profile()
    path.write_text(json.dumps(found))
    words = ["profile", "compare", str(path), str(path), "--csv"]
    assert main([*words, str(out)]) == 0
    assert out.read_text().count("\n") > 10
    path.write_text(json.dumps(found | dict([change])))
    capsys.readouterr()
    assert main([*words, str(tmp_path / "other.csv")]) == UsageError.exit_code
    assert "profile" in capsys.readouterr().err
    assert not (tmp_path / "other.csv").exists()
