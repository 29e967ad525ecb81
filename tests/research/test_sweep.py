"""Sweeps: each trial once, whoever dies meanwhile; comparisons of what was found."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import naive
import numpy as np
import pytest
import sweep_jobs
from edge_vpr_tools import cli
from edge_vpr_tools.research import trials
from edge_vpr_tools.research.baselines import match_distances, open_baseline
from edge_vpr_tools.research.experiments.pairs import Pair
from edge_vpr_tools.research.sweep import SHARES, comparison
from edge_vpr_tools.research.sweep.comparison import draw, rows_of, write_comparison
from edge_vpr_tools.research.sweep.plan import (
    content_hash,
    read_plan,
    run_trial,
    sweep_store,
)
from edge_vpr_tools.research.trials import (
    Inline,
    cluster,
    failures,
    processes,
    run_all,
)
from matplotlib.figure import Figure
from streams import random_events

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Sensor
from edge_vpr.recordings import write_recording
from edge_vpr.results import run_record, write_json
from edge_vpr.settings import PRESETS, Settings

ROOT = Path(__file__).parents[2]

PLAN = """
seeds = [1, 2]

[settings]
preset = "paper"
sigma = 1.0
tau = "100ms"

[grid]
pixels = [3, 5]

[variants.again]  # the same as pixels=5 under another name
pixels = 5

