"""The one oracle: every step of the method in plain Python, short enough to be believed.

Nothing here is fast and nothing is imported from the project. Kernels and streams are held to
these functions to the bit. Events are tuples ``(t, x, y, p)``; a descriptor is a list of counts.
"""

from __future__ import annotations

from collections.abc import Sequence

Event = tuple[int, int, int, bool]
Pixel = tuple[int, int]
Matrix = list[list[int]]


def count(events: Sequence[Event], pixels: Sequence[Pixel], polarity: bool = False) -> list[int]:
    """Events at each selected pixel; with polarity, the OFF counts follow the ON counts."""
    slot_of = {pixel: slot for slot, pixel in enumerate(pixels)}
    counts = [0] * (len(pixels) * (2 if polarity else 1))
    for _, x, y, p in events:
        if (x, y) in slot_of:
            counts[slot_of[x, y] + (len(pixels) if polarity and not p else 0)] += 1
    return counts


def sad(a: Sequence[int], b: Sequence[int]) -> int:
    """Sum of absolute differences of two descriptors (method.md section 4)."""
    return sum(abs(int(i) - int(j)) for i, j in zip(a, b, strict=True))


def distance_matrix(reference: Sequence[Sequence[int]], query: Sequence[Sequence[int]]) -> Matrix:
    """``D[k][j]``: row = reference place, column = query."""
    return [[sad(place, descriptor) for descriptor in query] for place in reference]
