"""Interface of the systems that the method is compared with."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Images = npt.NDArray[np.integer]
Described = npt.NDArray[Any]


class Baseline(Protocol):
    """A system that describes windows and compares descriptions.

    Images are either event counts of windows at all pixels, shape (n, height, width), of 16 bits or
    more, or intensities of 8 bits.
    """

    @property
    def title(self) -> str:
        """Name in tables."""
        ...

    def prepare(self, reference: Images) -> None:
        """Choose or learn parameters from the reference drive; called once, before all others."""
        ...

    def describe(self, images: Images) -> Described:
        """Return one description for each window, shape (n, D)."""
        ...

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the distance of each query to each place, shape (K, Q), 0 or more."""
        ...

    def bits_per_place(self, places: Described) -> int:
        """Return the size of one stored description in bits."""
        ...

    def operations_per_place(self, places: Described) -> int:
        """Return the number of differences, products or words of bits of one comparison."""
        ...


class VectorBaseline:
    """Part of a baseline whose descriptions are vectors of numbers, without learned parameters."""

    def prepare(self, reference: Images) -> None:
        """Do nothing: no parameters are taken from the reference."""

    def bits_per_place(self, places: Described) -> int:
        """Return the size of one description in bits."""
        return 8 * int(places.itemsize) * int(places.shape[1])

    def operations_per_place(self, places: Described) -> int:
        """Return the number of differences or products to add, without those of describing."""
        return int(places.shape[1])
