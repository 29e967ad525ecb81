"""`.ci/run`: where it installs programs, and what it says at the end."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

RUN = Path(__file__).parents[2] / ".ci" / "run"


def run(folder: Path, *, user: str, status: int = 0, **environment: str):
    """Run with a `make` that names its target, skips a test in two of them, and may fail."""
    for name, text in {
        "make": f'echo "made $1"; echo "SKIPPED [1] tests/a.py:3: no verilator"; exit {status}',
        "id": f"echo {user}",
    }.items():
        program = folder / name
        program.write_text(f"#!/bin/sh\n{text}\n")
        program.chmod(0o755)
    inherited = {name: text for name, text in os.environ.items() if name != "CI"}
    path = f"{folder}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", str(RUN)], env={**inherited, "PATH": path, **environment},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    made = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("made ")]
    return done, made


@pytest.mark.parametrize(
    ("user", "environment", "expected"),
    [
        ("0", {"CI": "true"}, ["tools", "test", "verify"]),
        ("1000", {"CI": "true"}, ["test", "verify"]),
        ("0", {}, ["test", "verify"]),
    ],
)
def test_programs_are_installed_by_root_of_a_machine_made_for_the_run_alone(
    tmp_path, user, environment, expected
):
    done, made = run(tmp_path, user=user, **environment)
    assert (done.returncode, made) == (0, expected), done.stderr


def test_what_was_skipped_is_said_once_at_the_end_of_a_failed_run_too(tmp_path):
    done, made = run(tmp_path, user="1000", status=3)
    assert done.returncode != 0 and made == ["test"]
    *_, before, last = done.stdout.splitlines()
    assert before == "Tests that were skipped, and why:"
    assert last == "SKIPPED [1] tests/a.py:3: no verilator"
    assert run(tmp_path, user="1000")[0].stdout.splitlines()[-1] == last
