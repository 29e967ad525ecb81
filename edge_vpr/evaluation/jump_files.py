"""Jump files: tables of pairs of places between which one step can lead."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.track_files import read_table


def load_jumps(path: str | Path, places: int) -> npt.NDArray[np.int32]:
    """Read jumps from a ``.csv`` table.

    Parameters
    ----------
    path : str or Path
        With the header ``from,to``: from the first place of a row, one step leads to the second.
        For both directions, give two rows.
    places : int
        Number of places of the map, which are counted from 0.

    Returns
    -------
    ndarray of int32, shape (n, 2)

    Raises
    ------
    GroundTruthError
        If the file cannot be read, is not of this form, or names a place that the map lacks.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise GroundTruthError(f"{path} is no list of jumps: give a .csv table")
    header, table = read_table(path)
    if header != ("from", "to"):
        raise GroundTruthError(f"{path} has the header {','.join(header)!r}: expected from,to")
    wrong = (table != np.floor(table)) | (table < 0) | (table >= places)
    rows = np.flatnonzero(wrong.any(axis=1) | (table[:, 0] == table[:, 1]))
    if rows.size:
        begin, end = table[rows[0]].tolist()
        raise GroundTruthError(
            f"{path}: row {rows[0] + 1} is {begin:g},{end:g}: expected two places of the map, from "
            f"0 to {places - 1}"
        )
    return table.astype(np.int32)
