"""A folder of results: whole or not there at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edge_vpr.errors import UsageError

MAP, MATCHES, MATCHES_CSV, QUERIES = "map.npz", "matches.npz", "matches.csv", "queries.npz"
QUERIES_KIND = "set of query descriptors"
_SUFFIXES = (".npz", ".csv", ".json", ".png", ".html")
RUN, METRICS, REPORT = "run.json", "metrics.json", "report.html"


def check_output_folder(path: Path, overwrite: bool) -> None:
    """Refuse a folder that cannot be written, before any work is done.

    Raises
    ------
    UsageError
        If it exists and may not be replaced, or does not look like one of ours.
    """
    check_parent(path)
    if not path.exists():
        return
    if not overwrite:
        raise UsageError(f"output {path} exists: name another one, or replace it with --overwrite")
    ours = path.is_dir() and (not any(path.iterdir()) or (path / RUN).is_file())
    if not ours:
        raise UsageError(
            f"output {path} is not a folder of edge-vpr's results (no {RUN} in it), so that it is "
            "not replaced: name another one"
        )
    foreign = sorted(file.name for file in path.iterdir() if not _is_ours(file))
    if foreign:
        raise UsageError(
            f"output {path} also holds {foreign[0]!r}, which is not ours to delete: move it away, "
            "or name another folder"
        )


def check_parent(path: Path) -> None:
    """Refuse an output whose folder is missing or not writable, before any work is done.

    Raises
    ------
    UsageError
        If it is.
    """
    parent = path.absolute().parent
    if not parent.is_dir():
        raise UsageError(f"{parent} is not a folder: make it first")
    if not os.access(parent, os.W_OK) or not _can_create(parent):
        raise UsageError(f"cannot write {path}: {parent} is not writable: name another folder")


def _can_create(folder: Path) -> bool:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _is_ours(file: Path) -> bool:
    return file.is_file() and file.suffix in _SUFFIXES


@contextmanager
def results_folder(path: Path, overwrite: bool) -> Iterator[Path]:
    """Give an empty folder that becomes `path` when the block ends well.

    After an error or an interrupt it is gone and `path` is as it was.

    Raises
    ------
    UsageError
        See `check_output_folder`.
    """
    check_output_folder(path, overwrite)
    with whole_folder(path) as work:
        yield work


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Give an empty folder that takes the place of `path` when the block ends well.

    What `path` holds is deleted then: check it before.
    """
    path = path.absolute()
    work = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))
    try:
        work.chmod(0o755)
        yield work
        if path.exists():
            old = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.old."))
            path.rename(old / path.name)
            work.rename(path)
            shutil.rmtree(old)
        else:
            work.rename(path)
    finally:
        shutil.rmtree(work, ignore_errors=True)
