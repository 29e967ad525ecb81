"""Experiments, run in this process: all that the command does, but for the workers."""

from __future__ import annotations

import json

import numpy as np
from lab.loop import run_trial, table_rows, trials_of

from edge_vpr.records import json_text


def rows_of(module, data=None, seeds=1):
    """Return the rows of the experiment of a module."""
    name = module.__name__.rpartition(".")[2].replace("_", "-")
    trials = trials_of(name, data, seeds)
    # in their file, numbers that are not finite are missing
    finished = {trial: json.loads(json_text(run_trial(trial))) for trial in trials}
    return table_rows(name, finished)


def walks_in(data, side):
    """Write two walks along the same 30 places of a square sensor, a second at each, with noise."""
    folder = data / "speck_walks"
    folder.mkdir()
    rng = np.random.default_rng(3)
    places = rng.gamma(0.5, 0.6, (30, side, side)).repeat(30, axis=0)
    for name in ("reference", "query"):
        frames = np.minimum(rng.poisson(places), 255).astype(np.uint8)
        np.savez(folder / f"{name}.npz", frames=frames)
    (folder / "ground_truth.csv").write_text("query_frame,reference_frame\n0,0\n900,900\n")
    return data
