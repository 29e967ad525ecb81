"""Open HDF5 files, and check what each data set claims before it is read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from edge_vpr.errors import MissingExtraError, RecordingError
from edge_vpr.recordings.hdf5_chunks import CheckedDataset

#: Most bytes of one expanded chunk; several are kept, so that no chunk is read twice.
_LARGEST_CHUNK = 1 << 25
#: Largest ratio of a data set's stated size to its size in the file: Deflate reaches 1,032.
_MOST_EXPANSION = 1_100


def load_h5py() -> Any:
    """Import h5py, or raise an error that names the extra with it."""
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("an HDF5 file", "h5py", "hdf5") from error
    return h5py


def open_hdf5(path: Path) -> Any:
    """Open a file for reading.

    Raises
    ------
    RecordingError
        If it is damaged.
    """
    try:
        return load_h5py().File(path, "r", rdcc_nbytes=_LARGEST_CHUNK, locking=False)
    except OSError as error:
        raise RecordingError(
            f"{path} is damaged, cut off or no HDF5 file ({error}): copy it again"
        ) from error


def checked_dataset(path: Path, dataset: Any) -> CheckedDataset:
    """Refuse data outside the file, and stated sizes that are impossible for the file's size.

    Returns
    -------
    CheckedDataset
        Reader of the dataset.

    Raises
    ------
    RecordingError
    """
    name = f"{path}: {dataset.name}"
    if dataset.external or dataset.is_virtual:
        raise RecordingError(
            f"{name} lies in other files, which are not read: copy it into one file"
        )
    pipeline = dataset.id.get_create_plist()
    filters = [pipeline.get_filter(i)[0] for i in range(pipeline.get_nfilters())]
    chunk = math.prod(dataset.chunks or (1,)) * dataset.dtype.itemsize
    if chunk > _LARGEST_CHUNK or len(set(filters)) < len(filters):
        raise RecordingError(
            f"{name} is stored in chunks of {chunk:,} bytes through {len(filters)} filters: "
            f"the most is {_LARGEST_CHUNK:,} bytes, and each filter once; write it again"
        )
    claimed = dataset.size * dataset.dtype.itemsize
    held = min(dataset.id.get_storage_size(), path.stat().st_size)
    if claimed > (held * _MOST_EXPANSION if dataset.chunks and filters else held):
        raise RecordingError(
            f"{name} claims {claimed:,} bytes, and the file holds {held:,} of them: it was "
            "not closed when it was written, or is damaged; copy or record it again"
        )
    return CheckedDataset(dataset, name)
