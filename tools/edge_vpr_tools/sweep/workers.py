"""Workers for trials, with one interface: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeVar

from edge_vpr.errors import MissingExtraError, UsageError

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
            f"no Dask scheduler answers at {scheduler} ({error}): start it with dask scheduler, "
            "and name its address, such as tcp://10.0.0.1:8786"
        ) from error
    try:
        yield _Cluster(client)
    finally:
        client.close()
