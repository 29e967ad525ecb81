"""Sweeps: each trial once, on this machine or on a cluster; comparisons of what was measured."""

from __future__ import annotations

import csv
import os
import re
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools.sweep import MEASURES, comparison
from edge_vpr_tools.sweep.comparison import draw, rows_of, write_comparison
from edge_vpr_tools.sweep.plan import read_plan
from edge_vpr_tools.sweep.table import SETTINGS, read_lines
from edge_vpr_tools.sweep.trial import fastest, run_trial
from edge_vpr_tools.workers import cluster, error_text, mapped, processes

from edge_vpr.errors import EdgeVprError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings import write_recording
from edge_vpr.settings import PRESETS, setting_words
from tests.live.devices import wait_until
from tests.streams import random_events
from tests.tools import sweep_jobs

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


@pytest.fixture
def plan_file(tmp_path):
    rng = np.random.default_rng(0)
    for name in ("monday", "tuesday"):
        events = random_events(rng, 2_000, Sensor(16, 12), 1_500_000)
        write_recording(tmp_path / f"{name}.npz", [events], sensor=Sensor(16, 12))
    (tmp_path / "truth.csv").write_text("query_s,reference_s\n0,0\n1000,1000\n")
    (tmp_path / "sweep.toml").write_text(PLAN)
    return tmp_path / "sweep.toml"


@pytest.fixture(autouse=True)
def workers_of_this_process(monkeypatch):
    """Processes take two seconds to start; tests that are about them start their own."""
    monkeypatch.setattr("edge_vpr_tools.workers.processes", lambda count: ThreadPoolExecutor(1))


@pytest.fixture
def sweep(run, plan_file):
    """Run the command; return the rows of its file, and what it printed."""

    def sweep(output, *words, code=0):
        printed = run("sweep", plan_file, "-o", output, *words, code=code)
        return read_lines(output) if output.exists() else [], printed

    return sweep


def without_times(lines):
    return sorted(
        tuple(cell for name, cell in line.items() if name != "microseconds_per_match")
        for line in lines
    )


def test_a_plan_is_variants_times_drives_times_seeds(plan_file):
    trials = read_plan(plan_file)
    named = [(one.variant, one.drives, one.settings.seed) for one in trials]
    variants = ("pixels=3", "pixels=5", "again")
    assert named == [(name, "evening", seed) for name in variants for seed in (1, 2)]
    assert (trials[0].settings.tau_us, trials[0].settings.pixels) == (100_000, 3)
    assert trials[0].pair.reference == str(plan_file.parent / "monday.npz")


def test_drives_are_read_from_and_up_to_the_seconds_of_the_plan(plan_file):
    more = 'start = ["0.1", "0"]\nend = [1.0, 1.2]\nsensor = "16x12"\n'
    plan_file.write_text(PLAN + more)
    drives = read_plan(plan_file)[0].pair
    reference, query = drives.open(0), drives.open(1)
    assert max(chunk["t"].max() for chunk in reference) < 900_000
    assert 900_000 < max(chunk["t"].max() for chunk in query) < 1_200_000
    plan_file.write_text(PLAN + f'start_offset = ["{reference.start_us / 1e6:.6f}", "0"]\n')
    late = read_plan(plan_file)[0].pair.open(0)
    assert late.start_us == reference.start_us


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
        ("pixels = 5\n", 'system = "hog"\n', "unknown name 'system'"),
    ],
)
def test_a_wrong_plan_is_one_clear_error(old, new, words, plan_file):
    assert old in PLAN
    plan_file.write_text(PLAN.replace(old, new))
    with pytest.raises(UsageError, match=words):
        read_plan(plan_file)


