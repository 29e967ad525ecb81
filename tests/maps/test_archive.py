"""Files that are written whole or not at all."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from edge_vpr import archive as archive_module
from edge_vpr.archive import read_archive, read_members, write_archive
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import make_events
from tests.maps.saved_files import same_contents


def test_what_was_written_is_read(tmp_path):
    write_archive(tmp_path / "a.npz", "thing", {"x": np.arange(3)}, {"name": "n"})
    arrays, meta = read_archive(tmp_path / "a.npz", "thing")
    assert arrays["x"].tolist() == [0, 1, 2]
    assert meta == {"name": "n"}


def test_a_folder_that_does_not_exist_is_wrong_use(tmp_path):
    with pytest.raises(UsageError, match="name a folder that exists"):
        write_archive(tmp_path / "none" / "a.npz", "thing", {}, {})


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: None, r"there is no thing at .*a\.npz"),
        (lambda path: path.write_bytes(b""), "is not a thing of edge-vpr"),
        (lambda path: path.write_bytes(b"just text"), "is not a thing of edge-vpr"),
        (
            lambda path: path.write_bytes(b"PK\x03\x04 broken"),
            "not a readable thing, make it again",
        ),
        (lambda path: path.mkdir(), "it is a folder, not a file: name a thing that can"),
        (lambda path: np.savez(path, x=np.arange(3)), "name a file that edge-vpr wrote"),
        # a recording is not called damaged: its events are a record, which no array of ours is
        (
            lambda path: np.savez(path, events=make_events([1], [2], [3], [1])),
            r"a\.npz is not a thing of edge-vpr: name a file",
        ),
        # pickles are never opened
        (
            lambda path: np.savez(path, edge_vpr=np.array([{"kind": "thing"}], dtype=object)),
            "expected numbers or text",
        ),
        (lambda path: write_archive(path, "map", {}, {}), "is a map, not a thing"),
    ],
)
def test_what_is_no_archive_of_this_kind_is_refused(tmp_path, make, says):
    make(tmp_path / "a.npz")
    with pytest.raises(MapError, match=says):
        read_archive(tmp_path / "a.npz", "thing")


CONTENTS = (
    {"x": np.arange(40, dtype=np.int32), "late": np.array([0.5, np.nan]), "last": np.ones(3)},
    {"settings": {"tau_us": 10, "sigma": 0.25}, "sensor": [6, 5]},
)


def test_an_archive_cut_off_anywhere_is_refused(tmp_path):
    write_archive(tmp_path / "a.npz", "thing", *CONTENTS)
    whole = (tmp_path / "a.npz").read_bytes()
    for length in range(len(whole)):
        (tmp_path / "b.npz").write_bytes(whole[:length])
        with pytest.raises(MapError, match=r"b\.npz"):
            read_archive(tmp_path / "b.npz", "thing")


def test_an_archive_with_any_byte_changed_is_refused_or_reads_as_before(tmp_path):
    write_archive(tmp_path / "a.npz", "thing", *CONTENTS)
    whole, path = (tmp_path / "a.npz").read_bytes(), tmp_path / "b.npz"
    expected, refused = read_archive(tmp_path / "a.npz", "thing"), 0
    for at in range(len(whole)):
        for bit in (at % 8, (at + 3) % 8):
            path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :])
            try:
                contents = read_archive(path, "thing")
            except MapError as error:
                assert str(error).isprintable() and str(path) in str(error)
                refused += 1
            else:
                assert same_contents(contents, expected), (at, bit)
    assert refused > len(whole)


def members_of(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_an_archive_without_one_of_its_arrays_or_with_that_of_another_is_refused(tmp_path):
    """Whose own checksums, those of ZIP, are right."""
    write_archive(tmp_path / "a.npz", "thing", *CONTENTS)
    write_archive(tmp_path / "b.npz", "thing", {"x": np.arange(1, 41, dtype=np.int32)}, {})
    whole, other = members_of(tmp_path / "a.npz"), members_of(tmp_path / "b.npz")
    lacks = {name: raw for name, raw in whole.items() if name != "late.npy"}
    for members in (lacks, whole | {"x.npy": other["x.npy"]}, whole | {"more.npy": whole["x.npy"]}):
        with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
            for name, raw in members.items():
                archive.writestr(name, raw)
        with pytest.raises(MapError, match=r"c\.npz is damaged \(its checksum does not fit\)"):
            read_archive(tmp_path / "c.npz", "thing")


def test_an_archive_that_unpacks_to_far_more_than_its_size_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr(archive_module, "MEMORY_BYTES", 1 << 20)
    write_archive(tmp_path / "a.npz", "thing", {"x": np.zeros(1 << 21, np.uint8)}, {})
    with pytest.raises(MapError, match=r"unpacks to \d+ bytes, more than"):
        read_archive(tmp_path / "a.npz", "thing")


def test_an_array_that_announces_more_than_it_holds_takes_no_memory(tmp_path):
    np.savez(tmp_path / "a.npz", counts=np.zeros(3, dtype=np.uint8))
    member = members_of(tmp_path / "a.npz")["counts.npy"]
    for shape in (b"(9**12,)", b"(10**12,)", b"(999999999999,)", b"(-3,)", b"(2, 2)"):
        with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
            archive.writestr("counts.npy", member.replace(b"(3,)", shape))
        with pytest.raises((MapError, ValueError), match=r"array counts|malformed"):
            read_members(tmp_path / "b.npz")


def test_a_file_of_another_version_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(archive_module, "SCHEMA_VERSION", archive_module.SCHEMA_VERSION + 1)
    write_archive(tmp_path / "a.npz", "thing", {}, {})
    monkeypatch.undo()
    with pytest.raises(MapError, match=r"schema version \d and this edge-vpr reads version \d:"):
        read_archive(tmp_path / "a.npz", "thing")
