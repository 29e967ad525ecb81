"""Conversion of all exceptions of parsing libraries to `EdgeVprError`.

The parsers behind the readers (zip, NumPy's headers, HDF5, Arrow, rosbags, Pillow, Rust) raise
exceptions of any kind for a damaged file. Readers handle those that they expect; this module
converts all others to a :class:`RecordingError` that names the file and the place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from edge_vpr.errors import EdgeVprError, MissingExtraError, RecordingError, printable


@contextmanager
def foreign_errors(path: Path, place: Callable[[], str] = lambda: "") -> Iterator[None]:
    """Convert any exception of the block to an `EdgeVprError` that names `path`.

    Parameters
    ----------
    path : Path
    place : callable
        Returns the place in the file at the time of the error, as ``" after event 5"``, or "".

    Raises
    ------
    RecordingError
        For every exception that is not an `EdgeVprError`. Interrupts are not converted.
    """
    try:
        yield
    except MissingExtraError:
        raise
    except EdgeVprError as error:
        if printable(str(path)) in str(error):
            raise
        raise RecordingError(f"{path}: {error}") from error  # concerns text within the file
    except OSError as error:
        if error.strerror is None:  # raised by a library, and not by the operating system
            raise _damaged(path, place(), error) from error
        raise RecordingError(
            f"{path} cannot be read{place()}: {error.strerror}: check the path and the disk"
        ) from error
    except MemoryError as error:
        raise RecordingError(
            f"{path} needs more memory{place()} than there is: it is damaged, or give it more"
        ) from error
    except Exception as error:
        raise _damaged(path, place(), error) from error
    except BaseException as error:
        # a library written in Rust raises this when it fails internally
        if type(error).__name__ != "PanicException":
            raise
        raise _damaged(path, place(), error) from error


def _damaged(path: Path, place: str, error: BaseException) -> RecordingError:
    return RecordingError(
        f"{path} is damaged{place} ({type(error).__name__}: {error}): copy or record it again"
    )
