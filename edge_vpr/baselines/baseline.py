"""What a system to compare with has to give, and where such systems are found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError

#: entry points of this group name a callable that takes a seed and returns a `Baseline`
GROUP = "edge_vpr.baselines"

Images = npt.NDArray[np.integer]
Described = npt.NDArray[Any]


class Baseline(Protocol):
    """A system that describes windows and compares descriptions.

    Images are event counts of windows at all pixels, shape (n, height, width).
    """

    @property
    def title(self) -> str:
        """What a table calls it."""
        ...

    def prepare(self, reference: Images) -> None:
        """Choose or learn what the system takes from the reference drive; called once, first."""
        ...

    def describe(self, images: Images) -> Described:
        """Return one description a window, shape (n, D)."""
        ...

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the distance of each query to each place, shape (K, Q), 0 or more."""
        ...

    def bits_per_place(self, places: Described) -> int:
        """Return the size of one stored description in bits."""
        ...

    def operations_per_place(self, places: Described) -> int:
        """Return how many differences, products or words of bits one comparison takes."""
        ...


@dataclass(frozen=True)
class Entry:
    """A baseline of our own, imported when it is first used."""

    name: str
    module: str
    factory: str


BASELINES: dict[str, Entry] = {
    entry.name: entry
    for entry in (
        Entry("paper", "selected_pixels", "paper"),
        Entry("seed-code", "selected_pixels", "released_code"),
        Entry("all-pixels", "dense", "all_pixels"),
        Entry("patch-normalised", "dense", "patch_normalised"),
        Entry("active-pixels", "active_pixels", "active_pixels"),
        Entry("hog", "hog", "hog"),
    )
}


def baseline_names() -> list[str]:
    """Names of all baselines, those of other packages last."""
    others = {point.name for point in entry_points(group=GROUP)} - set(BASELINES)
    return [*BASELINES, *sorted(others)]


def open_baseline(name: str, seed: int = 0) -> Baseline:
    """Make a baseline.

    Parameters
    ----------
    name : str
        See `baseline_names`.
    seed : int
        Of whatever it draws.

    Raises
    ------
    UsageError
        If there is none of this name.
    MissingLibraryError
        If a library that it needs is not installed.
    """
    factory: Callable[[int], Baseline] | None = None
    if name in BASELINES:
        entry = BASELINES[name]
        module = import_module(f"edge_vpr.baselines.{entry.module}")
        factory = getattr(module, entry.factory)
    for point in entry_points(group=GROUP):
        if factory is None and point.name == name:
            factory = point.load()
    if factory is None:
        raise UsageError(
            f"baseline {name!r} is unknown: choose one of {', '.join(baseline_names())}"
        )
    return factory(seed)
