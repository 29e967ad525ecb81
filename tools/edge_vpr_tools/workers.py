"""One function mapped over many jobs: on processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from edge_vpr.errors import EdgeVprError, UsageError, import_extra, printable

Job = TypeVar("Job")
Result = TypeVar("Result")
_TIMEOUT_S = 20


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Provide worker processes of this machine; an error or interrupt in the block ends them.

    Raises
    ------
    UsageError
        If `count` is below 1.
    """
    if count < 1:
        raise UsageError(f"{count} workers: give 1 or more")
    before = set(multiprocessing.active_children())
    # spawned, since a fork would copy locks of Numba's and Dask's threads in any state
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_end_with_this_process)
    try:
        yield pool
    except BaseException:
        # a job may take minutes, and nobody waits for its result any more
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


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


@contextmanager
def cluster(scheduler: str) -> Iterator[Executor]:
    """Provide the workers of a Dask cluster, which continue to run after the block.

    Raises
    ------
    UsageError
        If the scheduler does not answer.
    MissingExtraError
        If distributed is not installed.
    """
    distributed = import_extra("distributed", "a Dask cluster", "distributed", "dask")
    try:
        client = distributed.Client(scheduler, timeout=_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {scheduler} ({error}): start it as docs/laboratory.md "
            "shows, and name its address, such as tcp://10.0.0.1:8786"
        ) from error
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()


def mapped(
    workers: Executor, run: Callable[[Job], Result], jobs: Iterable[Job]
) -> Iterator[tuple[Job, Result | Exception]]:
    """Run every job, and yield it with its result, or with its error, as it ends.

    Parameters
    ----------
    run : callable
        A function of a module, so that other processes can import it.

    Raises
    ------
    EdgeVprError
        If a worker of this machine dies, or the cluster cannot be reached any more.
    """
    # Ctrl-C reaches the whole group of a terminal; processes that are started here inherit the
    # mask, and this one alone is interrupted
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        waiting = {workers.submit(run, job): job for job in jobs}
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    for future in as_completed(waiting):
        try:
            result: Result | Exception = future.result()
        except BrokenProcessPool as error:
            raise EdgeVprError(
                "a worker died: it may have run out of memory, or was killed; run fewer --workers, "
                "with --resume"
            ) from error
        except CancelledError as error:
            raise EdgeVprError(
                "the cluster's scheduler is gone: run again with --resume"
            ) from error
        except Exception as error:
            result = error
        yield waiting[future], result


def trial_line(name: str, number: int, trials: int, begin_s: float, failed: int) -> str:
    """Return the line that tells of a finished trial, `number` of so many, of a run.

    Parameters
    ----------
    begin_s : float
        Of `time.monotonic`, when the run began.
    failed : int
        Trials that have failed so far.
    """
    seconds = time.monotonic() - begin_s
    line = f"{name}: trial {number} of {trials}, after {seconds:.0f} s"
    return f"{line}, {failed} failed" if failed else line


def error_text(error: Exception) -> str:
    """Return the error of a job in one line."""
    kind = "" if isinstance(error, EdgeVprError) else f"internal error, {type(error).__name__}: "
    return printable(f"{kind}{error}")