def test_a_sweep_is_resumed_where_its_file_ends(plan_file, tmp_path, sweep):
    """Stopped after some trials, with a plan that has grown since."""
    whole, _ = sweep(tmp_path / "whole.csv")
    assert len(whole) == 6
    some = tmp_path / "some.csv"
    head, *rows = (tmp_path / "whole.csv").read_text().splitlines(True)
    some.write_text("".join([head, *rows[-2:]]))
    kept = some.read_text()
    times = [line["microseconds_per_match"] for line in read_lines(some)]
    assert f"output {some} exists" in sweep(some, code=2)[1].err
    sweep(some, "--resume", "--overwrite", code=2)
    assert some.read_text() == kept
    resumed, shown = sweep(some, "--resume")
    assert without_times(resumed) == without_times(whole)
    # in the order of the plan, since a comparison is with the first variant
    assert [line["microseconds_per_match"] for line in resumed[-2:]] == times
    assert [line["variant"] for line in resumed] == [line["variant"] for line in whole]
    assert "6 trials, 4 of them computed now" in shown.out
    progress = re.findall(r", evening, seed \d: trial (\d) of 4, after \d+ s\n", shown.err)
    assert progress == ["1", "2", "3", "4"]
    plan_file.write_text(PLAN.replace("[3, 5]", "[3, 5, 4]"))
    rows, shown = sweep(some, "--resume")
    assert len(rows) == 8 and "8 trials, 2 of them computed now" in shown.out
    # a file that has other settings under the same name is not gone on with
    plan_file.write_text(PLAN.replace("sigma = 1.0", "sigma = 2.0"))
    _, shown = sweep(some, "--resume", code=2)
    assert "has pixels=3 on evening with sigma = 1, and it is 2 now" in shown.err
    assert len(sweep(some, "--overwrite")[0]) == 6


def test_a_trial_is_map_match_and_evaluate_on_two_drives(plan_file, tmp_path, sweep):
    (first, *_) = read_plan(plan_file)
    (row,) = run_trial(first)
    (line, *_) = sorted(sweep(tmp_path / "out.csv")[0], key=lambda line: line["seed"])
    for name in list(comparison.MEASURES)[:9]:
        assert float(line[name]) == row[name]
    assert row["tolerance"] == line["tolerance"] == "0.2 s"
    gone = replace(first.pair, query=str(tmp_path / "none.npz"))
    with pytest.raises(UsageError, match=r"none\.npz is not there"):
        run_trial(first._replace(pair=gone))


def test_a_failed_trial_stops_no_other_and_is_tried_again(plan_file, tmp_path, sweep):
    plan_file.write_text(PLAN.replace("pixels = [3, 5]", "sequence_length = [3, 50]"))
    lines, (_, said) = sweep(tmp_path / "out.csv", code=1)
    assert {line["variant"] for line in lines} == {"sequence_length=3", "again"}
    assert "sequence_length=50, evening, seed 2: a sequence of 50 windows does not fit" in said
    assert "6 trials, 4 of them computed now, 2 failed: --resume tries these again" in said
    _, (_, said) = sweep(tmp_path / "out.csv", "--resume", code=1)
    assert "6 trials, 0 of them computed now, 2 failed" in said
    (tmp_path / "monday.npz").rename(tmp_path / "moved.npz")
    lines, (_, said) = sweep(tmp_path / "none.csv", code=1)
    assert lines == [] and "monday.npz is not there" in said and "internal error" not in said


def test_a_file_takes_one_sweep_at_a_time_and_is_never_somebody_elses(plan_file, tmp_path, refused):
    from edge_vpr_tools.sweep.table import appending

    with (
        appending(tmp_path / "out.csv"),
        pytest.raises(UsageError, match="another sweep writes"),
        appending(tmp_path / "out.csv"),
    ):
        pass
    truth = tmp_path / "truth.csv"
    before = truth.read_bytes()
    assert "does not end in .csv" in refused("sweep", plan_file, "-o", tmp_path / "out.txt")
    said = refused("sweep", plan_file, "-o", truth, "--resume")
    assert "truth.csv is not the file of a sweep" in said
    assert truth.read_bytes() == before


@pytest.mark.parametrize(
    "damage",
    [lambda text: text[:-9], lambda text: text + "x\n", lambda text: text.replace(",10.0,", ",,")],
)
def test_a_damaged_row_is_named(tmp_path, sweep, refused, damage):
    out = tmp_path / "out.csv"
    sweep(out)
    out.write_text(damage(out.read_text()))
    said = refused("compare", out)
    assert re.search(r"out\.csv, row \d lacks a column or a number: delete", said)


