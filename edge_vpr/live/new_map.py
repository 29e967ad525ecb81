"""The map that a session makes of its drive, or that learns this drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.descriptors.counting import Removed
from edge_vpr.errors import printable
from edge_vpr.evaluation.tables import save_odometry
from edge_vpr.learning import MapUpdate
from edge_vpr.odometry import Odometry
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


class NewMap(NamedTuple):
    """A map that was written."""

    reference: ReferenceMap
    update: MapUpdate | None  #: What it has learnt, if it was known before.
    removed: Removed  #: Counts of events that were removed as bursts.


def make_map(
    drive: Path,
    target: Path,
    prior: ReferenceMap | None,
    settings: Settings,
    readings: Mapping[int, int],
    say: Callable[..., None],
    *,
    overwrite: bool,
) -> NewMap:
    """Write the map of a recorded drive, and delete the recording; keep it if it makes no map.

    Parameters
    ----------
    drive : Path
        The recording.
    prior : ReferenceMap or None
        Learns the drive, if `settings` has its windows, pixels and codes; else the map is new.
    readings : mapping of int to int
        Of the odometer: millimetres by time in microseconds.
    say : callable
        Takes the kind and the text of a message.
    """
    odometry, removed, update = None, Removed(), None
    learns = prior is not None and (
        settings.at_places_of(prior.settings).of_map == prior.settings.of_map
    )
    if readings:
        odometry = Odometry(
            np.array(list(readings), dtype=np.int64),
            np.array(list(readings.values()), dtype=np.int64),
        )
    try:
        if prior is not None and learns:
            # aligned by whole drives, whatever the settings that it was matched with
            prior = prior.matched_with(settings)
            update = prior.update(drive, odometry=odometry, removed=removed)
            made = update.reference
        else:
            made = ReferenceMap.build(drive, settings, odometry=odometry, removed=removed)
        made.save(target, overwrite=overwrite)
        drive.unlink()
    finally:
        if drive.exists():
            _keep(drive, target, odometry, say, learns=learns)
    return NewMap(made, update, removed)


def _keep(
    drive: Path, target: Path, odometry: Odometry | None, say: Callable[..., None], *, learns: bool
) -> None:
    """Keep a drive that gave no map, or that a map did not learn; say how to continue with it."""
    stems = (target.with_name(f"{target.stem}_drive{n or ''}") for n in count())
    kept = next(stem.with_suffix(".npz") for stem in stems if not stem.with_suffix(".npz").exists())
    drive.replace(kept)
    words = ["edge-vpr", "map", printable(kept), "-o", printable(target)]
    if odometry is not None:
        table = kept.with_suffix(".csv")
        save_odometry(table, odometry)
        words += ["--odometry", printable(table)]
    new = " makes a new map of it, and adds nothing to the old one" * learns
    say("drive", f"the drive is kept: {' '.join(words)}{new}")
