"""Jobs for workers; other processes import this module by name, so that it imports little."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def double(number):
    return 2 * number


def kill_worker(number):
    """End the worker of the third job without a word."""
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


def slow(number):
    """Take a while, so that the worker can be killed meanwhile."""
    import time

    time.sleep(0.3)
    return number


def wait_for_ever(folder):
    """Leave this worker's number, and take longer than any test."""
    import time

    (Path(folder) / f"{os.getpid()}").touch()
    time.sleep(3_600)
