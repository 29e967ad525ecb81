"""Writing of files and folders whole or not at all, whatever ends the run; opening of files.

A result is written into a hidden folder next to its place, ``.edge-vpr-*.part``, and then renamed.
An old folder is first renamed to ``edge-vpr-old-*``, and removed when the new one is in place.

After a crash, a kill or a power cut:

- The name of a file has its old or its new content. The name of a folder may be missing for an
  instant; the old folder is then next to it, and no run changes or removes it.
- The hidden folder remains. The next run that writes to the same place removes it. Nothing in it is
  used again.

A hidden folder is removed only if it is a folder of this user and no process has locked it. Links
are not followed, neither in its place nor inside it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path

from edge_vpr.errors import UsageError

_WORK = re.compile(r"\.edge-vpr-[0-9a-f]{16}\.part")
#: errors that only writing raises, often without the name of a file
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing(path: str | Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield the path of a temporary file that replaces `path` if the block succeeds.

    After an error or an interrupt, `path` is unchanged. If it is a link, its target is replaced.
    The file keeps the permissions of the old one, or gets those of the umask. File and folder are
    on the disk (fsync) when this returns.

    Parameters
    ----------
    overwrite : bool
        Whether a file may be replaced, also one that another run writes in the meantime.

    Yields
    ------
    Path
        Of the same name, in a folder of its own; an empty file is there.

    Raises
    ------
    UsageError
        If the folder does not exist or cannot be written to, `path` is not a file, or it exists
        and may not be replaced.
    """
    target = _followed(Path(path))
    mode = _mode_of_file(target)
    check_absent(path, overwrite)
    with work_folder(target) as work:
        temporary = work / target.name
        temporary.touch()
        yield temporary
        if mode is not None:
            temporary.chmod(mode)
        _sync(temporary)
        if overwrite:
            temporary.replace(target)
        else:
            _name_new_file(temporary, target)
        _sync(target.parent)


