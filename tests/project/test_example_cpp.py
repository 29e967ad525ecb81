"""The C++ header reads the rows of `edge-vpr stream` as Python does, and refuses damaged ones."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edge_vpr_tools.cli import main

CPP = Path(__file__).parents[2] / "examples" / "cpp"
HEADER = (CPP / "edge_vpr_match.hpp").read_text()
FIELDS = re.findall(r'\{"(\w+)", &Match', HEADER)
REQUIRED = ("time_s", "place", "lost")

#: Prints the values of each line in the order of `FIELDS`, or how it was left out.
PRINTER = """
#include <cstdio>
#include <iostream>
#include "edge_vpr_match.hpp"
void put(double x) { std::printf("%.17g,", x); }
void put(std::int64_t x) { std::printf("%lld,", static_cast<long long>(x)); }
void put(bool x) { std::printf(x ? "true," : "false,"); }
template <class T> void put(const std::optional<T>& x) { x ? put(*x) : void(std::printf("null,")); }
int main() {
    edge_vpr::Reader reader;
    for (std::string line; std::getline(std::cin, line); std::puts("")) {
        const auto refused = reader.refused;
        const auto match = reader.read(line);
        if (!match) std::printf(reader.refused > refused ? "refused" : "other");
        else for (const auto& field : edge_vpr::detail::fields)
            std::visit([&](auto part) { put((*match).*part); }, field.second);
    }
}
"""

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")


def build(source: Path, target: Path) -> Path:
    checks = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsanitize=address,undefined"]
    strict = [*checks, "-fno-sanitize-recover=all", f"-I{CPP}"]
    subprocess.run(["g++", "-std=c++17", *strict, source, "-o", target], check=True)
    return target


@pytest.fixture(scope="module")
def printer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("printer")
    (folder / "printer.cpp").write_text(PRINTER)
    return build(folder / "printer.cpp", folder / "printer")


@pytest.fixture(scope="module")
def rows(street: Path, tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """All rows of a run on a map with positions."""
    log = tmp_path_factory.mktemp("rows") / "run.jsonl"
    words = ["--port", street / "sent.bin", "--protocol", "evpr", "--map", street / "map.npz"]
    assert main(["stream", *map(str, words), "--log", str(log)]) == 0
    return log.read_bytes().splitlines()


def read(program: Path, lines: list[bytes]) -> list[Any]:
    """What the header makes of each line: values by name, "refused" or "other"."""
    run = subprocess.run([program], input=b"\n".join(lines) + b"\n", capture_output=True)
    assert run.returncode == 0, run.stderr.decode()
    read = run.stdout.decode().splitlines()
    assert len(read) == len(lines)
    whole = (line.rstrip(",").split(",") if line.endswith(",") else line for line in read)
    return [
        line if isinstance(line, str) else dict(zip(FIELDS, map(json.loads, line), strict=True))
        for line in whole
    ]


def by_python(line: bytes) -> dict[str, Any]:
    """The fields of a match that the header knows, None if absent."""
    row = json.loads(line.decode("latin-1"), parse_constant=lambda name: pytest.fail(name))
    assert row["kind"] == "match"
    return {name: row.get(name) for name in FIELDS}


def test_each_value_of_a_run_is_read(printer, rows):
    matches = [line for line in rows if json.loads(line)["kind"] == "match"]
    assert matches
    assert set(json.loads(matches[0])) <= {"kind", *FIELDS}
    assert read(printer, matches) == [by_python(line) for line in matches]
    assert set(read(printer, [line for line in rows if line not in matches])) == {"other"}
    events = [b"data: " + line + b"\r" for line in matches]
    assert read(printer, events) == read(printer, matches)
    assert read(printer, [b"", b"\r", b": a comment"]) == ["other"] * 3


MATCH = b'{"kind": "match", "time_s": 1.5, "place": 3, "lost": false'


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (b"", {}),
        (b', "x_m": -0.25e1, "age_s": null', {"x_m": -2.5}),
        (b', "new": [1, {"place": 9, "": []}, "}\\"\\\\"], "y_m": 1', {"y_m": 1.0}),
        (b', "\\u0078_m": 2, "caf\\u00e9": "\\ud83d\\ude00"', {"x_m": 2.0}),
        (b', "host_us": 9223372036854775807', {"host_us": 2**63 - 1}),
        (b', "host_us": 9223372036854775808', None),
        (b', "new": ' + b"[" * 16 + b"]" * 16, {}),
        (b', "new": ' + b"[" * 17 + b"]" * 17, None),
        pytest.param(b', "new": ' + b"[" * 1_000_000, None, id="deep array"),
        pytest.param(b', "new": ' + b'{"":' * 1_000_000, None, id="deep object"),
        (b', "x_m": "2"', None),
        (b', "x_m": NaN', None),
        (b', "x_m": 1e999', None),
        (b', "x_m": 1,5', None),
        (b', "x_m": 01', None),
        (b', "x_m": +1', None),
        (b', "x_m": 0x10', None),
        (b', "x_m": 1.', None),
        (b', "x_m": 1, "x_m": 2', None),
        (b', "jumps": 1.5', None),
        (b', "place": 4', None),
        (b', "probability": 1.25', None),
        (b', "new": "\\u12"', None),
        (b', "new": "\\x"', None),
        (b",", None),
        (b"} {", None),
    ],
)
def test_a_row_is_read_or_refused(printer, more, expected):
    required = {"time_s": 1.5, "place": 3, "lost": False}
    values = "refused" if expected is None else dict.fromkeys(FIELDS) | required | expected
    assert read(printer, [MATCH + more + b"}"]) == [values]


@pytest.mark.parametrize("name", REQUIRED)
def test_a_match_without_a_necessary_value_is_refused(printer, name):
    row = {"kind": "match", "time_s": 1.5, "place": 3, "lost": False}
    without = {key: value for key, value in row.items() if key != name}
    lines = [json.dumps(each).encode() for each in (without, {**row, name: None})]
    assert read(printer, lines) == ["refused"] * 2


def test_a_line_that_is_cut_off_anywhere_is_refused(printer, rows):
    line = rows[len(rows) // 2]
    assert set(read(printer, [line[:end] for end in range(1, len(line))])) == {"refused"}


def test_damaged_rows_are_read_as_python_reads_them_or_refused(printer, rows):
    """Nothing that Python refuses is taken, and no value differs from Python's."""
    rng = np.random.default_rng(47)
    alphabet = np.frombuffer(b'{}[]",:\\u0123456789+-.eE tfnNI\x00\x80\xff', dtype=np.uint8)
    matches = [line for line in rows if json.loads(line)["kind"] == "match"]
    damaged = []
    for _ in range(4000):
        line = bytearray(matches[rng.integers(len(matches))])
        for _ in range(rng.integers(1, 4)):
            at, end = np.sort(rng.integers(0, len(line) + 1, 2)).tolist()
            end = rng.choice([at, at + 1, end], p=[0.4, 0.5, 0.1])
            line[at:end] = rng.choice(alphabet, rng.integers(0, 3)).tobytes()
        damaged.append(bytes(line))
    answers = read(printer, damaged)
    taken = [(a, line) for a, line in zip(answers, damaged, strict=True) if isinstance(a, dict)]
    assert any(line not in matches for _, line in taken)
    assert "refused" in answers
    for answer, line in taken:
        assert answer == by_python(line)


def test_the_program_prints_where_the_robot_is(rows, tmp_path):
    program = build(CPP / "main.cpp", tmp_path / "where")
    run = subprocess.run(
        [program], input=b"\n".join([*rows, b"{"]), capture_output=True, check=True
    )
    last = next(row for row in map(json.loads, reversed(rows)) if row["kind"] == "match")
    assert run.stdout.decode().splitlines()[-1].startswith(f"{last['time_s']:.6g} s: ")
    assert run.stderr == b"1 lines refused\n"
