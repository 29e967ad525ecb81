"""Where trials run: processes of this machine, or workers of a Dask cluster; one interface."""

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
    """Workers that take jobs.

    Attributes
    ----------
    count : int
        Jobs that they run at a time, when they were asked for.
    at_once : int
        Jobs that are given to them at a time.
    """

    count: int
    at_once: int

    @abstractmethod
    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        """Start a job."""

    @abstractmethod
    def died(self, error: BaseException) -> bool:
        """Whether the error says that a worker died, not that its job failed.

        If so, workers are ready again for the next job.
        """


class _Processes(Workers):
    def __init__(self, workers: int) -> None:
        self.count = self.at_once = workers
        self._broken = False
        self._pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        # spawned: a fork would copy the threads' locks of Numba and of Dask as they happen to be
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.at_once, mp_context=context)

    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        if self._broken:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool, self._broken = self._new(), False
        try:
            return self._pool.submit(run, job)
        except BrokenProcessPool:  # died while it had nothing to do
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
        # some wait at the scheduler, so that no worker waits for us
        self.count = sum(client.ncores().values())
        self.at_once = 4 + 2 * self.count

    def submit(self, run: Callable[[Job], Result], job: Job) -> Future[Result]:
        future: Future[Result] = self._executor.submit(run, job)
        return future

    def died(self, error: BaseException) -> bool:
        # the scheduler has given the job to several workers already (distributed's KilledWorker)
        return False


@contextmanager
def processes(workers: int) -> Iterator[Workers]:
    """Give processes of this machine; they end with the block.

    Parameters
    ----------
    workers : int

    Raises
    ------
    UsageError
        If there is to be none.
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
    """Give the workers of a Dask cluster; they live on after the block.

    Parameters
    ----------
    scheduler : str
        Its address, for example ``tcp://10.0.0.1:8786``.

    Raises
    ------
    UsageError
        If it does not answer.
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
