"""Results that are there whole or not at all, and outputs that cost no input."""

from __future__ import annotations

import errno
import os
import signal
import socket
import stat
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from edge_vpr_tools.profile import meter_trace
from edge_vpr_tools.sweep.plan import read_plan
from lab.baselines.networks import read_state_dict
from lab.tables import read_rows

from edge_vpr import files as whole_files
from edge_vpr.descriptors.cleaning import load_hot_pixels
from edge_vpr.descriptors.pixels import load_pixel_map
from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr.evaluation.ground_truth import load_alignment, load_matrix
from edge_vpr.evaluation.tables import load_odometry
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.events import Sensor
from edge_vpr.files import check_output, clear_dead_runs, replacing, replacing_folder
from edge_vpr.live.protocols import open_decoder
from edge_vpr.records import read_json
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import resolve_settings
from firmware_model.design import Design
from firmware_model.errors import DesignError, VectorError
from firmware_model.vectors.verify import read_results

SENSOR = Sensor(32, 32)
NEW = {"file": replacing, "folder": replacing_folder}


def full(*_, **named):
    raise OSError(errno.ENOSPC, "No space left on device")


def write(path, text):
    with replacing(path) as temporary:
        temporary.write_text(text)


def write_folder(path, text):
    with replacing_folder(path) as folder:
        (folder / "inner").mkdir()
        (folder / "inner" / "a.txt").write_text(text)


def read_folder(path):
    return (path / "inner" / "a.txt").read_text()


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_new_file_has_the_permissions_that_the_umask_leaves(tmp_path, mask, mode):
    before = os.umask(mask)
    try:
        write(tmp_path / "a", "new")
        write_folder(tmp_path / "f", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == mode
    assert stat.S_IMODE((tmp_path / "f").stat().st_mode) == 0o777 & ~mask


def test_a_file_that_is_replaced_keeps_its_permissions(tmp_path):
    (tmp_path / "a").write_text("old")
    (tmp_path / "a").chmod(0o640)
    write(tmp_path / "a", "new")
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_a_link_stays_and_what_it_points_to_is_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real" / "a")
    for text in ("first", "second"):
        write(tmp_path / "link", text)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "real" / "a").read_text() == text
    (tmp_path / "folder").symlink_to(tmp_path / "real")
    write_folder(tmp_path / "folder", "whole")
    assert (tmp_path / "folder").is_symlink()
    assert read_folder(tmp_path / "real") == "whole"


def test_what_is_not_a_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name in ("pipe", ".", "loop"):
        with pytest.raises(UsageError):
            write(tmp_path / name, "x")
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match="there is a file of this name"):
        write_folder(tmp_path / "file", "x")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


INPUTS = {
    "a map": (".npz", ReferenceMap.load),
    "settings": (".toml", lambda path: resolve_settings(config=path)),
    "metrics": (".json", lambda path: read_json(path, "metrics", "match again")),
    "hot pixels": (".csv", lambda path: load_hot_pixels(path, SENSOR)),
    "a pixel map": (".npz", lambda path: load_pixel_map(path, SENSOR)),
    "a track": (".csv", load_track),
    "a log": (".nmea", load_track),
    "poses": (".tum", load_track),
    "odometry": (".csv", load_odometry),
    "a log of an odometer": (".jsonl", load_odometry),
    "pairs": (".csv", load_alignment),
    "a matrix": (".csv", load_matrix),
    "a matrix of NumPy": (".npy", load_matrix),
    "an archive of one": (".npz", load_matrix),
    "a meter": (".csv", meter_trace.read_meter),
    "rows": (".csv", read_rows),
    "weights": (".pth", read_state_dict),
    "a plan": (".toml", read_plan),
    "a layout": (".toml", lambda path: open_decoder(f"aer:layout={path}", SENSOR)),
    "a design": (".toml", Design.load),
    "results of a device": (".csv", read_results),
    "words of a device": (".bin", read_results),
}


@pytest.mark.parametrize("what", INPUTS)
@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
def test_an_input_is_a_file_and_nothing_else_is_waited_for(tmp_path, what, kind):
    """Also behind a link, as an archive may hold it: a pipe hung, /dev/zero filled the memory."""
    suffix, read = INPUTS[what]
    path = tmp_path / f"a{suffix}"
    with socket.socket(socket.AF_UNIX) as listener:
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "device":
            path.symlink_to(os.devnull)
        elif kind == "socket":
            listener.bind(str(path))
        else:
            path.mkdir()
        with interrupted_after(20), pytest.raises((EdgeVprError, DesignError, VectorError)) as told:
            read(path)
    assert str(path) in str(told.value)
    assert f"it is a {kind}, not a file" in str(told.value) or "it is no file" in str(told.value)


