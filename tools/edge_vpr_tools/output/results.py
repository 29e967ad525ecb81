"""Folders of results, which are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.whole_files import check_output, clear_dead_runs, replacing_folder

MAP, MATCHES, MATCHES_CSV, QUERIES = "map.npz", "matches.npz", "matches.csv", "queries.npz"
QUERIES_KIND = "set of query descriptors"
_SUFFIXES = (".npz", ".csv", ".json", ".md", ".png", ".pdf", ".svg", ".html")
RUN, METRICS, REPORT = "run.json", "metrics.json", "report.html"


def check_output_folder(
    path: Path, overwrite: bool, inputs: Iterable[str | Path | None] = ()
) -> None:
    """Check that a folder can be written, before any work is done.

    Parameters
    ----------
    path : path
    overwrite : bool
    inputs : iterable of path or None
        What the run reads, see `check_output`; None is not given.

    Raises
    ------
    UsageError
        If it exists and may not be replaced, does not look like one of ours, or an input would be
        lost.
    """
    check_output(path, inputs)
    check_parent(path)
    clear_dead_runs(path.absolute().parent)
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
    """Check that the folder of an output exists and is writable, before any work is done.

    Raises
    ------
    UsageError
        If it does not exist, or is not writable.
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
    """Yield an empty folder that becomes `path` if the block succeeds, see `replacing_folder`.

    Raises
    ------
    UsageError
        See `check_output_folder`.
    """
    check_output_folder(path, overwrite)
    with replacing_folder(path) as folder:
        yield folder
