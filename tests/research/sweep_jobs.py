"""Jobs for workers; other processes import this module by name, so that it imports little."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def double(job):
    return 2 * job


def kill_worker_once(job):
    """End this process without a word, the first time that the job's file is not there."""
    number, folder = job
    mark = Path(folder) / f"{number}"
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def kill_worker_always(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def refuse(number):
    if number == 3:
        raise ValueError("three\nis refused")
    return number


def lack_a_library(number):
    from edge_vpr.errors import MissingExtraError

    if number == 3:
        raise MissingExtraError("a third job", "no_library", "formats")
    return number


def slow_trial(trial):
    """Take a while, so that the worker can be killed meanwhile."""
    import time

    from edge_vpr_tools.research.sweep.plan import run_trial

    time.sleep(0.3)
    return run_trial(trial)


def wait_for_ever(folder):
    """Leave this worker's number, and take longer than any test."""
    import time

    (Path(folder) / f"{os.getpid()}").touch()
    time.sleep(3_600)
