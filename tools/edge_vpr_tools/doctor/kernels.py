"""Check where compiled kernels are kept, and compile them before they are needed."""

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
    """Look where Numba keeps compiled kernels, and whether they are there."""
    try:
        folder = _cache_folder()
    except RuntimeError:  # Numba's, if it can write nowhere
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
    """Compile what a live run needs, with every preset and protocol, where Numba keeps it.

    Parameters
    ----------
    show : callable
        Is told what comes next.
    """
    first, second = simulate_pair(0, length_m=20.0)
    # sums of few pixels have narrower integers, and so kernels of their own
    for preset, pixels in product(PRESETS, (25, None)):
        show(f"mapping and matching with preset {preset}")
        # 20 m are few of the default windows
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
    """Return whether Numba would load a kernel of an index of its cache, on this processor."""
    try:
        with index.open("rb") as file:
            # as Numba itself does, from where it does
            if pickle.load(file) != numba.__version__:
                return False
            _, kernels = pickle.load(file)
    except Exception:  # a pickle that does not load raises anything, and Numba compiles again
        return False
    processor = cpu_target.target_context.codegen().magic_tuple()
    return any(key[1] == processor for key in kernels)


def _cache_folder() -> Path:
    """Return the folder below which this user's compiled kernels are kept."""

    @njit(cache=True)
    def probe(x: int) -> int:
        return x

    own = Path(str(probe.stats.cache_path))
    package = Path(edge_vpr.__file__).parent
    # beside the sources, or a folder a module within one of Numba's own
    return package if own.is_relative_to(Path(__file__).parent) else own.parent
