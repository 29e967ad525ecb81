"""Second axes of figures: seconds or metres beside the numbers of windows and places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route

_TICKS = 7


@dataclass(frozen=True, eq=False)
class Scale:
    """A quantity that grows from window to window of a drive.

    Attributes
    ----------
    values : ndarray of float64, shape (n,)
        Of each window, not falling; NaN where it is not known.
    label : str
        With the unit.
    """

    values: npt.NDArray[np.float64]
    label: str

    def ticks(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return round values, and between which windows each of them was reached.

        Returns
        -------
        positions, values : ndarray of float64, shape (m,)
            m is 0 where fewer than two different values are known.
        """
        known = np.flatnonzero(np.isfinite(self.values))
        values = self.values[known]
        if known.size < 2 or values[0] == values[-1]:
            return np.empty(0), np.empty(0)
        round_values = MaxNLocator(_TICKS, steps=[1, 2, 5, 10]).tick_values(values[0], values[-1])
        inside = round_values[(round_values >= values[0]) & (round_values <= values[-1])]
        return np.interp(inside, values, known), inside


def seconds(centre_us: npt.NDArray[np.int64], drive: str) -> Scale:
    """Return the time of each window.

    Parameters
    ----------
    centre_us : ndarray of int64, shape (n,)
        Centres of the windows, in microseconds.
    drive : str
        Name for the label.
    """
    return Scale(centre_us / 1e6, f"time of the {drive} drive (s)")


def along_route(reference: ReferenceMap, route: Route | None) -> Scale:
    """Return the metres to each place where a track says them, and else the seconds.

    Parameters
    ----------
    reference : ReferenceMap
    route : Route or None
        Positions of its places.
    """
    if route is None:
        return seconds(reference.places.centre_us, "reference")
    return Scale(route.along_m, "way along the route (m)")


def add_scale(axes: Axes, side: str, scale: Scale) -> None:
    """Draw a second axis; nothing is drawn where the quantity is not known.

    Parameters
    ----------
    axes : Axes
        With windows or places, from 0, on the opposite axis.
    side : {"top", "right"}
    scale : Scale
    """
    positions, values = scale.ticks()
    if not positions.size:
        return
    texts = [f"{value:g}" for value in values]
    if side == "top":
        second = axes.secondary_xaxis("top")
        second.set_xticks(positions, texts)
        second.set_xlabel(scale.label)
    else:
        second = axes.secondary_yaxis("right")
        second.set_yticks(positions, texts)
        second.set_ylabel(scale.label)
