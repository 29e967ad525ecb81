"""What README and docs show is true: Python runs, commands parse, links lead somewhere."""

from __future__ import annotations

import csv
import json
import os
import re
import runpy
import shlex
import subprocess
import tomllib
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edge_vpr_tools.cli import VerbParser, find_verb, main
from lab.__main__ import parser

from edge_vpr.events import Sensor
from edge_vpr.live.protocols import Health
from edge_vpr.match_result import OnlineMetrics
from edge_vpr.matching.match import Match
from edge_vpr.recordings import write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.run_log import log_warning, logged_run
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from tests.live.devices import sent_by
from tests.streams import Drive, random_events

ROOT = Path(__file__).parents[2]
PAGES = [
    *sorted(path.name for path in ROOT.glob("*.md")),
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
]
#: language, what the block needs that not everybody has, text
_BLOCK = re.compile(r"^```(\w*) ?([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SOURCES = (".py", ".c", ".h", ".sv", ".sh")
_FILE = re.compile(r"`([\w/]+\.(?:py|c|h|sv|sh))`")
_LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")


def blocks(page: str, language: str) -> list[str]:
    """Give the code blocks of a page that are marked with this language."""
    text = (ROOT / page).read_text()
    return [
        body for marked, needs, body in _BLOCK.findall(text) if marked == language and not needs
    ]


#: pages whose Python simulates whole drives
SIMULATING = ("README.md", "docs/laboratory.md")


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.slow if page in SIMULATING else ())
        for page in PAGES
        if blocks(page, "python")
    ],
)
def test_the_python_of_a_page_runs_block_after_block(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    events = random_events(np.random.default_rng(0), 4_000, Sensor(32, 24), 1_000_000)
    for name in ("drive.raw", "drive2.raw"):
        write_recording(tmp_path / name, events, sensor=Sensor(32, 24))
    if page == "docs/live.md":
        events = random_events(np.random.default_rng(3), 4_000, Sensor(32, 24), 2_000_000)
        settings = PRESETS["default"].replaced({"pixels": 20, "sigma": 1.0, "tau": "100ms"}, "")
        Path("sent.bin").write_bytes(sent_by(events, Sensor(32, 24)))
        ReferenceMap.build(Drive(events, Sensor(32, 24)), settings).save("map.npz")
    names: dict[str, Any] = {}
    for number, block in enumerate(blocks(page, "python"), 1):
        block = block.replace("/dev/ttyACM0", "sent.bin")
        exec(compile(block, f"{page}, block {number}", "exec"), names)


@pytest.mark.slow
def test_the_python_of_guides_holds_for_a_strict_type_checker(tmp_path):
    """As in the program of a user, who has neither this checkout nor its configuration."""
    api = pytest.importorskip("mypy.api")
    guides = ["README.md", "docs/ground_truth.md", "docs/recipes.md", "docs/recordings.md"]
    for number, page in enumerate(guides):
        (tmp_path / f"guide_{number}.py").write_text("\n".join(blocks(page, "python")))
    config = tmp_path / "mypy.ini"
    config.write_text("[mypy]\n")
    report, errors, _ = api.run(["--strict", "--config-file", str(config), str(tmp_path)])
    assert not errors
    assert report.startswith("Success: no issues found"), report


def commands(page: str, program: str = "edge-vpr") -> list[str]:
    """Give the lines of a page's code blocks that call a program, joined where they go on."""
    lines = []
    for _, _, body in _BLOCK.findall((ROOT / page).read_text()):
        for line in body.replace("\\\n", " ").splitlines():
            line = line.removeprefix("$ ")
            if line.startswith(f"{program} "):
                lines.append(line)
    return lines


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_every_command_that_a_page_shows_is_one(page):
    for line in commands(page):
        verb, words = find_verb(shlex.split(line, comments=True)[1:])
        assert verb, line
        VerbParser(verb).parse(words)


@pytest.mark.parametrize("page", PAGES)
def test_links_within_the_project_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(), flags=re.DOTALL)
    for target, anchor in _LINK.findall(text):
        if "://" in target or target.startswith("mailto:"):
            continue
        path = (ROOT / page).parent / target
        assert path.exists(), f"{page} leads to {target}, which is not there"
        if anchor and path.suffix == ".md":
            headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
            slugs = {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}
            assert anchor[1:] in slugs, f"{page} leads to {target}{anchor}"


@cache
def source_files():
    """List the project's own, not those of an environment in a hidden folder of it."""
    paths = []
    for folder, inner, names in os.walk(ROOT):
        inner[:] = [name for name in inner if not name.startswith(".")]
        paths += [f"{folder}/{name}" for name in names if Path(name).suffix in _SOURCES]
    return paths


