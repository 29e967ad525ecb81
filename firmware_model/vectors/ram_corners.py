"""Corner cases of the room of arrays, each up to the next one or to the end of the RAM."""

from __future__ import annotations

from dataclasses import replace

from firmware_model.design import Design
from firmware_model.vectors.case import Case
from firmware_model.vectors.drives import drive


def ram_cases(plain: Design, adaptive: Design) -> list[Case]:
    """Make the cases.

    Parameters
    ----------
    plain, adaptive : Design
        With the place filter; the second with own-mean codes.

    Returns
    -------
    list of Case
    """
    route = [0, 1, 2, 3, 4, 5, 6, 7]
    eight = replace(plain, places=8, exclusion=1, keep_distances=True)
    # a multiple of 16 bytes of means, if there are enough pixels
    full = replace(adaptive, pixels=adaptive.pixels // 4 * 4 or adaptive.pixels, exclusion=1)
    sequences = replace(full, matching="sequence", length=2, trust=0)
    variants = {
        "own_means_fill_the_ram": full,
        "own_means_behind_distances": replace(full, keep_distances=True),
        # sums that fill their room, and one more
        "own_means_behind_four_sums": replace(sequences, exclusion=3),
        "own_means_behind_five_sums": replace(sequences, exclusion=4),
    }
    # no zero, so that a mean that something else is written to is another one
    high = [min(2 * 256 + 128 * (slot % 3), full.entry_max) for slot in range(full.slots)]
    return [
        drive("distances_fill_the_ram", eight, route),
        *(drive(name, variant, route, high) for name, variant in variants.items()),
    ]
