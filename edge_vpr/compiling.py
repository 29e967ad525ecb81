"""Kernels compiled by Numba, which release the GIL and are cached on disk; and their state."""

from __future__ import annotations

import hashlib
import io
import pickle
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
from numba import config, njit, types
from numba.core import caching, event
from numba.core.dispatcher import Dispatcher

from edge_vpr.run_log import COMPILING, DAMAGED, tell

# Compilation of kernels, and the cache of compiled code.
#
# Numba discards cached code only if the kernel's own module changes. The code also contains the
# kernels that it calls and the constants that it uses, from other modules. `kernel` adds them to
# the stamp that Numba compares before it loads code.
#
# Each file of compiled code ends with a checksum. If one is truncated or damaged, for example after
# a power cut, all are deleted before anything in it is used, and kernels are compiled again.


_DIGEST_BYTES = 32
# these have no types
_CACHING: Any = caching
_EVENT: Any = event
_CONSTANTS = (bool, int, float, tuple, np.dtype, np.integer, np.floating)
#: what Python may call and the cache keeps, by module and name
_KERNELS: dict[tuple[str, str], Dispatcher] = {}


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    inline: Literal["never", "always"] = "never",
    inner: bool = False,
) -> Any:
    """Compile a function at its first call, and cache the code for later runs.

    Parameters
    ----------
    function : callable
        Passed where the decorator is used without options.
    inline : {"never", "always"}
        "always": its code is copied into the kernels that call it.
    inner : bool
        Whether only kernels call it. No wrapper for calls from Python is compiled, since that takes
        long for many arguments; a call from Python would crash the process.

    Returns
    -------
    callable
        The compiled function; the function itself if the compiler is off (NUMBA_DISABLE_JIT).
    """
    if function is None:
        return lambda decorated: kernel(decorated, inline=inline, inner=inner)
    options: Any = {"nogil": True, "inline": inline, "no_cpython_wrapper": inner}
    options["no_cfunc_wrapper"] = True  # no C code calls kernels
    try:
        compiled = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the cache is writable: compile in each run
        return njit(**options)(function)
    cache = getattr(compiled, "_cache", None)
    if isinstance(cache, _CACHING.FunctionCache):
        cache._cache_file = _CheckedCacheFile(
            cache.cache_path,
            cache._impl.filename_base,
            (cache._cache_file._source_stamp, _imported(function)),
        )
        if not inner:
            _KERNELS[function.__module__, function.__qualname__] = compiled
    return compiled


