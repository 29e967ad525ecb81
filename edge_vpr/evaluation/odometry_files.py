"""Odometry files: tables of time and distance, or of time and speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from edge_vpr.errors import GroundTruthError, UsageError
from edge_vpr.evaluation.track_files import read_table
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.odometry import MOST_MM, Odometry
from edge_vpr.whole_files import replacing


def load_odometry(path: str | Path) -> Odometry:
    """Read odometry from a ``.csv`` table.

    Parameters
    ----------
    path : str or Path
        With the header ``time_s,distance_m`` (the reading of an odometer, from any zero), or
        ``time_s,speed_mps`` (below 0 backwards; between two rows the mean of both holds). Times in
        seconds from the recording's start.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, is not of this form, or holds values out of range.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise GroundTruthError(f"{path} is not odometry: give a .csv table")
    header, table = read_table(path)
    speeds = header == ("time_s", "speed_mps")
    if not speeds and header != ("time_s", "distance_m"):
        raise GroundTruthError(
            f"{path} has the header {','.join(header)!r}: expected time_s,distance_m or "
            "time_s,speed_mps"
        )
    time_s, values = table.T
    if speeds:
        with np.errstate(all="ignore"):  # too large values are refused below
            legs = (values[1:] + values[:-1]) / 2 * np.diff(time_s)
            values = np.concatenate([[0.0], np.cumsum(legs)])
    if not (np.abs(time_s) * 1e6 <= TIME_LIMIT_US).all():
        raise GroundTruthError(
            f"{path} has times up to {np.abs(time_s).max():g} s: give seconds from the recording's "
            "start"
        )
    if not (np.abs(values) * 1e3 <= MOST_MM).all():
        raise GroundTruthError(
            f"{path} has ways up to {np.abs(values).max():g} m: expected at most {MOST_MM // 1000}"
        )
    try:
        return Odometry(
            np.rint(time_s * 1e6).astype(np.int64), np.rint(values * 1e3).astype(np.int64)
        )
    except UsageError as error:
        raise GroundTruthError(f"{path}: {error}") from None


def save_odometry(path: str | Path, odometry: Odometry) -> None:
    """Write readings as a table for `load_odometry`, atomically.

    Parameters
    ----------
    path : str or Path
        A ``.csv`` file.
    odometry : Odometry
    """
    rows = zip(odometry.time_us.tolist(), odometry.distance_mm.tolist(), strict=True)
    with replacing(path) as temporary, temporary.open("w", encoding="ascii") as file:
        file.write("time_s,distance_m\n")
        file.writelines(f"{t / 1e6:.6f},{mm / 1e3:.3f}\n" for t, mm in rows)