@contextmanager
def interrupted_after(seconds):
    """Fail where reading would wait."""

    def hang(*_):
        raise TimeoutError("it waits")

    before = signal.signal(signal.SIGALRM, hang)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_the_longest_name_that_a_folder_takes_can_be_written(tmp_path):
    write(tmp_path / ("n" * 255), "whole")
    assert (tmp_path / ("n" * 255)).read_text() == "whole"


def test_a_folder_is_replaced_whole(tmp_path):
    for text in ("first", "second", "third"):
        write_folder(tmp_path / "results", text)
        assert read_folder(tmp_path / "results") == text
        assert [path.name for path in tmp_path.iterdir()] == ["results"]


@pytest.mark.parametrize("kind", NEW)
def test_a_full_disk_is_an_error_that_names_what_was_written(tmp_path, kind):
    says = r"No space left on device: '.*/result'"
    with pytest.raises(OSError, match=says), NEW[kind](tmp_path / "result"):
        full()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("inner", ["write_text", "replacing", "by a library"])
def test_no_error_names_the_hidden_folder(tmp_path, monkeypatch, inner):
    def fails():
        with replacing_folder(tmp_path / "result") as folder:
            if inner == "by a library":
                raise EdgeVprError(f"cannot write {folder / 'a.h5'}: name another")
            if inner == "write_text":
                raise OSError(errno.ENOSPC, "No space left on device", str(folder / "a.h5"))
            monkeypatch.setattr(os, "fsync", full)
            write(folder / "a.h5", "text")

    with pytest.raises((OSError, EdgeVprError)) as told:
        fails()
    assert f"{tmp_path}/result/a.h5" in str(told.value)
    assert ".part" not in str(told.value)


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_an_error_in_the_block_leaves_what_was_there(tmp_path, kind):
    path = tmp_path / "results"
    (write if kind == "file" else write_folder)(path, "old")
    with pytest.raises(KeyboardInterrupt), NEW[kind](path) as made:
        (made if kind == "file" else made / "half").write_text("half")
        raise KeyboardInterrupt
    assert (path.read_text() if kind == "file" else read_folder(path)) == "old"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("stop", [1, 2])