def test_an_error_of_a_job_is_one_line_and_a_dead_worker_ends_the_run(tmp_path):
    with processes(2) as workers:
        ended = dict(mapped(workers, sweep_jobs.double, range(6)))
        assert ended == {number: 2 * number for number in range(6)}
        ended = dict(mapped(workers, sweep_jobs.refuse, range(6)))
        assert error_text(ended.pop(3)) == "internal error, ValueError: three is refused"
        assert ended == {number: number for number in (0, 1, 2, 4, 5)}
        ended = dict(mapped(workers, sweep_jobs.lack_a_library, range(6)))
        assert "needs the library no_library, which is not" in error_text(ended[3])
    with (
        pytest.raises(EdgeVprError, match=r"a worker died.* fewer --workers, with --resume"),
        processes(2) as workers,
    ):
        list(mapped(workers, sweep_jobs.kill_worker, range(6)))
    with pytest.raises(UsageError, match="1 or more"), processes(0):
        pass


@pytest.mark.parametrize("whole_group", [False, True])
def test_an_interrupt_ends_a_sweep_and_keeps_what_is_finished(plan_file, tmp_path, whole_group):
    """Workers printed tracebacks on a terminal."""
    plan_file.write_text(PLAN.replace("seeds = [1, 2]", "seeds = 500"))
    out = tmp_path / "out.csv"
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from edge_vpr_tools.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", code, "sweep", plan_file, "-o", out, "--workers", "2"]
    with subprocess.Popen(
        words, start_new_session=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as run:
        wait_until(lambda: out.exists() and out.read_text().count("\n") >= 4, 240)
        (os.killpg if whole_group else os.kill)(run.pid, signal.SIGINT)
        _, said = run.communicate(timeout=60)
    assert run.returncode == 130
    *trials, last = said.splitlines()
    assert "interrupted" in last and all(": trial " in line for line in trials)
    finished = read_lines(out)
    assert 3 <= len(finished) < 1_500


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_started_them(tmp_path, number):
    """They stayed for ever, busy or not."""
    code = (
        # under nohup, a process ignores it
        "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        "from tests.tools import sweep_jobs\n"
        "from edge_vpr_tools.workers import processes\n"
        "with processes(2) as workers:\n"
        "    workers.submit(sweep_jobs.double, 1).result()\n"
        f"    workers.submit(sweep_jobs.wait_for_ever, {str(tmp_path)!r})\n"
        f"    workers.submit(sweep_jobs.wait_for_ever, {str(tmp_path)!r}).result()\n"
    )
    paths = f"{ROOT}:{ROOT / 'tools'}"
    # what is left of the run keeps the pipe open
    with subprocess.Popen(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True,
    ) as run:  # fmt: skip
        try:
            wait_until(lambda: len(list(tmp_path.iterdir())) == 2, 240)
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
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    ) as made:
        yield made.scheduler_address


def test_a_cluster_measures_what_this_machine_measures(tmp_path, sweep, scheduler):
    near, _ = sweep(tmp_path / "near.csv")
    far = tmp_path / "far.csv"
    assert without_times(sweep(far, "--scheduler", scheduler)[0]) == without_times(near)
    lines = far.read_text().splitlines(True)
    far.write_text("".join(lines[:4]))
    resumed, _ = sweep(far, "--scheduler", scheduler, "--resume")
    assert without_times(resumed) == without_times(near)


def test_a_worker_of_a_cluster_may_die_and_a_job_may_fail(scheduler):
    import distributed

    killed = []
    with cluster(scheduler) as workers:
        for number, result in mapped(workers, sweep_jobs.slow, range(8)):
            assert number == result
            if not killed:
                with distributed.Client(scheduler, set_as_default=False) as client:
                    killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)
        ended = dict(mapped(workers, sweep_jobs.refuse, range(6)))
    assert killed
    assert error_text(ended.pop(3)).startswith("internal error, ValueError: three")
    assert ended == {number: number for number in (0, 1, 2, 4, 5)}


def test_the_page_starts_no_cluster_that_listens_to_strangers():
    """Dask runs what it is sent; by default it listens on all networks."""
    page = (Path(__file__).parents[2] / "docs/laboratory.md").read_text()
    commands = re.findall(r"^.*\bdask (scheduler|worker) (.*)$", page, re.MULTILINE)
    assert len(commands) == 4
    for program, words in commands:
        assert "--host 127.0.0.1" in words or "--tls-ca-file" in words
        assert ("--dashboard-address 127.0.0.1:" in words) == (program == "scheduler")


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    pytest.importorskip("distributed", reason="Dask is an extra (dask)")
    monkeypatch.setattr("edge_vpr_tools.workers._TIMEOUT_S", 0.5)
    with pytest.raises(UsageError, match="no Dask scheduler answers"), cluster("tcp://127.0.0.1:9"):
        pass


