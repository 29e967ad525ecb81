"""Files that are written whole or not at all."""

from __future__ import annotations

import numpy as np
import pytest

from edge_vpr import archive
from edge_vpr.archive import read_archive, write_archive
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import make_events
from edge_vpr.files import replacing


def test_what_was_written_is_read(tmp_path):
    write_archive(tmp_path / "a.npz", "thing", {"x": np.arange(3)}, {"name": "n"})
    arrays, meta = read_archive(tmp_path / "a.npz", "thing")
    assert arrays["x"].tolist() == [0, 1, 2]
    assert meta == {"name": "n"}


def test_an_interrupted_write_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "a.npz"
    path.write_text("old")

    def interrupted():
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_does_not_exist_is_wrong_use(tmp_path):
    with pytest.raises(UsageError, match="name a folder that exists"):
        write_archive(tmp_path / "none" / "a.npz", "thing", {}, {})


def test_a_missing_file_says_what_was_looked_for(tmp_path):
    with pytest.raises(MapError, match=r"there is no thing at .*none\.npz"):
        read_archive(tmp_path / "none.npz", "thing")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is not a thing of edge-vpr"),
        (b"just text", "is not a thing of edge-vpr"),
        (b"PK\x03\x04 broken", "not a readable thing, make it again"),
    ],
)
def test_an_unreadable_file_is_an_error(tmp_path, content, says):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(MapError, match=says):
        read_archive(tmp_path / "a.npz", "thing")


def test_a_recording_in_the_place_of_a_map_is_not_called_damaged(tmp_path):
    """Its events are a record, which no array of ours is."""
    np.savez(tmp_path / "drive.npz", events=make_events([1], [2], [3], [1]))
    with pytest.raises(MapError, match=r"drive\.npz is not a thing of edge-vpr: name a file"):
        read_archive(tmp_path / "drive.npz", "thing")


def test_a_truncated_file_is_an_error(tmp_path):
    write_archive(tmp_path / "a.npz", "thing", {"x": np.arange(1000)}, {})
    whole = (tmp_path / "a.npz").read_bytes()
    for length in range(0, len(whole), 97):
        (tmp_path / "b.npz").write_bytes(whole[:length])
        with pytest.raises(MapError):
            read_archive(tmp_path / "b.npz", "thing")


def test_an_array_file_of_somebody_else_is_an_error(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.arange(3))
    with pytest.raises(MapError, match="name a file that edge-vpr wrote"):
        read_archive(tmp_path / "a.npz", "thing")
    np.save(tmp_path / "a.npy", np.arange(3))
    with pytest.raises(MapError):
        read_archive(tmp_path / "a.npy", "thing")


def test_a_file_of_another_kind_is_an_error(tmp_path):
    write_archive(tmp_path / "a.npz", "thing", {}, {})
    with pytest.raises(MapError, match="is a thing, not a map"):
        read_archive(tmp_path / "a.npz", "map")


def test_a_file_from_a_newer_version_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(archive, "SCHEMA_VERSION", 2)
    write_archive(tmp_path / "a.npz", "thing", {}, {})
    monkeypatch.undo()
    with pytest.raises(MapError, match="schema version 2 and this edge-vpr reads up to 1"):
        read_archive(tmp_path / "a.npz", "thing")