def test_a_kill_between_the_renames_leaves_the_old_folder_under_another_name(
    tmp_path, monkeypatch, stop
):
    """No later run moves or removes it."""
    write_folder(tmp_path / "results", "old")
    child = os.fork()
    if child == 0:
        calls, real = [], whole_files.Path.rename

        def rename(self, target):
            real(self, target)
            calls.append(target)
            if len(calls) == stop:
                os.kill(os.getpid(), signal.SIGKILL)

        whole_files.Path.rename = rename
        write_folder(tmp_path / "results", "new")
        os._exit(1)
    _, status = os.waitpid(child, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    clear_dead_runs(tmp_path)
    old, *new = sorted(path.name for path in tmp_path.iterdir())
    assert old.startswith("edge-vpr-old-")
    assert read_folder(tmp_path / old) == "old"
    assert new == ["results"][: stop - 1]
    write_folder(tmp_path / "results", "later")
    assert read_folder(tmp_path / "results") == "later"
    assert read_folder(tmp_path / old) == "old"


def test_an_error_between_the_renames_leaves_the_old_folder(tmp_path, monkeypatch):
    write_folder(tmp_path / "results", "old")
    real = whole_files.Path.rename

    def rename(self, target):
        if self.parent.suffix == ".part":
            raise OSError(errno.ENOSPC, "No space left on device", str(target))
        return real(self, target)

    monkeypatch.setattr(whole_files.Path, "rename", rename)
    with pytest.raises(OSError, match="No space left"):
        write_folder(tmp_path / "results", "new")
    assert read_folder(tmp_path / "results") == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


HOLD = """
import sys
from edge_vpr.files import replacing, replacing_folder
with (replacing_folder if sys.argv[2] == "folder" else replacing)(sys.argv[1]) as temporary:
    print("ready", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_killed_run_is_cleared_at_the_next_one_and_a_living_one_is_left_alone(tmp_path, what):
    runs = []
    for name in ("dead", "alive"):
        run = subprocess.Popen(
            [sys.executable, "-c", HOLD, str(tmp_path / name), what],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        assert run.stdout.readline() == b"ready\n"
        runs.append(run)
    dead, alive = runs
    try:
        dead.kill()
        dead.wait()
        assert len(list(tmp_path.iterdir())) == 2
        write(tmp_path / "another", "whole")
        left = sorted(path.name for path in tmp_path.iterdir())
        assert len(left) == 2
        assert left[0].startswith(".edge-vpr-")
        assert left[1] == "another"
    finally:
        alive.kill()
        alive.wait()
        for run in runs:
            run.stdin.close()
            run.stdout.close()
    write(tmp_path / "another", "again")
    assert [path.name for path in tmp_path.iterdir()] == ["another"]


DEAD = ".edge-vpr-0123456789abcdef.part"


@pytest.fixture
def precious(tmp_path):
    folder = tmp_path / "precious"
    (folder / "inner").mkdir(parents=True)
    for file in (folder / "data", folder / "inner" / "data"):
        file.write_text("kept")
    return folder


def _files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("planted", ["inner/deeper", "a file", "itself"])
def test_links_in_what_looks_like_a_dead_run_are_not_followed(tmp_path, precious, planted):
    dead = tmp_path / "shared" / DEAD
    if planted == "itself":
        dead.parent.mkdir()
        dead.symlink_to(precious)
    else:
        (dead / planted).parent.mkdir(parents=True)
        (dead / planted).symlink_to(precious / "data" if planted == "a file" else precious)
    write(tmp_path / "shared" / "drive.npz", "whole")
    assert _files(precious) == ["data", "inner", "inner/data"]
    left = _files(tmp_path / "shared")
    assert left == ([DEAD] if planted == "itself" else []) + ["drive.npz"]


def test_a_folder_of_another_user_is_left_alone(tmp_path, monkeypatch):
    (tmp_path / DEAD / "rows").mkdir(parents=True)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    clear_dead_runs(tmp_path)
    assert (tmp_path / DEAD / "rows").is_dir()


@pytest.mark.parametrize("writer", [write, write_folder])
def test_file_and_folder_reach_the_disk_before_and_after_the_name_changes(
    tmp_path, monkeypatch, writer
):
    writer(tmp_path / "result", "old")
    steps, sync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (steps.append(_name(handle)), sync(handle)))
    for name in ("replace", "rename"):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, lambda a, b, real=real: (steps.append("named"), real(a, b)))
    writer(tmp_path / "result", "new")
    first = steps.index("named")
    assert ("a.txt" if writer is write_folder else "result") in steps[:first]
    assert steps[-1] == tmp_path.name and "a.txt" not in steps[first:]


def _name(handle):
    return Path(f"/proc/self/fd/{handle}").readlink().name


def test_an_output_that_is_the_input_by_any_name_is_refused(tmp_path, monkeypatch):
    source = tmp_path / "drive.npz"
    source.write_text("events")
    (tmp_path / "soft.npz").symlink_to(source)
    os.link(source, tmp_path / "hard.npz")
    (tmp_path / "around").symlink_to(tmp_path)
    monkeypatch.chdir(tmp_path)
    for output in (source, "drive.npz", "./drive.npz", "soft.npz", "hard.npz", "around/drive.npz"):
        for input_name in (source, "drive.npz", "soft.npz"):
            with pytest.raises(UsageError, match="is the input"):
                check_output(output, ["none.npz", input_name])


def test_an_output_folder_around_an_input_is_refused(tmp_path):
    (tmp_path / "results" / "deep").mkdir(parents=True)
    source = tmp_path / "results" / "deep" / "map.npz"
    source.write_text("map")
    (tmp_path / "link.npz").symlink_to(source)
    for input_path in (source, tmp_path / "link.npz"):
        with pytest.raises(UsageError, match="holds the input"):
            check_output(tmp_path / "results", [input_path])


def test_an_output_in_an_input_folder_is_refused_and_beside_it_is_not(tmp_path):
    (tmp_path / "bag").mkdir()
    with pytest.raises(UsageError, match="lies in the input"):
        check_output(tmp_path / "bag" / "map.npz", [tmp_path / "bag"])
    check_output(tmp_path / "bag.npz", [tmp_path / "bag"])
    check_output(tmp_path / "bag2" / "map.npz", [tmp_path / "bag"])


def test_two_runs_at_once_leave_one_whole_result(tmp_path):
    with replacing(tmp_path / "a") as first:
        with replacing(tmp_path / "a") as second:
            second.write_text("second")
        first.write_text("first")
    assert (tmp_path / "a").read_text() == "first"
    write(tmp_path / "a", "third")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_of_two_runs_at_once_that_replace_nothing_the_first_to_end_wins(
    tmp_path, monkeypatch, kind, links
):
    def unsupported(*_):
        raise OSError(errno.EPERM, "no hard links")

    if not links:
        monkeypatch.setattr(os, "link", unsupported)
    path = tmp_path / "a"

    def run(text, inner=None):
        with NEW[kind](path, overwrite=False) as made:
            if inner is not None:
                run(inner)
            (made / "inner" if kind == "folder" else made).write_text(text)

    with pytest.raises(UsageError, match=r"another run wrote .*a in the meantime") as told:
        run("second", inner="first")
    assert "\n" not in str(told.value)
    assert (path / "inner" if kind == "folder" else path).read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    with pytest.raises(UsageError, match="a exists: name another"):
        run("third")


def test_an_empty_folder_is_filled(tmp_path):
    (tmp_path / "a").mkdir()
    with replacing_folder(tmp_path / "a", overwrite=False) as folder:
        (folder / "inner").write_text("x")
    assert (tmp_path / "a" / "inner").read_text() == "x"
