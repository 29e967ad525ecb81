"""Damaged images of the firmware: refused, or run without a fault."""

from __future__ import annotations

import subprocess
import sys

import pytest

from firmware_model import ToolError
from firmware_model.emulation.build import build_sanitized
from firmware_model.verification.fuzz_images import Fuzzer, FuzzResult, undamaged


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory) -> Fuzzer:
    """Under both sanitizers, or not at all."""
    try:
        return Fuzzer(tmp_path_factory.mktemp("fuzz"), seed=1)
    except ToolError as error:
        pytest.skip(str(error)[:200])


@pytest.mark.slow
def test_damaged_images_are_refused_or_run_without_a_fault(fuzzer):
    """A bounded run of what `python -m firmware_model.verification.fuzz_images` does at length."""
    done = fuzzer.run(8000)
    assert done.images == 8000 and done.opened < 4000
    # enough of them open for the run to say something
    assert done.ran > 1000 and done.windows > 20_000 and done.matches > 10_000


def test_an_image_is_the_same_wherever_a_run_begins(fuzzer):
    """So that the image that a failing run names can be run alone."""
    assert fuzzer.run(300, first=100) == fuzzer.run(200, first=100) + fuzzer.run(100, first=300)
    assert fuzzer.run(0) == FuzzResult()


def test_without_the_sanitizers_the_error_says_what_to_install(tmp_path, monkeypatch):
    """A computer without a compiler."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ToolError, match="install gcc"):
        build_sanitized(tmp_path, ["vpr.c"], "fuzz")


def test_undamaged_images_are_those_of_their_seed():
    """The same seed makes the same ones, and all of them are small."""
    assert undamaged(3) == undamaged(3) != undamaged(4)
    assert max(map(len, undamaged(3))) <= 1 << 14


@pytest.mark.slow
def test_the_command_says_what_it_found(fuzzer):
    """One line with the figures."""
    command = [sys.executable, "-m", "firmware_model.verification.fuzz_images", "--images", "1_000"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("1,000 damaged images, ") and "no fault" in done.stdout
