"""Energy of a processor's clock cycle, from the profile of a board with a power sensor."""

from __future__ import annotations

import math
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.plain_values import understood
from edge_vpr_tools.energy.energy_record import Energy
from edge_vpr_tools.energy.profile_record import Profile
from edge_vpr_tools.estimate.targets import Constant, Spread


def calibrated(path: Path) -> Constant:
    """Return the energy of a cycle that a profile measured.

    It is a single point: marginal joules per second of processor time, divided by the clock.

    Parameters
    ----------
    path : path
        Of a ``profile.json``.

    Returns
    -------
    Constant
        In picojoules a cycle.

    Raises
    ------
    UsageError
        If the file is no profile, or its energy was not measured or not resolved.
    """
    profile = Profile.load_file(path)
    energy, clock = profile.energy, profile.conditions.loaded.frequency_hz
    figures = energy.figures if isinstance(energy, Energy) else None
    marginal = None if figures is None else figures.marginal_j_per_match
    if not isinstance(energy, Energy) or figures is None or marginal is None or not clock:
        raise UsageError(
            f"{path}: energy was not measured or not resolved, or the clock is not known: "
            "profile a board with a power sensor, for longer"
        )
    # periods of an external meter have no processor time, which is taken from the throughput
    seconds = energy.cpu_s_per_match or profile.throughput.cpu_s_per_match
    low, high = figures.marginal_j_per_match_interval
    with understood(path, "energy and clock", "profile the board again"):
        picojoules = [1e12 * joules / (seconds * clock) for joules in (low, marginal, high)]
        if not all(map(math.isfinite, picojoules)) or picojoules != sorted(picojoules):
            raise ValueError(f"{picojoules} pJ a cycle are no interval")
        year = int(profile.run.finished_utc[:4])
    return Constant(
        "a cycle of this board",
        "pJ/cycle",
        Spread(*picojoules),
        year,
        profile.run.machine.processor,
        f"calibrated on the profile {path}",
        "interval of the measurement; one point: another load may cost another energy a cycle",
    )