def plain(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the Python function of a kernel; for a few numbers it needs no compilation."""
    function: Callable[..., Any] = getattr(kernel, "py_func", kernel)
    return function


def specialise(kernel: Callable[..., Any], *examples: object) -> Callable[..., Any]:
    """Return the compiled code of a kernel for arguments of the same types as the examples.

    A kernel resolves the types of its arguments at each call. This takes 1 us for a `KernelState`,
    and longer than the rest of the call if other work has evicted the caches. The code must never
    be called with arguments of other types.
    """
    if not isinstance(kernel, Dispatcher):
        return kernel
    code: Callable[..., Any] = kernel.compile(tuple(map(kernel.typeof_pyval, examples)))
    return code


def checked_code(file: Path) -> io.BytesIO | None:
    """Return the content of a file of compiled code without its checksum; None if it is damaged.

    Returns
    -------
    BytesIO or None
        Two pickles: ``(version of Numba, stamp of the source, name of the file)``, and the index of
        a kernel (``.nbi``) or its compiled code for one key of the index (``.nbc``).

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    data = file.read_bytes()
    content = data[:-_DIGEST_BYTES]
    return io.BytesIO(content) if data == _with_digest(content) else None


def _with_digest(content: bytes) -> bytes:
    return content + hashlib.blake2b(content, digest_size=_DIGEST_BYTES).digest()


class _CheckedCacheFile(_CACHING.IndexDataCacheFile):  # type: ignore[misc]
    """Numba's files of a kernel, with a checksum at the end of each.

    Code is stored with its name and key, which are compared when it is loaded: a power cut can
    leave a new index beside older code.
    """

    def save(self, key: object, data: object) -> None:
        # a full disk must not end a run: code that cannot be cached is compiled again next time
        with suppress(OSError):
            super().save(key, (key, data))

    def load(self, key: object) -> object:
        stored_key, data = super().load(key) or (None, None)
        return data if stored_key == key else None

    def _save_index(self, overloads: dict[object, str]) -> None:
        self._save_data(self._index_name, overloads)

    def _load_index(self) -> dict[object, str]:
        return self._load_data(self._index_name) or {}

    def _save_data(self, name: str, data: object) -> None:
        content = self._dump(self._header(name)) + self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(_with_digest(content))

    def _load_data(self, name: str) -> Any:
        path = Path(self._data_path(name))
        try:
            content = checked_code(path)
        except FileNotFoundError:
            return None
        except OSError:  # for example a disk error
            content = None
        if content is None:
            _delete_all()
            tell(DAMAGED)
            return None
        if pickle.load(content) != self._header(name):
            return None
        return pickle.load(content)

    def _header(self, name: str) -> tuple[object, ...]:
        return self._version, self._source_stamp, name


def _delete_all() -> None:
    """Delete the compiled code of all kernels."""
    for folder in {kernel.stats.cache_path for kernel in _KERNELS.values()}:
        for file in Path(str(folder)).glob("*.nb[icw]"):
            with suppress(OSError):
                file.unlink()


def _imported(function: Callable[..., Any]) -> str:
    """Return a digest of the kernels and constants that the function's module has defined so far.

    A kernel enters with the stamp of its source, which covers the kernels that it calls in turn.
    """
    imported: list[tuple[Any, ...]] = []
    for name, value in sorted(function.__globals__.items()):
        file = _cache_file(value)
        if file is not None:
            imported.append((name, file._source_stamp))
        elif isinstance(value, type) and issubclass(value, tuple):
            imported.append((name, getattr(value, "_fields", ())))
        elif isinstance(value, np.ndarray):
            imported.append((name, value.dtype, value.shape, value.tobytes()))
        elif isinstance(value, _CONSTANTS):
            imported.append((name, value))
    return hashlib.sha256(repr(imported).encode()).hexdigest()


def _cache_file(value: object) -> Any:
    """Return Numba's record of where a kernel is kept; None for anything else."""
    return getattr(getattr(value, "_cache", None), "_cache_file", None)


# Code before it is needed, and the time that compiling and loading it takes.


def have_kernels(work: str, drive: Callable[[], object]) -> None:
    """Load the kernels of some work, so that it never waits for them; compile those that are new.

    Parameters
    ----------
    work : str
        Name of the work with all that decides which kernels it calls, and with which types.
    drive : callable
        Calls all of them; is called only if nothing is noted of this work. After it, the kernels
        of this process are noted beside their code.
    """
    if config.DISABLE_JIT:
        return
    if to_kernel_state.stats.cache_path is None:
        drive()
        return
    stamps = [(*name, _cache_file(kernel)._source_stamp) for name, kernel in _KERNELS.items()]
    stamp = repr((numba.__version__, sys.version, sorted(stamps)))
    digest = hashlib.sha256(work.encode()).hexdigest()[:16]
    file = Path(to_kernel_state.stats.cache_path) / f"work-{digest}.nbw"
    try:
        noted = checked_code(file)
    except OSError:
        noted = None
    if noted is None or pickle.load(noted) != stamp:
        drive()
        code = [(*name, [*kernel.overloads]) for name, kernel in _KERNELS.items()]
        content = pickle.dumps(stamp) + pickle.dumps([each for each in code if each[-1]])
        with suppress(OSError):
            file.write_bytes(_with_digest(content))
        return
    for module, name, signatures in pickle.load(noted):
        import_module(module)
        for signature in signatures:
            _KERNELS[module, name].compile(signature)


class _Watch(_EVENT.Listener):  # type: ignore[misc]
    """Tells that kernels are compiled, and sums the time in which they are compiled or loaded."""

    def __init__(self) -> None:
        self.spent_s, self._depth, self._begun_s = 0.0, 0, 0.0
        _EVENT.register("numba:compile", self)
        _EVENT.register("numba:compiler_lock", self)

    def on_start(self, event: Any) -> None:
        if event.kind == "numba:compile":
            tell(COMPILING)
            return
        if not self._depth:
            self._begun_s = time.perf_counter()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        if event.kind == "numba:compile":
            return
        self._depth -= 1
        if not self._depth:
            self.spent_s += time.perf_counter() - self._begun_s


_watch = _Watch()


def working_s() -> float:
    """Return `time.perf_counter` without the time in which kernels were compiled or loaded."""
    return time.perf_counter() - _watch.spent_s


# A tuple of arrays as one argument of a kernel, unpacked only once.
#
# Numba unpacks a tuple of arrays at every call, in 0.2 to 0.3 us per array, which is longer than
# the processing of an event. The tuple of a `KernelState` is unpacked when it is made, so that the
# time of a call does not depend on its size.


if config.DISABLE_JIT:

    class KernelState:
        """State of a kernel where the compiler is off; the classes below are for compiled code."""

        def __init__(self, value: Any) -> None:
            self.value = value

    to_kernel_state = KernelState

else:
    from numba.experimental import structref

    @structref.register
    class KernelStateType(types.StructRef):
        """Numba type of a `KernelState`, by the type of its tuple."""

    class KernelState(structref.StructRefProxy):  # type: ignore[no-redef]
        """Tuple that a kernel receives by its address; only kernels may read `value`."""

        # an attribute instead of a property, which Numba would call twice for each argument
        _numba_type_ = structref.StructRefProxy._type

    structref.define_proxy(KernelState, KernelStateType, ["value"])

    @kernel  # type: ignore[no-redef]
    def to_kernel_state(value):
        """Return a tuple as a `KernelState`, which keeps its arrays alive."""
        return KernelState(value)


def shared_state(value: tuple[Any, ...]) -> KernelState:
    """Return a tuple of arrays as an argument for kernels, which shares the arrays.

    Its `value` consists of plain tuples, also for named tuples: a kernel restores the names by
    ``OnlineState(*kernel_state.value)``. Cached code that refers to the class by name could neither
    be read nor discarded by a later version without that name.

    Parameters
    ----------
    value : tuple
        Of arrays, numbers, and tuples of these.
    """
    state: KernelState = to_kernel_state(_plain(value))
    return state


def _plain(value: Any) -> Any:
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value
