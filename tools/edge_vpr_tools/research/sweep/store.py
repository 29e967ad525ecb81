"""Folder of a sweep: results and failures under their keys, and the names of the trials."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import edge_vpr
from edge_vpr.errors import UsageError
from edge_vpr.files import read_json
from edge_vpr.results import RecordError, check_parent, from_json, write_json
from edge_vpr_tools.research.sweep.plan import KeptFailure, KeptResult, TrialResult

T = TypeVar("T")
K = TypeVar("K", KeptResult, KeptFailure)
SWEEP = "sweep.json"
_RESULTS, _FAILURES, _LOCK = "results", "failures", ".lock"
_REMEDY = "remove it, and the sweep computes it again"


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


class Store:
    """Stores results, so that none is computed twice.

    A result is written whole or not at all, as soon as it is known. After an interruption, the
    folder has all finished results.

    Parameters
    ----------
    folder : Path
        Created if it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

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
                inner.name in (_LOCK, _RESULTS, _FAILURES) for inner in self.folder.iterdir()
            )
            if not empty:
                raise UsageError(
                    f"{self.folder} is not the folder of a sweep: name another one, or a new one"
                )
        for inner in (SWEEP, _RESULTS, _FAILURES, _LOCK):
            # what is written through it would replace a file elsewhere
            if (self.folder / inner).is_symlink():
                raise UsageError(f"{self.folder / inner} is a link: name another folder")
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

    def list_trials(self, trials: Sequence[ListedTrial]) -> None:
        """Write the names and keys of the sweep's trials."""
        write_json(self.folder / SWEEP, SweepRecord(schema=1, trials=tuple(trials)))

    def listed(self) -> tuple[ListedTrial, ...]:
        """Read the names and keys of the sweep's trials.

        Raises
        ------
        UsageError
            If the file is missing or damaged.
        """
        return self._read(SweepRecord, self.folder / SWEEP, "run edge-vpr sweep again").trials

    def keep_result(self, result: KeptResult) -> None:
        """Write a result, and delete an earlier failure under its key."""
        write_json(self._path(_RESULTS, result.key), result)
        self._path(_FAILURES, result.key).unlink(missing_ok=True)

    def keep_failure(self, failure: KeptFailure) -> None:
        """Write a failure."""
        write_json(self._path(_FAILURES, failure.key), failure)

    def result(self, key: str) -> TrialResult | None:
        """Return the result under a key; None if there is none. See `kept`."""
        kept = self.kept(key)
        return None if kept is None else kept.found

    def kept(self, key: str) -> KeptResult | None:
        """Return the result under a key, with its trial; None if there is none.

        Raises
        ------
        UsageError
            If its file is damaged, or of another trial.
        """
        path = self._path(_RESULTS, key)
        return self._of_key(KeptResult, path, key) if path.is_file() else None

    def failure(self, key: str) -> str | None:
        """Return the error under a key; None if there is none.

        Raises
        ------
        UsageError
            If its file is damaged, or of another trial.
        """
        path = self._path(_FAILURES, key)
        return self._of_key(KeptFailure, path, key).error if path.is_file() else None

    def _path(self, kind: str, key: str) -> Path:
        if not key.isalnum():  # read from a file: it must not lead to another folder
            raise UsageError(f"{self.folder}: {key!r} is no key of a result: run the sweep again")
        return self.folder / kind / f"{key}.json"

    def _of_key(self, kind: type[K], path: Path, key: str) -> K:
        """Read a file, which may have been copied or changed; compare its trial with the key."""
        found = self._read(kind, path, _REMEDY)
        # another version makes another key of the same trial
        of_trial = key if found.trial.version != edge_vpr.__version__ else found.trial.key
        if not key == found.key == of_trial:
            raise UsageError(f"{path} holds another trial than its name says: {_REMEDY}")
        return found

    @staticmethod
    def _read(kind: type[T], path: Path, remedy: str) -> T:
        try:
            return from_json(kind, read_json(path, "a sweep's file", remedy))
        except RecordError as error:
            raise UsageError(f"cannot read {path}: {error}: {remedy}") from None
