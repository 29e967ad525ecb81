"""Golden vectors of a map and a drive, the folder to which they are written, and blank tables."""

from __future__ import annotations

from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.pipeline import EventSource, cleaned
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import check_parent
from edge_vpr_tools.estimate.of_map import memories_of
from firmware_model import Design, Event, Memories
from firmware_model.vectors import FILTER_CORNERS, Case, load_manifest
from firmware_model.vectors.case import choose_pixels
from firmware_model.vectors.manifest import SuiteEntry

# Golden vectors of a map and a drive, and the folder to which they are written.


def recorded_case(
    reference: ReferenceMap, design: Design, recording: EventSource, most_events: int
) -> Case:
    """Make a case of the first events of a drive, cleaned as in the pipeline.

    Parameters
    ----------
    reference : ReferenceMap
    design : Design
        Design of this map.
    recording : EventSource
    most_events : int
        Largest number of events of the case.
    """
    taken: list[tuple[int, int, int, bool]] = []
    for chunk in cleaned(recording, reference.settings):
        taken += chunk[: most_events - len(taken)].tolist()
        if len(taken) >= most_events:
            break
    clock = 1 << design.timestamp_bits
    events = tuple(Event(t % clock, x, y, bool(p)) for t, x, y, p in taken)
    return Case("drive", memories_of(reference, design), events)


def check_vectors_folder(path: Path, overwrite: bool) -> None:
    """Refuse a folder that must not be replaced, or that holds files other than vectors.

    Raises
    ------
    UsageError
        If it is such a folder.
    VectorError
        If it holds no manifest.
    """
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


def missed_corners(suite: SuiteEntry) -> list[str]:
    """Return the corners that a suite made for corners does not reach with this design."""
    if suite.name not in ("corners", "filter"):
        return []
    missed = [corner for corner, number in suite.coverage.items() if number == 0]
    if suite.name == "filter":
        missed = [corner for corner in missed if corner in FILTER_CORNERS]
    return missed


# Tables of a device with a design but without a map.


def blank_memories(design: Design) -> Memories:
    """Return tables with pixels for tests, and places without events."""
    places = [[0] * design.slots] * design.places
    tables = [slot % len(design.full_scales) for slot in range(design.slots)]
    return Memories(design, choose_pixels(design), places, tables)