@pytest.mark.parametrize("page", PAGES)
def test_source_files_that_a_page_names_are_there(page):
    elsewhere = {  # of other projects, or generated
        "baselines/get_baseline.py", "get_baseline.py", "case.h", "map.h", "include/map.h",
        "main.py", "vpr_pkg.sv", "vpr_registers.h", "genx320_event_mode_streaming_on_cam.py",
        "genx320_raw_event_mode_streaming_on_cam.py",
    }  # fmt: skip
    there = source_files()
    for name in _FILE.findall((ROOT / page).read_text()):
        if name in elsewhere:
            continue
        assert any(path.endswith(f"/{name}") for path in there), f"{page} names {name}"


@cache
def words_of_the_source() -> frozenset[str]:
    """Return every word of the project's source files."""
    files = [*source_files(), ROOT / "pyproject.toml"]
    by_file = (re.findall(r"\w+", Path(file).read_text(encoding="utf-8")) for file in files)
    return frozenset(word for words in by_file for word in words)


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md", "docs/testing.md"])
def test_names_that_a_page_for_developers_has_are_in_the_source(page):
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    names = re.findall(r"`([A-Za-z_][\w.]*)(?:\(\))?`", text)
    assert len(names) > 20
    gone = [name for name in names if name.split(".")[-1] not in words_of_the_source()]
    assert gone == []


def test_the_walks_through_the_code_name_what_their_files_define():
    """From a file to a row, and from a byte to a match: each step is in the file of its row."""
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| (`[^|]*\.py`[^|]*) \| (.*) \|$", text.partition("## Three walks")[2], re.M
    )
    assert len(rows) > 20
    for files, step in rows:
        paths = [
            path
            for name in re.findall(r"`([\w./]+\.py)`", files + step)
            for path in source_files()
            if path.endswith(f"/{name}")
        ]
        defined = "\n".join(Path(path).read_text(encoding="utf-8") for path in paths)
        names = {name.split(".")[-1] for name in re.findall(r"`([A-Za-z_][\w.]*)`", step)} - {"py"}
        gone = {n for n in names if not re.search(rf"\b(def|class) {n}\b|^{n}\b.*=", defined, re.M)}
        assert not gone, files


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "toml")])
def test_toml_that_a_page_shows_is_toml(page):
    for block in blocks(page, "toml"):
        assert tomllib.loads(block)


