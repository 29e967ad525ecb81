"""Golden vectors of a map and a drive, and the folder to which they are written."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counting import check_sensor, cleaned
from edge_vpr.descriptors.windows import window_of
from edge_vpr.errors import UsageError
from edge_vpr.events import Events, join_events
from edge_vpr.files import check_parent
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.estimate.fitting import Budget
from edge_vpr_tools.estimate.of_map import memories_of
from firmware_model import Design, Event
from firmware_model.vectors import AIMED, Case, load_manifest
from firmware_model.vectors.facts import facts_for, own_facts
from firmware_model.vectors.manifest import SuiteEntry


def vectors_size(text: str) -> float:
    """Read the size of a folder of vectors: `all`, 0, or bytes such as 20MB."""
    if text == "all":
        return math.inf
    if text == "0":
        return 0.0
    return Budget.parse(text).limit


def recorded_case(
    reference: ReferenceMap, design: Design, recording: EventSource, most_windows: int
) -> Case:
    """Make a case of the first windows of a drive, cleaned as in the pipeline.

    All events at selected pixels are in it. Of the others, which change no result, there are at
    most as many, evenly spread.

    Raises
    ------
    UsageError
        If the recording has too few windows for a match.
    """
    check_sensor(recording.sensor, reference.pixel_map.sensor)
    if most_windows < design.length:
        raise UsageError(
            f"--max-windows {most_windows}: a match takes {design.length} windows: give as many"
        )
    memories = memories_of(reference, design)
    events, selected = _first_windows(reference, design, recording, most_windows)
    end = _end_of(most_windows, design, events, selected)
    chosen = selected[:end].copy()
    # the last event may be what ends the last window
    chosen[-1:] = True
    others = np.flatnonzero(~chosen)
    taken = min(others.size, int(chosen.sum()))
    chosen[others[np.linspace(0, others.size - 1, taken).astype(np.int64)]] = True
    clock = 1 << design.timestamp_bits
    of_case = tuple(Event(t % clock, x, y, bool(p)) for t, x, y, p in events[:end][chosen].tolist())
    case = Case("drive", memories, of_case)
    matches = len(case.trace().matches)
    if not matches:
        raise UsageError(
            f"the recording has no match in its first {most_windows} windows, of "
            f"{window_of(reference.settings)}: a match takes {design.length} whole "
            f"window{'s' * (design.length > 1)}; take a longer part of the drive"
        )
    return case


def _first_windows(
    reference: ReferenceMap, design: Design, recording: EventSource, most_windows: int
) -> tuple[Events, npt.NDArray[np.bool_]]:
    """Return the events of the first windows, and which are at selected pixels.

    Of the other events, each part of the recording keeps at most as many.
    """
    at_selected = np.zeros((design.height, design.width), dtype=np.bool_)
    at_selected[reference.pixel_map.y, reference.pixel_map.x] = True
    parts: list[Events] = []
    masks: list[npt.NDArray[np.bool_]] = []
    counted = 0
    for chunk in cleaned(recording, reference.settings):
        if not chunk.size:
            continue
        selected = at_selected[chunk.y, chunk.x]
        keep = selected.copy()
        keep[[0, -1]] = True
        others = np.flatnonzero(~selected)
        several = np.linspace(0, others.size - 1, min(others.size, int(selected.sum()))).astype(int)
        keep[others[several]] = True
        parts.append(chunk[keep])
        masks.append(selected[keep])
        counted += int(selected.sum())
        if design.window == "count":
            enough = counted >= most_windows * design.window_events
        else:
            enough = int(chunk.t[-1]) >= most_windows * design.tau_us
        if enough:
            break
    if not parts:
        raise UsageError("the recording holds no events: name another one")
    return join_events(parts), np.concatenate(masks)


def _end_of(windows: int, design: Design, events: Events, selected: npt.NDArray[np.bool_]) -> int:
    """Return the number of events up to the one that ends the last of so many windows."""
    if design.window == "count":
        last = np.searchsorted(np.cumsum(selected), windows * design.window_events)
    else:
        last = np.searchsorted(events.t, windows * design.tau_us)
    return min(int(last) + 1, len(events))


def check_vectors_folder(path: Path, overwrite: bool) -> None:
    """Refuse a folder that must not be replaced, or that holds files other than vectors."""
    check_parent(path)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    if not overwrite:
        raise UsageError(f"{path} is not an empty folder: name a new one, or add --overwrite")
    ours = {path / name for name in load_manifest(path).files()}
    foreign = sorted(set(path.rglob("*")) - ours - {one for file in ours for one in file.parents})
    if foreign:
        raise UsageError(
            f"{path} also holds {foreign[0].relative_to(path)}, which is not of the vectors: move "
            "it away, or name another folder"
        )


def aimed_facts(suite: SuiteEntry, design: Design) -> dict[str, int]:
    """Return how often a suite shows each fact that it is made for and its design can have."""
    of_design = {"filter": facts_for, "own": own_facts}.get(suite.name)
    aimed = AIMED.get(suite.name, ()) if of_design is None else of_design(design)
    return {fact: suite.coverage[fact] for fact in suite.coverage if fact in aimed}
