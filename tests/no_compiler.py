"""Run a test module once more in plain Python, with Numba's compiler off."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


def run_without_compiler(path: str) -> None:
    """Fail with pytest's last words unless the module's tests pass with NUMBA_DISABLE_JIT=1."""
    if "NUMBA_DISABLE_JIT" in os.environ:
        pytest.skip("this is that run")
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", path]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-3000:]
