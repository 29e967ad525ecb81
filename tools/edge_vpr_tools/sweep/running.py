"""Run jobs on workers that may die: each job ends in one result or one failure."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass
from typing import Generic, TypeVar

from edge_vpr.errors import EdgeVprError, printable
from edge_vpr_tools.sweep.workers import Workers

Key = TypeVar("Key", bound=Hashable)
Job = TypeVar("Job")
Result = TypeVar("Result")


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
