"""Trials on workers, each computed once: the engine of sweeps and of experiments."""

from __future__ import annotations

import fcntl
import hashlib
import json
import multiprocessing
import os
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import edge_vpr
from edge_vpr.errors import EdgeVprError, MissingExtraError, UsageError, printable
from edge_vpr.files import is_work_folder
from edge_vpr.results import RecordError, check_parent, from_json, read_record, write_json

# Workers for trials, with one interface: processes of this machine, or a Dask cluster.


Job = TypeVar("Job")
Result = TypeVar("Result")
_TIMEOUT_S = 20


class Workers(ABC):
    """Workers that run jobs."""

    count: int  #: Number of jobs that the workers run at a time, as known at the start.
    at_once: int  #: Number of jobs that are submitted at a time.

    @abstractmethod
    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        """Start a job."""

    @abstractmethod
    def died(self, error: BaseException) -> bool:
        """Return whether the error means that a worker died, and not that its job failed.

        In that case, workers are available again for the next job.
        """


def _end_with_this_process() -> None:
    """End this worker when the process that started it ends, whatever ends it.

    A pool whose process is killed does not tell its workers, which would wait for ever.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()


class _Processes(Workers):
    def __init__(self, workers: int) -> None:
        self.count = self.at_once = workers
        self._broken = False
        self._pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        # spawned, since a fork would copy locks of Numba's and Dask's threads in any state
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(
            self.at_once, mp_context=context, initializer=_end_with_this_process
        )

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


class Inline(Workers):
    """Runs a job in the calling process when it is submitted."""

    count = at_once = 1

    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        """Run a job."""
        future: Future[Result] = Future()
        try:
            future.set_result(run(job))
        except Exception as error:
            future.set_exception(error)
        return future

    def died(self, error: BaseException) -> bool:
        """Return False: with this process, everything would end."""
        return False


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
    """Provide worker processes of this machine, which end with the block."""
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
    """Result or failure of a job."""

    key: Key
    result: Result | None  #: None if the job failed.
    #: error, where: one-line error, and its traceback; empty if the job did not fail.
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
    run : callable
        A function of a module, so that other processes can import it.

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


# Folder of results and failures under their keys, and of the names of the trials.


#: version of the key and of the result's file
SCHEMA = 1
SWEEP = "sweep.json"
_RESULTS, _FAILURES, _LOCK = "results", "failures", ".lock"
_REMEDY = "remove it, and the sweep computes it again"


def key_of(version: str, *decides: Any) -> str:
    """Return the key of a result: a hash of all that decides it, as JSON."""
    text = json.dumps([SCHEMA, version, *decides], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class AnyTrial(Protocol):
    """Everything that determines a result; a record that JSON can hold."""

    @property
    def key(self) -> str:
        """Key of the result: a hash."""
        ...

    @property
    def version(self) -> str:
        """Version of edge-vpr."""
        ...


TrialT = TypeVar("TrialT", bound=AnyTrial)
ResultT = TypeVar("ResultT")


@dataclass(frozen=True, kw_only=True)
class ListedTrial:
    """Trial of the sweep: its names, and the key of its result."""

    variant: str
    drives: str
    seed: int
    key: str


@dataclass(frozen=True, kw_only=True)
class SweepRecord:
    """Content of ``sweep.json``: the trials of a sweep."""

    schema: int
    trials: tuple[ListedTrial, ...]


@dataclass(frozen=True, kw_only=True)
class _Stored:
    """File of a result or of a failure; `Store` says of which types trial and result are."""

    key: str
    trial: Any
    found: Any = None
    error: str = ""


@contextmanager
def _named(path: Path, remedy: str) -> Iterator[None]:
    """Name a file that holds another record than it should."""
    try:
        yield
    except RecordError as error:
        raise UsageError(f"cannot read {path}: {error}: {remedy}") from None


class Store(Generic[TrialT, ResultT]):
    """Stores results, so that none is computed twice.

    A result is written whole or not at all, as soon as it is known. After an interruption, the
    folder has all finished results.
    """

    def __init__(self, folder: Path, trial: type[TrialT], result: type[ResultT]) -> None:
        self.folder = folder
        self._trial, self._result = trial, result

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Lock the folder, so that no second sweep computes the same results into it.

        Raises
        ------
        UsageError
            If it cannot be created, is not the folder of a sweep, or another sweep has locked it.
        """
        check_parent(self.folder)
        there = self.folder.exists()
        if there and not (self.folder / SWEEP).is_file():
            empty = self.folder.is_dir() and all(
                inner.name in (_LOCK, _RESULTS, _FAILURES) or is_work_folder(inner)
                for inner in self.folder.iterdir()
            )
            if not empty:
                raise UsageError(
                    f"{self.folder} is not the folder of a sweep: name another one, or a new one"
                )
        for inner in (_RESULTS, _FAILURES):
            (self.folder / inner).mkdir(parents=True, exist_ok=True)
        handle = os.open(self.folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UsageError(
                    f"another sweep writes to {self.folder}: wait for it, or name another folder"
                ) from None
            yield
        finally:
            os.close(handle)

    def list_trials(self, trials: tuple[ListedTrial, ...]) -> None:
        """Write the names and keys of the sweep's trials."""
        write_json(self.folder / SWEEP, SweepRecord(schema=1, trials=trials))

    def listed(self) -> tuple[ListedTrial, ...]:
        """Read the names and keys of the sweep's trials.

        Raises
        ------
        UsageError
            If the file is missing or damaged.
        """
        remedy = "run edge-vpr sweep again"
        return read_record(SweepRecord, self.folder / SWEEP, "a sweep's file", remedy).trials

    def keep_result(self, key: str, trial: TrialT, found: ResultT) -> None:
        """Write a result, and delete an earlier failure under its key."""
        whole = {"key": key, "trial": trial, "found": found, "schema": SCHEMA}
        write_json(self._path(_RESULTS, key), whole)
        self._path(_FAILURES, key).unlink(missing_ok=True)

    def keep_failure(self, key: str, trial: TrialT, error: str, where: str) -> None:
        """Write the one-line error of a trial, and its traceback; empty if the worker died."""
        whole = {"key": key, "trial": trial, "error": error, "where": where, "schema": SCHEMA}
        write_json(self._path(_FAILURES, key), whole)

    def result(self, key: str) -> ResultT | None:
        """Return the result under a key; None if there is none. Raises as `stored`."""
        found = self.stored(key)
        return None if found is None else found[1]

    def stored(self, key: str) -> tuple[TrialT, ResultT] | None:
        """Return the trial and the result under a key; None if there is none.

        Raises
        ------
        UsageError
            If its file is damaged, or of another trial.
        """
        found = self._read(_RESULTS, key)
        return None if found is None else (found.trial, found.found)

    def failure(self, key: str) -> str | None:
        """Return the error under a key; None if there is none. Raises as `stored`."""
        found = self._read(_FAILURES, key)
        return None if found is None else found.error

    def _path(self, kind: str, key: str) -> Path:
        return self.folder / kind / f"{key}.json"

    def _read(self, kind: str, key: str) -> _Stored | None:
        """Read the file of a key, which may have been copied or changed; None if there is none."""
        path = self._path(kind, key)
        if not path.is_file():
            return None
        stored = read_record(_Stored, path, "a sweep's file", _REMEDY)
        with _named(path, _REMEDY):
            trial = from_json(self._trial, stored.trial, "trial")
            # another version makes another key of the same trial
            of_trial = key if trial.version != edge_vpr.__version__ else trial.key
            if not key == stored.key == of_trial:
                raise UsageError(f"{path} holds another trial than its name says: {_REMEDY}")
            if kind == _RESULTS:
                stored = replace(stored, found=from_json(self._result, stored.found, "found"))
            return replace(stored, trial=trial)


# Compute the trials that are not stored yet.


#: called with the number of ended trials, of trials to compute, and of failures among them
Progress = Callable[[int, int, int], None]


@dataclass(frozen=True, kw_only=True)
class TrialsRun:
    """Counts of one run."""

    trials: int  #: Number of trials, counted by name.
    different: int  #: Number of trials with different keys.
    known: int  #: Number of trials whose result or failure was stored by an earlier run.
    computed: int
    failed: int
    workers: int
    elapsed_s: float


def compute(
    named: Mapping[ListedTrial, TrialT],
    run: Callable[[TrialT], ResultT],
    store: Store[TrialT, ResultT],
    workers: Workers,
    *,
    retry_failed: bool = False,
    progress: Progress = lambda done, of, failed: None,
) -> TrialsRun:
    """Compute every trial whose result is not stored yet.

    Parameters
    ----------
    named : mapping of ListedTrial to trial
        Trials by their names and keys.
    run : callable
        Maps a trial to its result; must be a function of a module.
    store : Store
        Must be opened.
    retry_failed : bool
        Compute trials again that failed before.
    progress : callable
        See `Progress`.

    Raises
    ------
    EdgeVprError
        If an input or a stored file cannot be read, or the cluster cannot be reached any more.
    """
    trials = {listed.key: trial for listed, trial in named.items()}
    store.list_trials(tuple(named))
    missing = {
        key: trial
        for key, trial in trials.items()
        if store.result(key) is None and (retry_failed or store.failure(key) is None)
    }
    failed, start = 0, time.perf_counter()
    progress(0, len(missing), 0)
    for done, outcome in enumerate(run_all(missing, run, workers), 1):
        key, trial = outcome.key, missing[outcome.key]
        if outcome.result is not None:
            store.keep_result(key, trial, outcome.result)
        else:
            failed += 1
            store.keep_failure(key, trial, outcome.error, outcome.where)
        progress(done, len(missing), failed)
    return TrialsRun(
        trials=len(named),
        different=len(trials),
        known=len(trials) - len(missing),
        computed=len(missing) - failed,
        failed=failed,
        workers=workers.count,
        elapsed_s=time.perf_counter() - start,
    )


def failures(store: Store[TrialT, ResultT]) -> list[tuple[ListedTrial, str]]:
    """Return the trials that have failed and have no result, with their errors."""
    return [
        (trial, error)
        for trial in store.listed()
        if store.result(trial.key) is None and (error := store.failure(trial.key)) is not None
    ]
