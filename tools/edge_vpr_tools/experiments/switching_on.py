"""How long it takes from switching on in mid-route to the first match that is nearly sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge_vpr.confidence import Confidence
from edge_vpr_tools.experiments.detours import Case

#: windows between two starts in mid-route, and most windows after a start
START_EVERY, GIVEN = 10, 120
#: least number of windows from a start to the end of the drive
_LEFT = 20
HEADER = ("drives", "starts", "p >= 0.95 reached", "median time", "right then",
          "p >= 0.99 reached", "median time", "right then")  # fmt: skip


def first_row(name: str, table: Confidence, switched_on: Sequence[Case]) -> list[str]:
    """Start at many windows, and measure the time to the first match of each probability.

    Parameters
    ----------
    name : str
        Name of the row.
    table : Confidence
    switched_on : sequence of Case
        Drives with the running mean, in which matching starts at several windows.

    Returns
    -------
    list of str
        Row of the table of `HEADER`.
    """
    row = [name]
    waits: dict[float, list[tuple[float, bool]]] = {0.95: [], 0.99: []}
    starts = 0
    for case in switched_on:
        windows, late = len(case.counted), case.reference.settings.late
        for start in range(0, windows - _LEFT, START_EVERY):
            if not case.truth.known[start]:
                continue
            starts += 1
            stop = min(start + GIVEN, windows)
            rest = replace(case, counted=case.counted.take(np.arange(start, stop)))
            matches = rest.match()
            given = table.probability_of(matches.trust)
            for least, found in waits.items():
                sure = np.flatnonzero(given >= least)
                if sure.size:
                    j = int(sure[0])
                    given_at = min(j + late, len(matches) - 1)
                    lasted = rest.counted.end_us[given_at] - rest.counted.start_us[0]
                    right = bool(case.truth.correct[matches.place[j], start + j])
                    found.append((float(lasted) / 1e6, right))
    row.append(str(starts))
    for found in waits.values():
        if not found:
            row += ["0.000", "-", "-"]
            continue
        times, rights = zip(*found, strict=True)
        row += [f"{len(found) / starts:.3f}", f"{np.median(times):.0f} s"]
        row.append(f"{np.mean(rights):.3f}")
    return row
