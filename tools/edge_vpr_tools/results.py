"""A folder of results: whole or not there at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edge_vpr.errors import UsageError

MAP, MATCHES, MATCHES_CSV, QUERIES = "map.npz", "matches.npz", "matches.csv", "queries.npz"
QUERIES_KIND = "set of query descriptors"
RUN, METRICS, REPORT = "run.json", "metrics.json", "report.html"


def check_output_folder(path: Path, overwrite: bool) -> None:
    """Refuse a folder that cannot be written, before any work is done.

    Raises
    ------
    UsageError
        If it exists and may not be replaced, or does not look like one of ours.
    """
    if not path.exists():
        if not path.absolute().parent.is_dir():
            raise UsageError(f"{path.absolute().parent} is not a folder: make it first")
        return
    if not overwrite:
        raise UsageError(f"output {path} exists: name another one, or replace it with --overwrite")
    ours = path.is_dir() and (not any(path.iterdir()) or (path / RUN).is_file())
    if not ours:
        raise UsageError(
            f"output {path} is not a folder of edge-vpr's results (no {RUN} in it), so that it is "
            "not replaced: name another one"
        )


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
