"""Check where compiled kernels are stored, and compile them before they are needed."""

from __future__ import annotations

import glob
import pickle
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numba
from numba import njit
from numba.core import caching
from numba.core.registry import cpu_target

import edge_vpr
import fixedpoint
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import map_traverse, match_traverse
from edge_vpr.settings import PRESETS, resolve_settings
from edge_vpr.simulate import simulate_pair
from edge_vpr.stream.live import LiveLocaliser
from edge_vpr.stream.protocols import PROTOCOLS, open_decoder
from edge_vpr_tools.doctor.finding import Finding

#: "kept": Numba loads it; "older": a source has changed since; "another": processor or Numba
_State = Literal["kept", "older", "another"]
_NUMBA: Any = caching  # has no types
_COMPILE = "edge-vpr doctor --compile, as the user who will run it"


def check_kernels() -> Iterator[Finding]:
    """Find the folder in which Numba stores compiled kernels, and the kernels in it."""
    try:
        folder = _cache_folder()
    except RuntimeError:  # raised by Numba if it can write to no folder
        yield Finding(
            "compiled kernels",
            "wrong",
            "there is no folder where they may be kept",
            "set NUMBA_CACHE_DIR to a folder that this user may write",
        )
        return
    found = Counter(state for _, state in _indexes(folder))
    text = f"{found['kept']} kept in {folder}"
    if found["another"]:
        text = f"{text} for this processor and Numba, {found['another']} for another"
    if found["older"]:
        text = f"{text}, {found['older']} of an older source"
    if found["kept"] and not found["older"]:
        yield Finding("compiled kernels", "good", text)
    else:
        yield Finding("compiled kernels", "absent", f"{text}: the first run takes longer", _COMPILE)


def compile_kernels(show: Callable[[str], None] = lambda text: None) -> None:
    """Compile all kernels of a live run, with every preset and protocol, into Numba's cache.

    Kernels of an older source, which are not loaded any more, are removed first.

    Parameters
    ----------
    show : callable
        Called with a description of each step before it begins.
    """
    for index, state in list(_indexes(_cache_folder())):
        if state == "older":
            for file in (*_compiled(index), index):
                file.unlink(missing_ok=True)
    first, second = simulate_pair(0, length_m=20.0)
    # sums of few pixels have narrower integers, and therefore kernels of their own
    for preset, pixels in product(PRESETS, (25, None)):
        show(f"mapping and matching with preset {preset}")
        # 20 m have only a few of the default windows
        settings = resolve_settings(preset, flags={"tau_us": 200_000, "pixels": pixels})
        reference = map_traverse(first, settings)
        match_traverse(reference, second)
        for causal_bursts in (False, True):
            live = LiveLocaliser(
                open_decoder("evpr", first.sensor),
                reference,
                MatchSchedule(interval_us=50_000),
                causal_bursts=causal_bursts,
            )
            live.finish()
        if settings.matching == "filter":
            late = replace(reference.settings, smooth=False, delay=1)
            LiveLocaliser(live.decoder, reference.matched_with(late)).finish()
    for protocol in PROTOCOLS:
        show(f"decoding protocol {protocol}")
        open_decoder(protocol, first.sensor).warm_up()


def _indexes(folder: Path) -> Iterator[tuple[Path, _State]]:
    """Yield the indexes of Numba's cache that belong to this package, and whether they are used."""
    processor = cpu_target.target_context.codegen().magic_tuple()
    sources = _sources()
    changed_s = max((each.stat().st_mtime for each in sources if each.exists()), default=0.0)
    for source in sources:
        # beside the sources, or in a subfolder for each of their folders
        subpath = _NUMBA._CacheLocator.get_suitable_cache_subpath(str(source))
        for place in (source.parent / "__pycache__", folder / subpath):
            for index in place.glob(f"{glob.escape(source.stem)}.*.nbi"):
                yield index, _state_of(index, source, processor, changed_s)


def _compiled(index: Path) -> list[Path]:
    """Return the files of compiled code that belong to an index."""
    return list(index.parent.glob(f"{glob.escape(index.stem)}.*.nbc"))


def _state_of(index: Path, source: Path, processor: object, changed_s: float) -> _State:
    """Return whether a kernel from an index is of the sources as they are, and for this processor.

    Parameters
    ----------
    index, source : Path
    processor : object
        As Numba describes it.
    changed_s : float
        When the newest of all sources was changed. A kernel holds the code of those that it calls,
        so that any change may make it older.
    """
    try:
        with index.open("rb") as file:
            # Numba's own checks: of the version, and of the source
            if pickle.load(file) != numba.__version__:
                return "another"
            (stamp, _), kernels = pickle.load(file)  # see `edge_vpr.compiling`
        backed = SimpleNamespace(_py_file=str(source))
        if stamp != _NUMBA._SourceFileBackedLocatorMixin.get_source_stamp(backed):
            return "older"
        if any(file.stat().st_mtime < changed_s for file in _compiled(index)):
            return "older"
        return "kept" if any(key[1] == processor for key in kernels) else "another"
    except Exception:  # an invalid pickle raises anything; Numba then compiles again
        return "another"


def _sources() -> list[Path]:
    """Return the modules whose kernels a live run uses."""
    folders = (Path(str(package.__file__)).parent for package in (edge_vpr, fixedpoint))
    return sorted(source for folder in folders for source in folder.rglob("*.py"))


def _cache_folder() -> Path:
    """Return the folder in which this user's compiled kernels are stored."""

    @njit(cache=True)
    def probe(x: int) -> int:
        return x

    own = Path(str(probe.stats.cache_path))
    package = Path(edge_vpr.__file__).parent
    # beside the sources, or in a folder of Numba's own with a subfolder for each module
    return package if own.is_relative_to(Path(__file__).parent) else own.parent
