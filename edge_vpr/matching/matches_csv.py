"""The table of matches as CSV, for people and spreadsheets."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from edge_vpr.archive import replacing
from edge_vpr.matching.matches import Matches
from edge_vpr.route import Route

COLUMNS = (
    *("query", "time_s", "place", "distance", "second", "second_distance", "ratio", "trust"),
    *("probability", "lost"),
)

#: columns after the coordinates, for a map with positions
ALONG = ("along_m", "along_from_m", "along_to_m")


def write_csv(path: str | Path, matches: Matches, route: Route | None = None) -> None:
    """Write matches as CSV, one line for each, atomically.

    Parameters
    ----------
    path : path
    matches : Matches
        Fields are empty where there is no second, where the probability is not known, and of
        ``lost`` where no precision is wanted.
    route : Route, optional
        Adds the coordinates of the matched place, metres along the route, and the interval of the
        exclusion zone around it; empty where the position is not known.
    """
    located = None
    if route is not None:
        located = route.locate(matches.place, matches.settings.exclusion)
    rejects = matches.settings.precision is not None
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        where = () if route is None else (*route.coordinates, *ALONG)
        table.writerow((*COLUMNS, *where))
        for i in range(len(matches)):
            row = [int(matches.query[i]), f"{matches.time_us[i] / 1e6:.6f}", int(matches.place[i])]
            row.append(f"{matches.distance[i]:.6g}")
            if matches.second[i] >= 0:
                row += [int(matches.second[i]), f"{matches.second_distance[i]:.6g}"]
                row.append(f"{matches.ratio[i]:.6f}")
            else:
                row += ["", "", ""]
            row.append(int(matches.trust[i]))
            known = not np.isnan(matches.probability[i])
            row.append(f"{matches.probability[i]:.4f}" if known else "")
            row.append(int(matches.lost[i]) if rejects else "")
            if located is not None:
                along = (located.along_m[i], located.from_m[i], located.to_m[i])
                row += [_field(value, "{:.7f}") for value in located.position[i]]
                row += [_field(value, "{:.2f}") for value in along]
            table.writerow(row)


def _field(value: float, form: str) -> str:
    return "" if np.isnan(value) else form.format(value)