@contextmanager
def replacing_folder(path: str | Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield an empty temporary folder that replaces `path` if the block succeeds.

    After an error or an interrupt, `path` is unchanged. A power cut between two steps can leave the
    old folder under the name ``edge-vpr-old-*``.

    Parameters
    ----------
    path : path
        A folder, all of which is replaced, or nothing.
    overwrite : bool
        Whether a folder that is not empty may be replaced, also one that another run writes in the
        meantime.

    Raises
    ------
    UsageError
        If the folder around it does not exist or cannot be written to, `path` is a file, or a
        folder is there that may not be replaced.
    """
    target = _followed(Path(path))
    if target.exists() and not target.is_dir():
        raise UsageError(f"cannot write the folder {path}: there is a file of this name")
    if target.exists() and any(target.iterdir()):
        check_absent(path, overwrite)
    with work_folder(target) as work:
        new = work / target.name
        new.mkdir()
        yield new
        for folder, _, files in os.walk(new):
            for name in files:
                _sync(Path(folder) / name)
            _sync(Path(folder))
        if overwrite and target.exists():
            _replace_folder(new, target)
        else:
            _name_new_folder(new, target)
        _sync(target.parent)


def check_output(output: str | Path, inputs: Iterable[str | Path | None]) -> None:
    """Raise if writing an output would destroy or change an input of the same run.

    Parameters
    ----------
    output : path
        File or folder to write; need not exist.
    inputs : iterable of path
        Files or folders to read, or None; those that do not exist are left to their readers.

    Raises
    ------
    UsageError
        If an input is the output (also by another name or link), lies in it, or is around it.
    """
    wanted = _followed(Path(output))
    for named in inputs:
        if named is None:
            continue
        source = Path(named)
        if not source.exists():
            continue
        real = source.resolve()
        if real == wanted or (wanted.exists() and wanted.samefile(real)):
            raise UsageError(f"output {output} is the input {named}: name another output")
        if real.is_relative_to(wanted):
            raise UsageError(
                f"output {output} is a folder that holds the input {named}: name another output"
            )
        if real.is_dir() and wanted.is_relative_to(real):
            raise UsageError(f"output {output} lies in the input {named}: name an output outside")


def check_absent(output: str | Path, overwrite: bool) -> None:
    """Raise UsageError if an output exists and may not be replaced."""
    if not overwrite and Path(output).exists():
        raise UsageError(f"output {output} exists: name another, or replace it with overwrite=True")


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


def check_new_file(path: Path, inputs: Iterable[str | Path | None], overwrite: bool) -> None:
    """Check that a file can be written, before any work is done.

    Parameters
    ----------
    inputs : iterable of path or None
        What the run reads, see `check_output`.
    overwrite : bool
        Whether an existing file may be replaced.
    """
    check_output(path, inputs)
    check_parent(path)
    check_absent(path, overwrite)


def check_new_map(path: Path, inputs: Iterable[str | Path | None], overwrite: bool) -> None:
    """Check that a map can be written, before any work is done; see `check_new_file`."""
    check_new_file(path, inputs, overwrite)
    if path.suffix != ".npz":
        raise UsageError(f"output {path} does not end in .npz: name the map for example map.npz")


def _can_create(folder: Path) -> bool:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def clear_dead_runs(folder: str | Path) -> None:
    """Remove what killed runs of this user left in a folder; follow no links.

    Folders of running processes are locked and left alone, and so are folders of other users and
    those that cannot be locked or removed.
    """
    for work in Path(folder).glob(".edge-vpr-*.part"):
        if _WORK.fullmatch(work.name):
            with suppress(OSError):
                _remove_dead(work)


def _remove_dead(work: Path) -> None:
    lock = _locked(work)
    if lock is None:
        return
    try:
        if os.fstat(lock).st_uid == os.geteuid():
            shutil.rmtree(work)  # removes links, and does not follow them
    finally:
        os.close(lock)


@contextmanager
def work_folder(target: Path) -> Iterator[Path]:
    """Yield a hidden folder next to the target, which is removed at the end or by a later run.

    Parameters
    ----------
    target : path
        What is to be written; the folder is locked as long as this process lives.

    Raises
    ------
    UsageError
        If the folder around the target does not exist or cannot be written to.
    """
    clear_dead_runs(target.parent)
    try:
        work, lock = _made_and_locked(target.parent)
    except OSError as error:
        raise UsageError(
            f"cannot write {target}: {error.strerror}: name a folder that exists and is writable"
        ) from error
    try:
        yield work
    except Exception as error:
        _name_target(error, work, target)
        raise
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def _name_target(error: Exception, work: Path, target: Path) -> None:
    """Name what the user asked for in an error that names the hidden folder, or nothing."""
    hidden, shown = f"{work}{os.sep}", str(target.parent / "_")[:-1]
    error.args = tuple(
        one.replace(hidden, shown) if isinstance(one, str) else one for one in error.args
    )
    if isinstance(error, OSError):
        if isinstance(error.filename, str | bytes):
            error.filename = os.fsdecode(error.filename).replace(hidden, shown)
        elif error.filename is None and error.errno in _FULL:
            error.filename = str(target)


def _made_and_locked(parent: Path) -> tuple[Path, int | None]:
    while True:
        work = parent / f".edge-vpr-{secrets.token_hex(8)}.part"
        work.mkdir(mode=0o700)
        try:
            lock = _locked(work)
        except FileNotFoundError:
            continue  # another run removed it before it was locked
        except OSError:
            return work, None  # on a file system without locks, no other run removes anything
        if lock is not None and work.exists():
            return work, lock


def _locked(work: Path) -> int | None:
    """Lock a folder, and return its handle; None if another process has locked it."""
    handle = os.open(work, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    except BaseException:
        os.close(handle)
        raise
    return handle


def _followed(path: Path) -> Path:
    """Follow links to the final path, which need not exist."""
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        raise UsageError(f"{path} is a link that leads back to itself: remove it") from error


def _mode_of_file(target: Path) -> int | None:
    """Return the permissions of a file; None if it does not exist."""
    try:
        status = target.stat()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise UsageError(
            f"cannot write {target}: {error.strerror}: name a folder that exists and is writable"
        ) from error
    if not stat.S_ISREG(status.st_mode):
        raise UsageError(f"cannot write {target}: it is not a file: name another one")
    return stat.S_IMODE(status.st_mode)


def _name_new_file(new: Path, target: Path) -> None:
    """Give a file a name that no file has, however many runs do so at the same time."""
    try:
        os.link(new, target)
    except FileExistsError:
        raise _taken(target) from None
    except OSError:
        # a file system without hard links
        if target.exists():
            raise _taken(target) from None
        new.rename(target)


def _name_new_folder(new: Path, target: Path) -> None:
    """Give a folder a name that no other has but an empty one; see `_name_new_file`."""
    try:
        new.rename(target)
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
            raise _taken(target) from None
        raise


def _taken(target: Path) -> UsageError:
    return UsageError(
        f"another run wrote {target} in the meantime, and its result stays: name another output"
    )


def _replace_folder(new: Path, target: Path) -> None:
    """Replace a folder by another one, in two renames."""
    old = target.with_name(f"edge-vpr-old-{secrets.token_hex(8)}")
    try:
        with suppress(FileNotFoundError):  # another run replaces it at the same time
            target.rename(old)
        _name_new_folder(new, target)
    except BaseException:
        if old.exists() and not target.exists():
            old.rename(target)
        raise
    _sync(target.parent)
    shutil.rmtree(old, ignore_errors=True)


def link(other: str | Path, path: Path) -> bool:
    """Replace a file by a hard link to another; return False where the file system has none."""
    path.unlink()
    with suppress(OSError):
        os.link(other, path)
        return True
    path.touch()
    return False


def _sync(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    except OSError as error:
        # some file systems cannot sync folders; other errors are raised
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
            raise
    finally:
        os.close(handle)


# Opening of input files.


def open_input(path: str | Path) -> BufferedReader:
    """Open a file to read from; every file that a user names is opened here.

    Raises
    ------
    OSError
        As `check_is_file`, or if it may not be read.
    """
    check_is_file(path)
    return Path(path).open("rb")


def check_is_file(path: str | Path) -> None:
    """Refuse what has no end, would be waited for, or cannot be read twice, also behind a link.

    Called by itself where a library opens the file.

    Raises
    ------
    OSError
        If there is nothing at `path`, or a folder, pipe, device or socket; `strerror` says which.
    """
    mode = Path(path).stat().st_mode
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "device")
        number = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
        raise OSError(number, f"it is a {kind}, not a file", str(path))


_KINDS = {stat.S_IFDIR: "folder", stat.S_IFIFO: "pipe", stat.S_IFSOCK: "socket"}
