"""Corner cases of the RAM: arrays that reach up to the next one or to the end of the RAM."""

from __future__ import annotations

from dataclasses import replace

from firmware_model.design import Design
from firmware_model.vectors.case import Case
from firmware_model.vectors.drives import drive


def ram_cases(plain: Design, adaptive: Design) -> list[Case]:
    """Make the corner cases of the RAM.

    Parameters
    ----------
    plain, adaptive : Design
        Both have the place filter, and the second has own-mean codes.
    """
    route = [0, 1, 2, 3, 4, 5, 6, 7]
    eight = replace(plain, places=8, exclusion=1, keep_distances=True)
    # the means take a multiple of 16 bytes, if there are enough pixels
    full = replace(adaptive, pixels=adaptive.pixels // 4 * 4 or adaptive.pixels, exclusion=1)
    sequences = replace(full, matching="sequence", length=2, trust=0)
    variants = {
        "own_means_fill_the_ram": full,
        "own_means_behind_distances": replace(full, keep_distances=True),
        # four sums fill their room, five need more
        "own_means_behind_four_sums": replace(sequences, exclusion=3),
        "own_means_behind_five_sums": replace(sequences, exclusion=4),
    }
    # no mean is zero, so that a mean that another array overwrites is noticed
    high = [min(2 * 256 + 128 * (slot % 3), full.entry_max) for slot in range(full.slots)]
    return [
        drive("distances_fill_the_ram", eight, route),
        *(drive(name, variant, route, high) for name, variant in variants.items()),
    ]
