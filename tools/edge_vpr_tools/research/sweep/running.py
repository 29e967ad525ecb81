"""Running of a sweep on the processes of this machine or on a Dask cluster."""

from __future__ import annotations

import multiprocessing
import time
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Generic, TypeVar

from edge_vpr.errors import EdgeVprError, MissingExtraError, UsageError, printable
from edge_vpr_tools.research.sweep.plan import (
    KeptFailure,
    KeptResult,
    NamedTrial,
    Plan,
    Trial,
    TrialResult,
    run_trial,
)
from edge_vpr_tools.research.sweep.store import ListedTrial, Store

# Workers for trials, with one interface: processes of this machine, or a Dask cluster.


Job = TypeVar("Job")
Result = TypeVar("Result")
_TIMEOUT_S = 20


class Workers(ABC):
    """Workers that run jobs.

    Attributes
    ----------
    count : int
        Number of jobs that the workers run at a time, as known at the start.
    at_once : int
        Number of jobs that are submitted at a time.
    """

    count: int
    at_once: int

    @abstractmethod
    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        """Start a job."""

    @abstractmethod
    def died(self, error: BaseException) -> bool:
        """Return whether the error means that a worker died, and not that its job failed.

        In that case, workers are available again for the next job.
        """


class _Processes(Workers):
    def __init__(self, workers: int) -> None:
        self.count = self.at_once = workers
        self._broken = False
        self._pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        # spawned, since a fork would copy locks of Numba's and Dask's threads in any state
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.at_once, mp_context=context)

    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        if self._broken:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool, self._broken = self._new(), False
        try:
            return self._pool.submit(run, job)
        except BrokenProcessPool:  # a worker died while it was idle
            self._broken = True
            return self.submit(run, job)

    def died(self, error: BaseException) -> bool:
        self._broken = self._broken or isinstance(error, BrokenProcessPool)
        return isinstance(error, BrokenProcessPool)

    def close(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)


class _Cluster(Workers):
    def __init__(self, client: Any) -> None:
        self._executor = client.get_executor(pure=False)
        # more jobs than workers, so that no worker waits for this process
        self.count = sum(client.ncores().values())
        self.at_once = 4 + 2 * self.count

    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        future: Future[Result] = self._executor.submit(run, job)
        return future

    def died(self, error: BaseException) -> bool:
        # the scheduler has already tried the job on several workers (distributed's KilledWorker)
        return False


@contextmanager
def processes(workers: int) -> Iterator[Workers]:
    """Provide worker processes of this machine, which end with the block.

    Raises
    ------
    UsageError
        If the number is less than one.
    """
    if workers < 1:
        raise UsageError(f"{workers} workers: give 1 or more")
    pool = _Processes(workers)
    try:
        yield pool
    finally:
        pool.close()


@contextmanager
def cluster(scheduler: str) -> Iterator[Workers]:
    """Provide the workers of a Dask cluster, which continue to run after the block.

    Parameters
    ----------
    scheduler : str
        Address of the scheduler, for example ``tcp://10.0.0.1:8786``.

    Raises
    ------
    UsageError
        If the scheduler does not answer.
    MissingExtraError
        If distributed is not installed.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise MissingExtraError("a Dask cluster", "distributed", "dask") from error
    try:
        client = distributed.Client(scheduler, timeout=_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {scheduler} ({error}): start it as docs/sweep.md shows, "
            "and name its address, such as tcp://10.0.0.1:8786"
        ) from error
    try:
        yield _Cluster(client)
    finally:
        client.close()


# Run jobs on workers that may die: each job ends in one result or one failure.


Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Outcome(Generic[Key, Result]):
    """Result or failure of a job.

    Attributes
    ----------
    key : hashable
    result : object or None
        None if the job failed.
    error, where : str
        One-line error, and its traceback; empty if the job did not fail.
    """

    key: Key
    result: Result | None
    error: str = ""
    where: str = ""


def run_all(
    jobs: Mapping[Key, Job], run: Callable[[Job], Result], workers: Workers
) -> Iterator[Outcome[Key, Result]]:
    """Run jobs in any order, and yield the outcome of each as it ends.

    When a worker dies, all jobs that were running are suspects, and run again one at a time. A job
    whose worker dies again has failed; the others end as usual.

    Parameters
    ----------
    jobs : mapping of key to job
    run : callable
        A function of a module, so that other processes can import it.
    workers : Workers

    Raises
    ------
    EdgeVprError
        If the cluster cannot be reached any more.
    """
    waiting, suspects = deque(jobs), deque[Key]()
    running: dict[Future[Result], Key] = {}
    alone = False
    while waiting or suspects or running:
        while waiting and len(running) < workers.at_once and not alone:
            key = waiting.popleft()
            running[workers.submit(run, jobs[key])] = key
        if not running:
            key, alone = suspects.popleft(), True
            running[workers.submit(run, jobs[key])] = key
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            key = running.pop(future)
            try:
                outcome = Outcome(key, future.result())
            except CancelledError as error:
                raise EdgeVprError(
                    "the cluster's scheduler is gone; what was finished is kept: run the sweep "
                    "again and it goes on"
                ) from error
            except Exception as error:
                if workers.died(error) and not alone:
                    suspects.append(key)
                    continue
                outcome = Outcome(key, None, *_described(error, workers.died(error)))
            yield outcome
        alone = alone and bool(running)


def _described(error: Exception, died: bool) -> tuple[str, str]:
    if died or type(error).__name__ == "KilledWorker":
        return "its worker died: it may have run out of memory, or was killed", ""
    kind = "" if isinstance(error, EdgeVprError) else f"internal error, {type(error).__name__}: "
    where = "".join(traceback.format_exception(error))
    return printable(f"{kind}{error}"), where


# Run a sweep: compute and store the results that are not yet known.


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