[drives.evening]
reference = "monday.npz"
query = "tuesday.npz"
ground_truth = "truth.csv"
tolerance = 0.2
"""


class Counted(Inline):
    """Counts the jobs."""

    def __init__(self):
        self.jobs = 0

    def submit(self, run, job):
        self.jobs += 1
        return super().submit(run, job)


@pytest.fixture
def plan_file(tmp_path):
    rng = np.random.default_rng(0)
    for name in ("monday", "tuesday"):
        events = random_events(rng, 2_000, Sensor(16, 12), 1_500_000)
        write_recording(tmp_path / f"{name}.npz", [events], sensor=Sensor(16, 12))
    (tmp_path / "truth.csv").write_text("query_s,reference_s\n0,0\n1000,1000\n")
    (tmp_path / "sweep.toml").write_text(PLAN)
    return tmp_path / "sweep.toml"


def swept(plan_file, workers, folder, run=run_trial, **more):
    store = sweep_store(folder)
    with store.opened():
        return store, trials.compute(read_plan(plan_file).trials(), run, store, workers, **more)


def test_a_plan_is_variants_times_drives_times_seeds(plan_file):
    plan = read_plan(plan_file)
    assert list(plan.variants) == ["pixels=3", "pixels=5", "again"]
    assert plan.variants["pixels=3"].tau_us == 100_000
    trials = list(plan.trials())
    assert [(one.variant, one.seed) for one in trials[:3]] == [
        ("pixels=3", 1), ("pixels=3", 2), ("pixels=5", 1)
    ]  # fmt: skip
    assert len(trials) == 6
    # two names of the same settings are one result
    assert len({one.key for one in trials}) == 4


def test_a_plan_runs_rivals_beside_variants(plan_file, tmp_path):
    plan_file.write_text(
        PLAN.replace("pixels = [3, 5]", 'system = ["all-pixels", "active-pixels@1,2"]').replace(
            "pixels = 5", 'matching = "filter"\nsystem = "all-pixels"'
        )
    )
    plan = read_plan(plan_file)
    assert plan.systems == {
        "system=all-pixels": "all-pixels",
        "system=active-pixels@1,2": "active-pixels@1,2",
        "again": "all-pixels",
    }
    keys = [one.key for one in plan.trials() if one.seed == 1]
    assert len(set(keys)) == 3
    store, _ = swept(plan_file, Inline(), tmp_path / "run")
    by_sequence, _, by_filter = (store.result(key) for key in keys)
    drives = plan.drives["evening"]
    short = PRESETS["paper"].replaced({"tau_us": 100_000}, "test")
    pair = Pair("", drives.open(0), drives.open(1), short, drives.truths).counted()
    places, queries = pair.reference, pair.query
    distances = [
        [naive.sad(p.ravel().tolist(), q.ravel().tolist()) for q in queries.images]
        for p in places.images
    ]
    settings = plan.variants["system=all-pixels"]
    matches = match_distances(np.array(distances, float), queries.centre_us, settings)
    found = evaluate(matches, pair.truth())
    assert by_sequence.precision_at_100_recall == found.precision_at_100_recall
    assert by_sequence.bytes_per_place == by_sequence.pixels == 16 * 12
    assert by_sequence.operations == len(places.images) * 16 * 12
    assert by_filter.precision_at_100_recall != by_sequence.precision_at_100_recall
    rows = {row.variant: row for row in rows_of([tmp_path / "run"])}
    assert rows["again"].system == "all-pixels"
    head, lines = comparison.spreadsheet_of(list(rows.values()))
    assert {line[head.index("system")] for line in lines} == set(plan.systems.values())


def test_weights_of_a_rival_are_found_from_the_plan_and_are_part_of_the_key(
    plan_file, tmp_path, monkeypatch
):
    weights = tmp_path / "net.onnx"
    weights.write_bytes(b"1")
    monkeypatch.setattr(
        "edge_vpr_tools.research.baselines.networks.model",
        lambda seed, file: open_baseline("all-pixels"),
    )
    plan_file.write_text(PLAN.replace("pixels = 5", 'system = "model:net.onnx@1,2"', 1))

    def keys():
        return {one.key for one in read_plan(plan_file).trials()}

    before = keys()
    assert read_plan(plan_file).systems["again"] == f"model:{weights}@1,2"
    assert keys() == before
    weights.write_bytes(b"2")
    assert len(keys() - before) == 2
    for system, says in (('"hoq"', "'hoq' is unknown: did you mean hog"), ("3", "system is 3")):
        plan_file.write_text(PLAN.replace("pixels = 5", f"system = {system}", 1))
        with pytest.raises(UsageError, match=rf"variants.again: .*{says}"):
            read_plan(plan_file)


def test_a_key_is_of_settings_contents_and_version_and_not_of_names(plan_file, tmp_path):
    def keys():
        return [one.key for one in read_plan(plan_file).trials()]

    before = keys()
    (tmp_path / "monday.npz").rename(tmp_path / "moved.npz")
    plan_file.write_text(PLAN.replace("monday", "moved").replace("evening", "other"))
    assert keys() == before
    plan_file.write_text(PLAN.replace("monday", "moved").replace("0.2", "0.3"))
    assert not set(keys()) & set(before)
    plan_file.write_text(PLAN.replace("monday", "moved"))
    (tmp_path / "truth.csv").write_text("query_s,reference_s\n0,0\n1000,1001\n")
    assert not set(keys()) & set(before)
    trial, *_ = read_plan(plan_file).trials().values()
    assert replace(trial, version="9.9.9").key != trial.key
    with pytest.raises(UsageError, match=r"and the sweep is of 9\.9\.9"):
        run_trial(replace(trial, version="9.9.9"))


def test_drives_are_read_from_and_up_to_the_seconds_of_the_plan(plan_file):
    more = 'start = ["0.1", "0"]\nend = [1.0, 1.2]\nsensor = "16x12"\n'
    plan_file.write_text(PLAN + more)
    drives = read_plan(plan_file).drives["evening"]
    reference, query = drives.open(0), drives.open(1)
    assert max(chunk["t"].max() for chunk in reference) < 900_000
    assert 900_000 < max(chunk["t"].max() for chunk in query) < 1_200_000
    plan_file.write_text(PLAN + f'start_offset = ["{reference.start_us / 1e6:.6f}", "0"]\n')
    late = read_plan(plan_file).drives["evening"].open(0)
    assert late.start_us == reference.start_us


def test_a_folder_is_hashed_by_names_and_contents(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "a").write_text("1")
    first = content_hash(folder)
    (folder / "a").rename(folder / "b")
    second = content_hash(folder)
    (folder / "b").write_text("2")
    assert len({first, second, content_hash(folder)}) == 3
    with pytest.raises(UsageError, match="cannot be read"):
        content_hash(tmp_path / "none")


LONG_GRID = f"pixels = {list(range(1, 951))}\nsequence_length = {list(range(1, 1_001))}"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[grid]\npixels = [3, 5]", "[grid]\npixels = 3", "give a list of values"),
        ("pixels = [3, 5]", "pixel = [3, 5]", "did you mean pixels"),
        ("pixels = [3, 5]", "pixels = [-3]", "grid"),
        ("seeds = [1, 2]", "seeds = [1, 1]", "different whole numbers"),
        ("seeds = [1, 2]", "seeds = 0", "different whole numbers"),
        ("seeds = [1, 2]", "seed = 4", "did you mean seeds"),
        ("sigma = 1.0", "seed = 1", "name the seeds of all variants"),
        ("tolerance = 0.2", "tolerances = 0.2", "did you mean tolerance"),
        ("tolerance = 0.2", 'tolerance = "x"', "tolerance"),
        ('query = "tuesday.npz"', "", "lacks query"),
        ("seeds = [1, 2]", "seeds = 1000000", "more than 100,000 trials"),
        ("pixels = [3, 5]", LONG_GRID, "more than 100,000 trials"),
        ("pixels = [3, 5]", "pixels = []\nsigma = [1.0]", "give a list of values"),
        ("[drives.evening]", "[driven.evening]", "did you mean drives"),
        (
            "pixels = 5\n",
            'preset = "default"\nplaces_per_window = 2\nsystem = "all-pixels"\n',
            "variants.again: setting places_per_window = 2 with system = all-pixels",
        ),
    ],
)
def test_a_wrong_plan_is_one_clear_error(old, new, words, plan_file):
    assert old in PLAN
    plan_file.write_text(PLAN.replace(old, new))
    with pytest.raises(UsageError, match=words):
        read_plan(plan_file)


def test_nothing_is_computed_twice_and_an_interrupted_sweep_goes_on(plan_file, tmp_path):
    workers, seen = Counted(), []

    def stop_after_two(trial):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(trial)
        return run_trial(trial)

    with pytest.raises(KeyboardInterrupt):
        swept(plan_file, workers, tmp_path / "out", run=stop_after_two)
    kept = sum(1 for _ in (tmp_path / "out/results").iterdir())
    assert kept <= 2
    store, done = swept(plan_file, workers, tmp_path / "out")
    assert (done.trials, done.different, done.known) == (6, 4, kept)
    assert done.computed == 4 - kept
    jobs = workers.jobs
    assert swept(plan_file, workers, tmp_path / "out")[1].known == 4
    assert workers.jobs == jobs
    # a lost or added variant leaves the others as they are
    plan_file.write_text(PLAN.replace("[3, 5]", "[5, 4]"))
    assert swept(plan_file, workers, tmp_path / "out")[1].computed == 2
    assert not failures(store)


def test_failures_are_kept_shown_and_computed_again_when_asked(plan_file, tmp_path):
    plan_file.write_text(PLAN.replace("pixels = [3, 5]", "sequence_length = [3, 50]"))
    store, done = swept(plan_file, Inline(), tmp_path / "out")
    assert (done.computed, done.failed) == (4, 2)
    (trial, error), _ = failures(store)
    assert "a sequence of 50 windows does not fit" in error
    assert trial.variant == "sequence_length=50"
    kept = json.loads((tmp_path / "out/failures" / f"{trial.key}.json").read_text())
    assert "Traceback" in kept["where"]
    assert kept["trial"]["settings"]["sequence_length"] == 50
    assert swept(plan_file, Inline(), tmp_path / "out")[1].known == 6
    assert swept(plan_file, Inline(), tmp_path / "out", retry_failed=True)[1].failed == 2
    rows = {row.variant: row for row in rows_of([tmp_path / "out"])}
    assert rows["sequence_length=50"].failed == 2
    assert len(rows["sequence_length=3"].values["recall_at_1"]) == 2


def test_a_folder_takes_one_sweep_at_a_time_and_is_never_somebody_elses(plan_file, tmp_path):
    store = sweep_store(tmp_path / "out")
    (tmp_path / "out/.edge-vpr-0123456789abcdef.part").mkdir(parents=True)  # a sweep.json to be
    with store.opened(), pytest.raises(UsageError, match="another sweep writes"), store.opened():
        pass
    with (
        pytest.raises(UsageError, match="not the folder of a sweep"),
        sweep_store(tmp_path).opened(),
    ):
        pass


def test_damaged_files_of_a_sweep_are_errors_with_a_remedy(plan_file, tmp_path):
    store, _ = swept(plan_file, Inline(), tmp_path / "out")
    path = next((tmp_path / "out/results").iterdir())
    path.write_text(path.read_text()[:-40])
    with pytest.raises(UsageError, match="remove it, and the sweep computes it again"):
        store.result(path.stem)
    path.unlink()
    assert swept(plan_file, Inline(), tmp_path / "out")[1].computed == 1


def test_a_result_under_the_key_of_another_trial_is_refused(plan_file, tmp_path):
    """Copied over it, or with its key changed as well: its shares are those of another trial."""
    store, _ = swept(plan_file, Inline(), tmp_path / "out")
    one, other, *_ = sorted((tmp_path / "out/results").iterdir())
    whole = one.read_text()
    for changed in (other.read_text(), other.read_text().replace(other.stem, one.stem)):
        one.write_text(changed)
        for read in (
            lambda: swept(plan_file, Inline(), tmp_path / "out"),
            lambda: rows_of([tmp_path / "out"]),
            lambda: store.result(one.stem),
        ):
            with pytest.raises(UsageError, match="holds another trial than its name says"):
                read()
    one.write_text(whole)
    failure = tmp_path / "out/failures" / one.name
    failure.write_text(
        json.dumps(
            {"key": other.stem, "trial": json.loads(whole)["trial"], "error": "", "schema": 1}
        )
    )
    with pytest.raises(UsageError, match="holds another trial"):
        store.failure(one.stem)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_json_does_not_have_are_refused(plan_file, tmp_path, number):
    store, _ = swept(plan_file, Inline(), tmp_path / "out")
    path = next((tmp_path / "out/results").iterdir())
    path.write_text(re.sub('("recall_at_1": )[^,]*', rf"\g<1>{number}", path.read_text()))
    with pytest.raises(UsageError, match=f"{number} is not a finite number: remove it"):
        store.result(path.stem)


def test_a_worker_of_this_machine_may_die(tmp_path):
    jobs = {number: (number, str(tmp_path)) for number in range(6)}
    with processes(2) as workers:
        found = {one.key: one for one in run_all(jobs, sweep_jobs.kill_worker_once, workers)}
        assert {key: one.result for key, one in found.items()} == {n: n for n in range(6)}
        # one that always dies takes no other with it
        numbers = {number: number for number in range(6)}
        found = {one.key: one for one in run_all(numbers, sweep_jobs.kill_worker_always, workers)}
        assert "worker died" in found.pop(3).error
        assert all(one.result == key for key, one in found.items())
        found = {one.key: one for one in run_all(numbers, sweep_jobs.refuse, workers)}
        assert found[3].error == "internal error, ValueError: three is refused"
        assert "in refuse" in found[3].where
        found = {one.key: one for one in run_all(numbers, sweep_jobs.lack_a_library, workers)}
        assert found[3].error.startswith("a third job needs the library no_library, which is not")
    with pytest.raises(UsageError, match="1 or more"), processes(0):
        pass


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_started_them(tmp_path, number):
    """They stayed for ever, busy or not."""
    code = (
        "import sweep_jobs\n"
        "from edge_vpr_tools.research.trials import processes\n"
        "with processes(2) as workers:\n"
        "    workers.submit(sweep_jobs.double, 1).result()\n"
        f"    workers.submit(sweep_jobs.wait_for_ever, {str(tmp_path)!r})\n"
        f"    workers.submit(sweep_jobs.wait_for_ever, {str(tmp_path)!r}).result()\n"
    )
    paths = f"{ROOT}:{ROOT / 'tools'}:{ROOT / 'tests/research'}"
    # what is left of the run keeps the pipe open
    with subprocess.Popen(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True,
    ) as run:  # fmt: skip
        try:
            end = time.monotonic() + 60
            while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < end:
                time.sleep(0.05)
            assert len(list(tmp_path.iterdir())) == 2
            run.send_signal(number)
            out, _ = run.communicate(timeout=60)
            assert out == b""
            assert run.returncode == -number
        finally:
            with suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def scheduler():
    distributed = pytest.importorskip("distributed", reason="Dask is an extra (dask)")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as made:
        yield made.scheduler_address


@pytest.mark.slow
def test_a_worker_of_a_cluster_may_die_in_mid_run(plan_file, tmp_path, scheduler):
    import distributed

    killed = []

    def kill_one(done, of, failed):
        if not killed and done:
            with distributed.Client(scheduler, set_as_default=False) as client:
                pids = client.run(os.getpid)
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)

    with cluster(scheduler) as workers:
        store, done = swept(
            plan_file, workers, tmp_path / "far", progress=kill_one, run=sweep_jobs.slow_trial
        )
    assert killed
    assert (done.computed, done.failed, done.workers) == (4, 0, 2)
    # the same as here, but for the times that it took
    near, _ = swept(plan_file, Inline(), tmp_path / "near")
    times = dict.fromkeys(("mapping_s", "counting_s", "microseconds_per_match", "elapsed_s"), 0.0)
    for trial in store.listed():
        far, here = store.result(trial.key), near.result(trial.key)
        assert replace(far, **times) == replace(here, **times)


def test_a_cluster_keeps_failures_as_this_machine_does(scheduler):
    numbers = {number: number for number in range(6)}
    with cluster(scheduler) as workers:
        found = {one.key: one for one in run_all(numbers, sweep_jobs.refuse, workers)}
    assert found[3].error == "internal error, ValueError: three is refused"
    assert sorted(one.result for one in found.values() if not one.error) == [0, 1, 2, 4, 5]


def test_the_page_starts_no_cluster_that_listens_to_strangers():
    """Dask runs what it is sent; by default it listens on all networks."""
    page = (Path(__file__).parents[2] / "docs/sweep.md").read_text()
    commands = re.findall(r"^.*\bdask (scheduler|worker) (.*)$", page, re.MULTILINE)
    assert len(commands) == 4
    for program, words in commands:
        assert "--host 127.0.0.1" in words or "--tls-ca-file" in words
        assert ("--dashboard-address 127.0.0.1:" in words) == (program == "scheduler")


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    pytest.importorskip("distributed", reason="Dask is an extra (dask)")
    monkeypatch.setattr("edge_vpr_tools.research.trials._TIMEOUT_S", 0.5)
    with (
        pytest.raises(UsageError, match="no Dask scheduler answers"),
        cluster("tcp://127.0.0.1:9"),
    ):
        pass


def a_match(folder, costs=None, **changed):
    """Write the records of an evaluated match, with a setting changed."""
    folder.mkdir()
    shares = dict.fromkeys(list(comparison.MEASURES)[:3], 0.5)
    metrics = {"evaluation": shares | {"recall_at": {"1": 0.5}, "queries": 9}, **(costs or {})}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    write_json(folder / "run.json", run_record({"seed": 1, "tau_us": 5} | changed, []))
    return folder


@pytest.mark.parametrize(
    "changed",
    [{"seed": None}, {"tau_us": 0.5}],
)
def test_a_changed_record_of_a_match_is_named(tmp_path, capsys, changed):
    run = a_match(tmp_path / "run", **changed)
    assert cli.main(["compare", str(run), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert f"run.json: setting {next(iter(changed))}" in said.replace("tau =", "tau_us =")


@pytest.mark.parametrize(
    ("name", "at", "value", "says"),
    [
        ("run.json", ["command"], 3, "command is 3: expected a list"),
        ("run.json", ["settings"], [1], "settings holds a list"),
        ("metrics.json", ["evaluation"], [0.5], "evaluation holds a list"),
        ("metrics.json", ["evaluation", "recall_at"], {"1": "x"}, "recall_at.1 is 'x'"),
        ("metrics.json", ["evaluation", "average_precision"], 10**400, "expected a smaller number"),
        ("metrics.json", ["evaluation"], {}, "evaluation lacks precision_at_100_recall"),
        ("metrics.json", ["packed_bytes_per_place"], True, "expected an integer"),
    ],
)
def test_a_field_of_a_wrong_type_ends_a_comparison_in_one_line(
    tmp_path, capsys, name, at, value, says
):
    run = a_match(tmp_path / "run")
    changed = json.loads((run / name).read_text())
    place = changed
    for step in at[:-1]:
        place = place[step]
    place[at[-1]] = value
    (run / name).write_text(json.dumps(changed))
    assert cli.main(["compare", str(run)]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert f"run/{name}: " in said
    assert says in said


@pytest.mark.parametrize(
    ("preset", "changes", "differences", "size"),
    [
        ("paper", {}, 5 * 7, 3),
        ("paper", {"polarity": True}, 2 * 5 * 7, 3),  # a pixel has two counters
        ("default", {"places_per_window": 2}, 5 * 7, 2 * 3),
    ],
)
def test_costs_of_a_match_count_counters_and_the_places_of_a_window(
    tmp_path, preset, changes, differences, size
):
    costs = {"pixels": 5, "places": 7, "packed_bytes_per_place": 3, "queries": 2, "matching_s": 0.5}
    settings = PRESETS[preset].replaced(changes, "test").to_dict()
    (row,) = rows_of([a_match(tmp_path / "run", costs, **settings)])
    assert row.values["differences_per_match"] == (differences,)
    assert row.values["packed_bytes_per_window"] == (size,)
    assert row.values["microseconds_per_match"] == (250_000,)
    assert row.values["queries"] == (9,)  # that were judged


def test_what_a_run_does_not_say_of_a_setting_is_its_default(tmp_path):
    """A comparison over it ended in an internal error."""
    runs = [a_match(tmp_path / "a", pixels=9), a_match(tmp_path / "b")]
    words = [*map(str, runs), "-o", str(tmp_path / "out"), "--over", "pixels"]
    assert cli.main(["compare", *words]) == 0
    lines = (tmp_path / "out/compare.csv").read_text().splitlines()
    column = lines[0].split(",").index("pixels")
    assert [line.split(",")[column] for line in lines[1:]] == ["9", str(Settings().pixels)]


@pytest.mark.parametrize(
    ("kind", "at", "value"),
    [
        ("results", ["trial", "settings", "none"], 1),
        ("results", ["found", "places"], "x"),
        ("sweep.json", ["trials"], 5),
    ],
)
def test_a_field_of_a_wrong_type_in_a_sweep_ends_in_one_line(
    plan_file, tmp_path, capsys, kind, at, value
):
    swept(plan_file, Inline(), tmp_path / "out")
    files = [tmp_path / "out/sweep.json"]
    if kind == "results":
        files = sorted((tmp_path / "out/results").iterdir())
    for file in files:
        changed = json.loads(file.read_text())
        if "trial" in changed:
            changed["trial"]["version"] = "another"  # whose keys are made otherwise
        place = changed
        for step in at[:-1]:
            place = place[step]
        place[at[-1]] = value
        file.write_text(json.dumps(changed))
    capsys.readouterr()
    assert cli.main(["compare", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert "internal error" not in said
    assert at[-1] in said


def test_a_name_of_a_folder_is_text_in_markdown(tmp_path, capsys):
    run = a_match(tmp_path / "<img src=x>|[a](b)`_c_d_e")
    assert cli.main(["compare", str(run), "-o", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out/compare.md").read_text()
    assert r"| \<img src=x\>\|\[a\](b)\`\_c_d_e |" in page


@pytest.mark.slow
def test_the_commands_sweep_and_compare(plan_file, tmp_path, capsys):
    folder, output = tmp_path / "out", tmp_path / "compared"
    words = f"sweep {plan_file} -o {folder} --workers 1".split()
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    assert "| out | pixels=3 | evening | 0.2 s | 2 |" in said
    assert "0 were known, 4 computed now" in said
    assert cli.main(words) == 0
    assert "4 were known, 0 computed now" in capsys.readouterr().out

    command = f"match {tmp_path}/map.npz {tmp_path}/tuesday.npz -o {tmp_path}/alone --no-figures"
    assert cli.main(
        f"map {tmp_path}/monday.npz -o {tmp_path}/map.npz --preset paper --pixels 5 --sigma 1 "
        "--tau 100ms --seed 1".split()
    ) == 0  # fmt: skip
    assert cli.main(command.split()) == 0
    capsys.readouterr()
    assert cli.main(f"compare {tmp_path}/alone".split()) == 2
    assert "is not evaluated" in capsys.readouterr().err
    truth = f"--ground-truth {tmp_path}/truth.csv --tolerance 0.2"
    assert cli.main(f"evaluate {tmp_path}/alone {truth}".split()) == 0
    runs = f"compare {folder} {tmp_path}/alone -o {output} --figures pdf,svg"
    assert cli.main(runs.split()) == 0
    names = {path.name for path in output.iterdir()}
    kinds = {f"compare.{kind}" for kind in ("csv", "json", "md", "pdf", "svg", "tex")}
    assert names == kinds | {"compare_means.csv", "run.json"}
    with (output / "compare.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [(line["variant"], line["pixels"], line["seed"]) for line in lines] == [
        *(("pixels=3", "3", seed) for seed in "12"), *(("pixels=5", "5", seed) for seed in "12"),
        ("again", "5", "1"), ("again", "5", "2"), ("", "5", "1"),
    ]  # fmt: skip
    assert {line["tau"] for line in lines} == {"100ms"}
    shares = [line["precision_at_100_recall"] for line in lines]
    assert shares[2:4] == shares[4:6]
    capsys.readouterr()
    over = ["-o", str(tmp_path / "curve"), "--over"]
    assert cli.main(["compare", str(folder), *over, "pixels", "-q"]) == 0
    assert cli.main([*words, "-q"]) == 0
    assert capsys.readouterr() == ("", "")
    assert cli.main(["compare", str(folder), *over, "tau", "--overwrite"]) == 2
    assert "do not differ in tau: they differ in pixels" in capsys.readouterr().err
    assert cli.main(["compare", str(folder), "--over", "pixels"]) == 2
    capsys.readouterr()
    # the sweep is map, match and evaluate
    seed_1 = next(row for row in rows_of([folder]) if row.variant == "again")
    alone = rows_of([tmp_path / "alone"])[0]
    for measure in list(comparison.MEASURES)[:9]:
        assert seed_1.values[measure][0] == alone.values[measure][0]
    places = json.loads((tmp_path / "alone/metrics.json").read_text())["places"]
    assert alone.values["differences_per_match"] == (5 * places,)
    capsys.readouterr()
    assert cli.main(f"compare {tmp_path}".split()) == 2
    # two folders of one name are told apart, and a name out of a file is no escape sequence
    listed = folder / "sweep.json"
    listed.write_text(listed.read_text().replace('"again"', '"a\\u001b[2J|b"'))
    (tmp_path / "other").mkdir()
    (tmp_path / "alone").rename(tmp_path / "other/out")
    capsys.readouterr()
    assert cli.main(f"compare {folder} {tmp_path}/other/out".split()) == 0
    said = capsys.readouterr().out
    assert f"| {folder} | pixels=3 |" in said
    assert f"| {tmp_path}/other/out |  |" in said
    assert r"a\\x1b\[2J\|b" in said  # each mark of Markdown is escaped, too


def test_a_name_is_no_formula_of_a_figure_or_a_spreadsheet(tmp_path):
    """A spreadsheet computes what begins with =, and figures set what stands between dollars."""
    values = dict.fromkeys(comparison.MEASURES, (0.5, 0.25))
    rows = [
        comparison.Row(run=name, variant="@x", drives="d", values=values, seeds=(0, 1))
        for name in ("=1+1", r"a$\frac{$", "_b", "c\x1b[2J")
    ]
    write_comparison(tmp_path, rows, ["svg"], "precision_at_100_recall")
    with (tmp_path / "compare.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [line["run"] for line in lines[::2]] == ["'=1+1", r"a$\frac{$", "_b", r"c\x1b[2J"]
    assert {line["variant"] for line in lines} == {"'@x"}
    assert [line["precision_at_100_recall"] for line in lines[:2]] == ["0.5", "0.25"]
    assert (tmp_path / "compare.svg").exists()


def test_only_the_best_of_many_rows_are_drawn(monkeypatch):
    monkeypatch.setattr(comparison, "MOST_DRAWN", 3)
    rows = [
        comparison.Row(
            run="r", variant=f"{n}", drives="d", values=dict.fromkeys(comparison.MEASURES, (n, n))
        )
        for n in range(5)
    ]
    drawing = draw(rows)
    assert isinstance(drawing, Figure)
    (axes,) = drawing.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "r, 4, d",
        "r, 3, d",
        "r, 2, d",
    ]
    assert "the best 3 of 5" in axes.get_title()


#: names, levels and numbers of seeds
DRIVES = (("a", 0.5, 2), ("b", 0.7, 2), ("c", 0.9, 1), ("d", 0.6, 1), ("e", 0.8, 1))


def rows_over_drives():
    """Two variants that differ in their pixels, each on five drives with one or two seeds."""
    rows = []
    for pixels, more in ((25, 0.0), (150, 0.1)):
        settings = asdict(PRESETS["paper"].replaced({"pixels": pixels}, "test"))
        for drives, level, seeds in DRIVES:
            values = tuple(level + more + 0.01 * seed for seed in range(seeds))
            rows.append(
                comparison.Row(
                    run="r", variant=f"J={pixels}", drives=drives, seeds=tuple(range(seeds)),
                    settings=settings,
                    values=dict.fromkeys(comparison.MEASURES, values),
                )
            )  # fmt: skip
    return rows


def test_each_drive_counts_alike_in_a_mean_and_differences_are_of_pairs():
    """The drives differ more than the variants, so that only pairs show the difference."""
    measure = "precision_at_100_recall"
    first, second = comparison.averages(rows_over_drives(), measure)
    assert (first.drives, first.settings, first.difference) == (5, {"pixels": "25"}, None)
    assert first.means[measure] == pytest.approx((0.505 + 0.705 + 0.9 + 0.6 + 0.8) / 5)
    assert second.difference is not None
    assert second.difference.mean == pytest.approx(0.1)
    assert second.difference.low == pytest.approx(0.1)
    assert second.difference.high == pytest.approx(0.1)
    alone = comparison.averages(rows_over_drives()[4:6], measure)[1]
    assert alone.difference is None  # no drive in common


def test_the_interval_of_a_bootstrap_holds_the_mean_of_most_samples(monkeypatch):
    monkeypatch.setattr(comparison, "RESAMPLES", 1_000)
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(60):
        found = comparison.bootstrap(list(rng.normal(0.3, 1.0, (25, 1))))
        held += found.low <= 0.3 <= found.high
    assert 50 <= held < 60
    # four drives, or four seeds of one, are too few
    for few in ([np.array([0.1, 0.2])] * 4, [np.array([0.1, 0.2, 0.3, 0.4])]):
        assert np.isnan(comparison.bootstrap(few).low)
    alone = comparison.bootstrap([np.array([0.1, 0.2, 0.3, 0.4, 0.5])])
    assert alone.low < alone.mean < alone.high


def test_latex_has_a_column_for_each_setting_that_differs_and_escapes_names():
    rows = rows_over_drives()
    lines = comparison.latex(comparison.averages(rows, "recall_at_1"), "recall_at_1").split("\n")
    assert lines[2].startswith(r"pixels & drives & P@100R & R@99P & AP & Recall@1")
    assert lines[4].startswith("25 & 5 & $0.702$ &") and lines[4].endswith(r"-- \\")
    assert lines[5].endswith(r"& $+0.100$ [$+0.100$, $+0.100$] \\")
    assert all(line.count("&") == lines[2].count("&") for line in lines[4:6])
    same = [replace(row, settings={}, variant="50 %_$x") for row in rows[:3]]
    assert r"50 \%\_\$x & 3" in comparison.latex(
        comparison.averages(same, "recall_at_1"), "recall_at_1"
    )


def test_a_curve_over_a_setting_shows_the_means_over_drives():
    (axes,) = comparison.draw_over(rows_over_drives(), "recall_at_1", "pixels").axes
    (line,) = axes.get_lines()
    assert line.get_xdata().tolist() == [25, 150]
    assert line.get_ydata() == pytest.approx([0.702, 0.802])


def test_curves_are_named_by_what_tells_them_apart_in_whole_words():
    """In several lines, if need be; an interval that is not there is not promised."""
    rows = []
    for row in rows_over_drives()[:2] + rows_over_drives()[5:7]:
        for restart in (4, 8):
            of = {"filter_restart": restart, "matching": "filter", "smooth": restart == 4}
            rows.append(replace(row, settings={**row.settings, **of}))
    (axes,) = (drawing := comparison.draw_over(rows, "recall_at_1", "pixels")).axes
    assert axes.get_title() == "Mean over drives"
    labels = [text.get_text() for text in drawing.legends[0].get_texts()]
    assert len(labels) == 2 and not any("r, " in label or "..." in label for label in labels)
    (long,) = comparison._apart([("a setting 1",) * 20])
    assert long.replace("\n", " ") == ", ".join(["a setting 1"] * 20)
    assert comparison.lacks_intervals(rows, "recall_at_1")
    assert not comparison.lacks_intervals(rows_over_drives(), "recall_at_1")


def test_no_title_of_a_comparison_is_cut():
    rows = [replace(row, variant="a long name of a variant " * 4) for row in rows_over_drives()]
    for drawing in (draw(rows, "differences_per_match"),
                    comparison.draw_over(rows, "differences_per_match", "pixels")):  # fmt: skip
        drawing.draw_without_rendering()
        (axes,) = drawing.axes
        title = axes.title.get_window_extent()
        assert title.x0 >= 0 and title.x1 <= drawing.bbox.width
        assert title.y1 <= drawing.bbox.height


def test_wrong_use_of_workers_is_refused(plan_file, tmp_path, capsys):
    words = f"sweep {plan_file} -o {tmp_path}/out --workers 2 --scheduler tcp://x:1"
    assert cli.main(words.split()) == 2
    assert "leave one out" in capsys.readouterr().err
    assert issubclass(UsageError, EdgeVprError)


def test_a_sweep_judges_by_several_tolerances_and_matches_once(plan_file, tmp_path):
    one = plan_file.read_text()
    plan_file.write_text(one.replace("tolerance = 0.2", "tolerance = [0.2, 0.35]"))
    workers = Counted()
    swept(plan_file, workers, tmp_path / "several")
    assert workers.jobs == 4  # of two variants and two seeds
    rows = rows_of([tmp_path / "several"])
    assert [row.tolerance for row in rows] == ["0.2 s", "0.35 s"] * 3
    for tolerance in ("0.2", "0.35"):
        plan_file.write_text(one.replace("tolerance = 0.2", f"tolerance = {tolerance}"))
        swept(plan_file, Inline(), tmp_path / tolerance)
        alone = rows_of([tmp_path / tolerance])
        for row, single in zip(
            [r for r in rows if r.tolerance == f"{tolerance} s"], alone, strict=True
        ):
            for measure in list(comparison.MEASURES)[:SHARES]:
                assert row.values[measure] == single.values[measure]
    assert rows[1].mean("recall_at_1") > rows[0].mean("recall_at_1")
    assert rows[0].mean("recall_at_10") > rows[0].mean("recall_at_1")
    found = comparison.averages(rows, "recall_at_5")
    assert [one.tolerance for one in found] == ["0.2 s", "0.35 s"] * 3
    # a variant is compared with the first one by the same tolerance
    assert [one.difference is None for one in found] == [True, True, False, False, False, False]
    write_comparison(tmp_path, rows, ["svg"], "recall_at_5", over="pixels")
    assert "tolerance" in (tmp_path / "compare.tex").read_text()
