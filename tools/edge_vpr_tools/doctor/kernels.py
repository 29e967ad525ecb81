"""Check where compiled kernels are stored, and compile them before they are needed."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numba
from numba import njit
from numba.core.registry import cpu_target

import edge_vpr
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import map_traverse, match_traverse
from edge_vpr.settings import PRESETS, resolve_settings
from edge_vpr.simulate import simulate_pair
from edge_vpr.stream.live import LiveLocaliser
from edge_vpr.stream.protocols import PROTOCOLS, open_decoder
from edge_vpr_tools.doctor.finding import Finding

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
    files = list(folder.rglob("*.nbi"))
    kept = sum(map(_is_of_this_machine, files))
    text = f"{kept} kept in {folder}"
    if kept:
        yield Finding("compiled kernels", "good", text)
    else:
        if files:
            text = f"{text} for this processor and Numba, {len(files)} for another"
        yield Finding("compiled kernels", "absent", f"{text}: the first run takes longer", _COMPILE)


def compile_kernels(show: Callable[[str], None] = lambda text: None) -> None:
    """Compile all kernels of a live run, with every preset and protocol, into Numba's cache.

    Parameters
    ----------
    show : callable
        Called with a description of each step before it begins.
    """
    first, second = simulate_pair(0, length_m=20.0)
    # sums of few pixels have narrower integers, and therefore kernels of their own
    for preset, pixels in product(PRESETS, (25, None)):
        show(f"mapping and matching with preset {preset}")
        # 20 m have only a few of the default windows
        settings = resolve_settings(preset, flags={"tau_us": 200_000, "pixels": pixels})
        reference = map_traverse(first, settings)
        match_traverse(reference, second)
        live = LiveLocaliser(
            open_decoder("evpr", first.sensor), reference, MatchSchedule(interval_us=50_000)
        )
        live.finish()
    for protocol in PROTOCOLS:
        show(f"decoding protocol {protocol}")
        open_decoder(protocol, first.sensor).warm_up()


def _is_of_this_machine(index: Path) -> bool:
    """Return whether Numba would load a kernel from an index of its cache on this processor."""
    try:
        with index.open("rb") as file:
            # Numba's own check of the version
            if pickle.load(file) != numba.__version__:
                return False
            _, kernels = pickle.load(file)
    except Exception:  # an invalid pickle raises anything; Numba then compiles again
        return False
    processor = cpu_target.target_context.codegen().magic_tuple()
    return any(key[1] == processor for key in kernels)


def _cache_folder() -> Path:
    """Return the folder in which this user's compiled kernels are stored."""

    @njit(cache=True)
    def probe(x: int) -> int:
        return x

    own = Path(str(probe.stats.cache_path))
    package = Path(edge_vpr.__file__).parent
    # beside the sources, or in a folder of Numba's own with a subfolder for each module
    return package if own.is_relative_to(Path(__file__).parent) else own.parent