def compared(folder):
    """The rows of a comparison."""
    with (folder / "compare.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_the_commands_sweep_and_compare(plan_file, tmp_path, run, refused, monkeypatch):
    monkeypatch.setattr("edge_vpr_tools.workers.processes", processes)
    swept, output = tmp_path / "out.csv", tmp_path / "compared"
    sweep = ["sweep", plan_file, "-o", swept, "--workers", 1]
    said = run(*sweep).out
    assert "run out.csv, drives evening, tolerance 0.2 s, seeds 2" in said
    assert "6 trials, 6 of them computed now" in said
    run("compare", swept, "-o", output, "--figures", "pdf,svg")
    names = {path.name for path in output.iterdir()}
    assert names == {"compare.csv", "compare.pdf", "compare.svg", "run.json"}
    lines = compared(output)
    assert [(line["variant"], line["pixels"]) for line in lines] == [
        ("pixels=3", "3"), ("pixels=5", "5"), ("again", "5"),
    ]  # fmt: skip
    shares = [line["precision_at_100_recall"] for line in lines]
    assert shares[1] == shares[2]
    assert run("compare", swept, "-o", tmp_path / "quiet", "-q") == ("", "")
    assert run(*sweep, "--resume", "-q") == ("", "")
    refused("compare", tmp_path)
    # two runs of one name are told apart, and a name out of a file is no escape sequence
    swept.write_text(swept.read_text().replace("again", "a\x1b[2J|b"))
    (tmp_path / "other").mkdir()
    other = shutil.copy(swept, tmp_path / "other")
    assert "\x1b[2J" not in run("compare", swept, other, "-o", output, "--overwrite").out
    lines = compared(output)
    assert [line["run"] for line in lines] == [str(swept)] * 3 + [str(other)] * 3
    assert lines[2]["variant"] == r"a\x1b[2J|b"


def test_a_name_is_no_formula_of_a_figure_or_a_spreadsheet(tmp_path):
    """A spreadsheet computes what begins with =, and figures set what stands between dollars."""
    rows = [
        row_of([0.5, 0.25], run=name, variant="@x")
        for name in ("=1+1", r"a$\frac{$", "_b", "c\x1b[2J")
    ]
    write_comparison(tmp_path, rows, ["svg"], "precision_at_100_recall")
    lines = compared(tmp_path)
    assert [line["run"] for line in lines] == ["'=1+1", r"a$\frac{$", "_b", r"c\x1b[2J"]
    assert {line["variant"] for line in lines} == {"'@x"}
    assert lines[0]["precision_at_100_recall"] == "0.375"
    assert (tmp_path / "compare.svg").exists()


def test_only_the_best_of_many_rows_are_drawn(monkeypatch):
    monkeypatch.setattr(comparison, "MOST_DRAWN", 3)
    (axes,) = draw([row_of([n, n], variant=f"{n}") for n in range(5)]).axes
    drawn = [label.get_text() for label in axes.get_yticklabels()]
    assert drawn == ["r, 4, d", "r, 3, d", "r, 2, d"]
    assert "the best 3 of 5" in axes.get_title()


def row_of(values, settings=PRESETS["paper"], **names):
    """A row whose measures all have these values, one a seed."""
    words = setting_words(settings.to_dict())
    return comparison.Row(
        **{"run": "r", "variant": "v", "drives": "d", "tolerance": ""} | names,
        seeds=tuple(range(len(values))),
        values=dict.fromkeys(comparison.MEASURES, np.array(values, dtype=np.float64)),
        settings={key: words[key] for key in SETTINGS},
    )


#: names, levels and numbers of seeds
DRIVES = (("a", 0.5, 2), ("b", 0.7, 2), ("c", 0.9, 1), ("d", 0.6, 1), ("e", 0.8, 1))


def rows_over_drives():
    """Two variants that differ in their pixels, each on five drives with one or two seeds."""
    return [
        row_of(
            [level + more + 0.01 * seed for seed in range(seeds)],
            PRESETS["paper"].replaced({"pixels": pixels}, "test"),
            variant=f"J={pixels}",
            drives=drives,
        )
        for pixels, more in ((25, 0.0), (150, 0.1))
        for drives, level, seeds in DRIVES
    ]


def test_each_drive_counts_alike_in_a_mean_and_differences_are_of_pairs():
    """The drives differ more than the variants, so that only pairs show the difference."""
    measure = "precision_at_100_recall"
    first, second = comparison.averages(rows_over_drives(), measure)
    assert (first.drives, first.settings, first.difference) == (5, {"pixels": "25"}, None)
    assert first.means[measure] == pytest.approx((0.505 + 0.705 + 0.9 + 0.6 + 0.8) / 5)
    between = second.difference
    assert (between.mean, between.low, between.high) == pytest.approx((0.1, 0.1, 0.1))
    alone = comparison.averages(rows_over_drives()[4:6], measure)[1]
    assert alone.difference is None  # no drive in common


def test_the_interval_of_a_bootstrap_holds_the_mean_of_most_samples(monkeypatch):
    monkeypatch.setattr(comparison, "RESAMPLES", 1_000)
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(60):
        between = comparison.bootstrap(list(rng.normal(0.3, 1.0, (25, 1))))
        held += between.low <= 0.3 <= between.high
    assert 50 <= held < 60
    # four drives, or four seeds of one, are too few
    for few in ([np.array([0.1, 0.2])] * 4, [np.array([0.1, 0.2, 0.3, 0.4])]):
        assert np.isnan(comparison.bootstrap(few).low)
    alone = comparison.bootstrap([np.array([0.1, 0.2, 0.3, 0.4, 0.5])])
    assert alone.low < alone.mean < alone.high


def test_no_title_of_a_comparison_is_cut():
    rows = [row._replace(variant="a long name of a variant " * 4) for row in rows_over_drives()]
    drawing = draw(rows, "differences_per_match")
    drawing.draw_without_rendering()
    (axes,) = drawing.axes
    title = axes.title.get_window_extent()
    assert title.x0 >= 0 and title.x1 <= drawing.bbox.width
    assert title.y1 <= drawing.bbox.height


def test_a_sweep_judges_by_several_tolerances_and_matches_once(plan_file, tmp_path, sweep):
    one = plan_file.read_text()
    plan_file.write_text(one.replace("tolerance = 0.2", "tolerance = [0.2, 0.35]"))
    assert len(sweep(tmp_path / "several.csv")[0]) == 12
    rows = sorted(rows_of([tmp_path / "several.csv"]), key=lambda row: (row.variant, row.tolerance))
    assert [row.tolerance for row in rows] == ["0.2 s", "0.35 s"] * 3
    for tolerance in ("0.2", "0.35"):
        plan_file.write_text(one.replace("tolerance = 0.2", f"tolerance = {tolerance}"))
        sweep(tmp_path / f"{tolerance}.csv")
        alone = {row.variant: row for row in rows_of([tmp_path / f"{tolerance}.csv"])}
        for row in rows:
            for measure in MEASURES.keys() - {"microseconds_per_match"}:
                if row.tolerance == f"{tolerance} s":
                    single = alone[row.variant]
                    assert row.seeds == single.seeds
                    assert row.values[measure].tolist() == single.values[measure].tolist()
    means = [{name: of.mean() for name, of in row.values.items()} for row in rows]
    assert means[1]["recall_at_1"] > means[0]["recall_at_1"]
    assert means[0]["recall_at_10"] > means[0]["recall_at_1"]
    averages = comparison.averages(rows, "recall_at_5")
    assert [one.tolerance for one in averages] == ["0.2 s", "0.35 s"] * 3
    # a variant is compared with the first one by the same tolerance
    assert [one.difference is None for one in averages] == [True, True, False, False, False, False]


@pytest.mark.parametrize(
    ("ticks", "expected"),
    [
        ((0.0, 0.5, 1.0, 1.2, 2.0, 2.9), (3, pytest.approx(0.2))),
        # work that takes longer than a second is done twice
        ((0.0, 5.0, 10.0, 12.0), (2, 2.0)),
    ],
)
def test_the_time_of_the_quickest_of_some_is_taken(monkeypatch, ticks, expected):
    clock = iter(ticks)
    monkeypatch.setattr("edge_vpr_tools.sweep.trial.time.perf_counter", lambda: next(clock))
    done = []
    assert fastest(lambda: done.append(1) or len(done)) == expected
