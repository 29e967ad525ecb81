"""Files that are records of one size behind a header."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.recordings.faults import FaultLog


def read_records(
    path: Path, begin: int, dtype: np.dtype[Any], number: int, log: FaultLog, what: str = "an event"
) -> Iterator[tuple[npt.NDArray[Any], float]]:
    """Yield the records from byte `begin` on, up to `number` at a time.

    Beside each part is the share of the file up to its end. `what` names a record in the report of
    a last one that is cut off.
    """
    size = max(1, path.stat().st_size)
    with path.open("rb") as file:
        file.seek(begin)
        while data := file.read(number * dtype.itemsize):
            yield np.frombuffer(data, dtype, len(data) // dtype.itemsize), file.tell() / size
            if leftover := len(data) % dtype.itemsize:
                log.truncated(leftover, f"byte {size - leftover:,}, within {what}")
