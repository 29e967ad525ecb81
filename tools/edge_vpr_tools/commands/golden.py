"""`edge-vpr golden`: write vectors that a device is held against."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from edge_vpr.descriptors.windows import narrow
from edge_vpr.errors import UsageError
from edge_vpr.pipeline import cleaned
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from edge_vpr.whole_files import check_output, replacing_folder
from edge_vpr_tools.arguments.reading import open_from
from edge_vpr_tools.estimate.of_map import design_of, device_codes
from edge_vpr_tools.output.messages import note, summary
from edge_vpr_tools.output.results import check_parent
from firmware_model import Design, DesignError, Event, Memories, VectorError
from firmware_model.vectors import Case, standard_suites, write_suites
from firmware_model.vectors.suite import files_of
from firmware_model.vectors.verify import load_manifest


@contextmanager
def design_errors() -> Iterator[None]:
    """Let errors of the firmware model be those of the command line."""
    try:
        yield
    except (DesignError, VectorError) as error:
        raise UsageError(str(error)) from error


@design_errors()
def run(args: argparse.Namespace) -> None:
    """Make vectors and write them.

    Raises
    ------
    EdgeVprError
        If an argument is wrong.
    """
    if (args.design is None) == (args.map is None):
        raise UsageError("vectors are made of one of --design and --map: name one")
    if args.recording is not None and args.map is None:
        raise UsageError("--recording needs a map: name it by --map")
    output = Path(args.output)
    inputs = (args.design, args.map, args.recording)
    check_output(output, [given for given in inputs if given is not None])
    _check_folder(output, args.overwrite)
    recorded: list[Case] = []
    if args.map is None:
        design = Design.load(args.design)
    else:
        design, recorded = _from_map(args)
    suites = standard_suites(design, args.seed)
    if recorded:
        suites["recording"] = recorded
    with replacing_folder(output) as folder:
        manifest = write_suites(folder, design, suites, args.seed, rtl=args.rtl)
    for suite in manifest["suites"]:
        missed = [corner for corner, number in suite["coverage"].items() if number == 0]
        if suite["name"] == "corners" and missed:
            note(f"no corner case of this design reaches: {', '.join(missed)}")
    for suite in manifest["suites"]:
        events, windows, matches = (
            sum(case[what] for case in suite["cases"]) for what in ("events", "windows", "matches")
        )
        reached = sum(number > 0 for number in suite["coverage"].values())
        summary(
            f"{args.output}/{suite['name']}: {len(suite['cases'])} cases, {events:,} events, "
            f"{windows} windows, {matches} matches, {reached} of {len(suite['coverage'])} corners"
        )


def _check_folder(path: Path, overwrite: bool) -> None:
    """Refuse a folder that may not be replaced, or that holds other files than vectors."""
    check_parent(path)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    if not overwrite:
        raise UsageError(f"{path} is not an empty folder: name a new one, or add --overwrite")
    ours = {path / name for name in files_of(load_manifest(path))}
    foreign = sorted(set(path.rglob("*")) - ours - {one for file in ours for one in file.parents})
    if foreign:
        raise UsageError(
            f"{path} also holds {foreign[0].relative_to(path)}, which is not of the vectors: move "
            "it away, or name another folder"
        )


def _from_map(args: argparse.Namespace) -> tuple[Design, list[Case]]:
    """Design of a map, and the case of its recording, if one is given."""
    reference = ReferenceMap.load(args.map)
    design = design_of(reference, args.lanes)
    if args.recording is None:
        return design, []
    memories = memories_of_map(reference, design)
    clock = 1 << design.timestamp_bits
    events = [Event(t % clock, x, y, bool(p)) for t, x, y, p in _events(args, reference.settings)]
    return design, [Case("drive", memories, tuple(events))]


def memories_of_map(reference: ReferenceMap, design: Design) -> Memories:
    """Return a device's tables for a map.

    Parameters
    ----------
    reference : ReferenceMap
    design : Design
        Of the map.

    Returns
    -------
    Memories
    """
    codes, places = device_codes(reference), reference.places.counts
    if reference.codes is None:
        places = narrow(codes.encode(places))
    pixels = np.stack([reference.pixel_map.x, reference.pixel_map.y], axis=1).tolist()
    return Memories(design, pixels, places.tolist(), codes.row.tolist())


def _events(args: argparse.Namespace, settings: Settings) -> list[tuple[int, int, int, bool]]:
    """First events of the recording, cleaned as for the pipeline."""
    taken: list[tuple[int, int, int, bool]] = []
    for chunk in cleaned(open_from(args, args.recording), settings):
        taken += chunk[: args.max_events - len(taken)].tolist()
        if len(taken) >= args.max_events:
            break
    return taken
