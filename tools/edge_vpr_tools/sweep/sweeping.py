"""Run a sweep: compute and store the results that are not yet known."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from edge_vpr_tools.sweep.plan import NamedTrial, Plan
from edge_vpr_tools.sweep.running import run_all
from edge_vpr_tools.sweep.store import ListedTrial, Store
from edge_vpr_tools.sweep.trial import KeptFailure, KeptResult, Trial, TrialResult, run_trial
from edge_vpr_tools.sweep.workers import Workers

#: called with the number of ended trials, of trials to compute, and of failures among them
Progress = Callable[[int, int, int], None]


@dataclass(frozen=True, kw_only=True)
class SweepRun:
    """Counts of one run of a sweep.

    Attributes
    ----------
    trials : int
        Number of trials in the plan, counted by name.
    different : int
        Number of trials with different settings or inputs.
    known : int
        Number of trials whose result or failure was stored by an earlier run.
    computed, failed : int
    workers : int
    busy_share : float
        Share of the workers' time, until the last trial ended, in which they computed trials that
        did not fail. The start of their processes counts as idle.
    """

    trials: int
    different: int
    known: int
    computed: int
    failed: int
    workers: int
    busy_share: float


def run_sweep(
    plan: Plan,
    store: Store,
    workers: Workers,
    *,
    retry_failed: bool = False,
    progress: Progress = lambda done, of, failed: None,
    run: Callable[[Trial], TrialResult] = run_trial,
) -> SweepRun:
    """Compute every trial of a plan whose result is not stored yet.

    Parameters
    ----------
    plan : Plan
    store : Store
        Must be opened.
    workers : Workers
    retry_failed : bool
        Compute trials again that failed before.
    progress : callable
        See `Progress`.
    run : callable
        Maps a trial to its result; must be a function of a module.

    Raises
    ------
    EdgeVprError
        If an input or a stored file cannot be read, or the cluster cannot be reached any more.
    """
    named = list(plan.trials())
    keys = [one.trial.key for one in named]
    store.list_trials([_listed(one, key) for one, key in zip(named, keys, strict=True)])
    trials = dict(zip(keys, (one.trial for one in named), strict=True))
    missing = {
        key: trial
        for key, trial in trials.items()
        if store.result(key) is None and (retry_failed or store.failure(key) is None)
    }
    failed, busy_s, begin = 0, 0.0, time.perf_counter()
    progress(0, len(missing), 0)
    for done, outcome in enumerate(run_all(missing, run, workers), 1):
        key, trial = outcome.key, missing[outcome.key]
        if outcome.result is not None:
            busy_s += outcome.result.elapsed_s
            store.keep_result(KeptResult(key=key, trial=trial, found=outcome.result))
        else:
            failed += 1
            store.keep_failure(
                KeptFailure(key=key, trial=trial, error=outcome.error, where=outcome.where)
            )
        progress(done, len(missing), failed)
    return SweepRun(
        trials=len(named),
        different=len(trials),
        known=len(trials) - len(missing),
        computed=len(missing) - failed,
        failed=failed,
        workers=workers.count,
        busy_share=busy_s / (max(time.perf_counter() - begin, 1e-9) * max(workers.count, 1)),
    )


def failures(store: Store) -> list[tuple[ListedTrial, str]]:
    """Return the trials that have failed and have no result, with their errors."""
    return [
        (trial, error)
        for trial in store.listed()
        if store.result(trial.key) is None and (error := store.failure(trial.key)) is not None
    ]


def _listed(one: NamedTrial, key: str) -> ListedTrial:
    return ListedTrial(variant=one.variant, drives=one.drives, seed=one.seed, key=key)