def test_every_page_of_docs_is_reached_from_the_readme():
    reached, waiting = set(), ["README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        for target, _ in _LINK.findall((ROOT / page).read_text()):
            path = ((ROOT / page).parent / target).resolve()
            if path.suffix == ".md" and path.is_file():
                waiting.append(str(path.relative_to(ROOT)))
    assert set(PAGES) <= reached


_FIGURE = re.compile(r"\d[\d,]*(?:\.\d+)?")
#: what depends on the machine always: how long something took
_TIMES = re.compile(
    r"(?<=\bin )[\d,.]+ s\b|(?<=\btook )[\d,.]+ s\b|[\d,.]+ [uµ]s\b|[\d,.]+ times real\b"
)
#: some events, and what follows from them, depend on its logarithm
_CLOSE = 0.002


def words_and_figures(text: str) -> tuple[str, list[float]]:
    """Split a line into its words, and its numbers other than times that a step took."""
    text = _TIMES.sub("TIME", text)
    return _FIGURE.sub("#", text), [float(n.replace(",", "")) for n in _FIGURE.findall(text)]


def test_the_tutorial_runs_word_for_word_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/tutorial.md").read_text()
    steps = re.findall(r"^```console\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    commands = [step for block in steps for step in block.split("$ ") if step]
    assert commands
    for command in commands:
        line, _, told = command.partition("\n")
        program, *words = shlex.split(line)
        if program == "edge-vpr":
            assert main(words) == 0
            shown = "".join(capsys.readouterr())
        else:
            shown = subprocess.run(
                [program, *words], capture_output=True, text=True, check=True
            ).stdout
        kept = [text for text in shown.splitlines() if "compiling kernels" not in text]
        lines = told.splitlines()
        if lines[-1:] == ["..."]:  # the page leaves the rest out
            assert len(kept) > len(lines) > 1, line
            kept[len(lines) - 1 :] = ["..."]
        assert len(kept) == len(lines), line
        for printed, said in zip(kept, lines, strict=True):
            (words, figures), (page_words, page_figures) = map(words_and_figures, (printed, said))
            assert words == page_words, line
            assert figures == pytest.approx(page_figures, rel=_CLOSE, abs=_CLOSE), line
    ((code, told),) = re.findall(
        r"^```python after[^\n]*\n(.*?)^```$\n\n```\n(.*?)^```$", page, re.MULTILINE | re.DOTALL
    )
    exec(compile(code, "docs/tutorial.md", "exec"), {})
    (words, figures), (page_words, page_figures) = map(
        words_and_figures, (capsys.readouterr().out, told)
    )
    assert words == page_words
    assert figures == pytest.approx(page_figures, rel=_CLOSE, abs=_CLOSE)


def test_tables_of_pages_are_those_of_their_files_and_of_the_settings():
    """If not: python tools/site/tables.py."""
    made = runpy.run_path(str(ROOT / "tools/site/tables.py"))
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        assert made["filled_page"](text) == text, page
    assert made["settings_table"]() in (ROOT / "docs/settings.md").read_text(encoding="utf-8")


def test_every_picture_and_table_of_docs_is_on_a_page():
    """Or in the list of the commands that write tables."""
    shown = "".join((ROOT / page).read_text() for page in PAGES)
    pictures = [
        path.relative_to(ROOT / "docs").as_posix()
        for path in (ROOT / "docs").rglob("*")
        if path.suffix in (".svg", ".png", ".gif")
    ]
    assert [name for name in pictures if name not in shown] == []
    listed = (ROOT / "docs/results/files.csv").read_text()
    tables = {path.name for path in (ROOT / "docs/results").glob("*.csv")} - {"files.csv"}
    assert {name for name in tables if f"{name}," not in listed} == set()


def listed_results() -> dict[str, str]:
    """Give the command that makes each file of results."""
    with (ROOT / "docs/results/files.csv").open(newline="") as file:
        return {row["file"]: row["command"] for row in csv.DictReader(file)}


def test_every_experiment_that_pages_and_the_list_of_results_show_is_one():
    lines = [*listed_results().values()]
    lines += [line for page in PAGES for line in commands(page, "python -m lab")]
    lines = [line for line in lines if line.startswith("python -m lab ") and "--help" not in line]
    assert len(lines) > 10
    for line in lines:
        parser().parse_args(shlex.split(line, comments=True)[3:])


def test_the_command_of_a_table_makes_all_of_its_seeds():
    """Rows that it does not make would stay as they were when it is run again."""
    checked = 0
    for name, command in listed_results().items():
        if not command.startswith("python -m lab "):
            continue
        seeds = parser().parse_args(shlex.split(command)[3:]).seeds
        with (ROOT / "docs/results" / name).open(newline="") as file:
            made = {int(row["seed"]) for row in csv.DictReader(file) if row["seed"]}
        assert made in ({0}, set(range(seeds))), name
        checked += 1
    assert checked > 10


def test_only_who_names_the_published_results_replaces_them():
    """A user's experiment writes elsewhere; the commands of the list, and make, name the folder."""
    assert not parser().parse_args(["simulated"]).output.startswith("docs")
    commands = [*listed_results().values()]
    commands += (ROOT / "Makefile").read_text().splitlines()
    commands = [command for command in commands if "python -m lab" in command]
    assert len(commands) > 10
    assert [command for command in commands if "-o docs/results" not in command] == []


def test_the_page_of_outputs_names_every_column_and_key(tmp_path):
    """Of a matched, evaluated drive, and of what a live view writes."""
    first, second = simulate_pair(0, "tiny", length_m=60)
    route = ReferenceMap.build(first, pixels=50, track=first.track)
    result = route.match(second)
    with logged_run():
        log_warning("a warning")
        result.save(tmp_path / "results")
    route.save(tmp_path / "map.npz")
    for name, recording in (("monday", first), ("tuesday", second)):
        track = recording.track
        rows = np.column_stack([track.time_us / 1e6, track.position])
        header = "time_s,position_m"
        np.savetxt(tmp_path / f"{name}.csv", rows, "%.6f", ",", header=header, comments="")
    tracks = [str(tmp_path / f"{name}.csv") for name in ("monday", "tuesday")]
    words = ["evaluate", str(tmp_path / "results"), "--ground-truth", *tracks, "--tolerance", "10"]
    assert main([*words, "--quiet"]) == 0
    metrics = json.loads((tmp_path / "results/metrics.json").read_text())
    header = (tmp_path / "results/matches.csv").read_text().splitlines()[0].split(",")
    with np.load(tmp_path / "map.npz") as archive:
        arrays = list(archive.files)
    written = {
        *header, *metrics, *metrics["evaluation"], *arrays,
        *metrics["evaluation"]["rejection"], *metrics["evaluation"]["reliability"],
        *metrics["faults_dropped"], *metrics["evaluated_by"],
        *(field.name for field in fields(Health)), *Match._fields,
        *(field.name for field in fields(OnlineMetrics)),
        *json.loads((tmp_path / "results/run.json").read_text()),
    }  # fmt: skip
    # between backticks, outside of code blocks
    text = _BLOCK.sub("", (ROOT / "docs/outputs.md").read_text())
    named = " ".join(re.findall(r"`([^`\n]+)`", text))
    assert {name for name in written if not re.search(rf"\b{name}\b", named)} == set()
