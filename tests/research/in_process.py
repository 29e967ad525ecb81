"""Experiments, run in this process: all that the command does, but for the workers."""

from __future__ import annotations

import tempfile
from pathlib import Path

from edge_vpr_tools.research.experiments.experiment import run_experiments, store_of, trials_of
from edge_vpr_tools.research.trials import Inline


def rows_of(module, data=None, seeds=1):
    """Return the rows of the experiment of a module."""
    name = module.__name__.rpartition(".")[2].replace("_", "-")
    with tempfile.TemporaryDirectory() as folder:
        store = store_of(Path(folder) / "trials")
        with store.opened():
            _, (found,) = run_experiments(trials_of(name, data, seeds), store, Inline())
    return found.rows
