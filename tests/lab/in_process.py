"""Experiments, run in this process: all that the command does, but for the workers."""

from __future__ import annotations

import json

from lab.loop import run_trial, table_rows, trials_of

from edge_vpr.results import json_text


def rows_of(module, data=None, seeds=1):
    """Return the rows of the experiment of a module."""
    name = module.__name__.rpartition(".")[2].replace("_", "-")
    trials = trials_of(name, data, seeds)
    # in their file, numbers that are not finite are missing
    finished = {trial: json.loads(json_text(run_trial(trial))) for trial in trials}
    return table_rows(name, finished)
