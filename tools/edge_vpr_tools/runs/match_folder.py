"""The folder of a match, which `edge-vpr evaluate` and `calibrate` read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edge_vpr.archive import read_archive, write_archive
from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.matches_csv import write_csv
from edge_vpr.pipeline import Removed
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.output import results
from edge_vpr_tools.output.cleaning import removed_record
from edge_vpr_tools.output.provenance import run_record, write_json
from edge_vpr_tools.runs.matching import MatchMetrics
from edge_vpr_tools.runs.online import OnlineMetrics


def write_match_folder(
    folder: Path,
    reference: ReferenceMap,
    matches: Matches,
    removed: Removed,
    metrics: MatchMetrics | OnlineMetrics,
    inputs: Sequence[str | Path],
    queries: Descriptors | None = None,
) -> None:
    """Write map, matches, run and metrics.

    Parameters
    ----------
    folder : path
    reference : ReferenceMap
        As saved; the settings of the run are those of `matches`.
    matches : Matches
    removed : Removed
        By cleaning.
    metrics : MatchMetrics or OnlineMetrics
    inputs : sequence of path
        Files that were read.
    queries : Descriptors, optional
        Of the windows; there are none of matches event by event.
    """
    reference.save(folder / results.MAP)
    matches.save(folder / results.MATCHES)
    write_csv(folder / results.MATCHES_CSV, matches, reference.route)
    if queries is not None:
        write_archive(folder / results.QUERIES, results.QUERIES_KIND, queries.to_arrays(), {})
    left_out = removed_record(removed, int(reference.hot.sum()))
    write_json(folder / results.RUN, run_record(matches.settings.to_dict(), inputs, left_out))
    write_json(folder / results.METRICS, metrics)


def read_queries(folder: Path) -> Descriptors | None:
    """Read the windows of a match; None of a match event by event."""
    if not (folder / results.QUERIES).is_file():
        return None
    arrays, _ = read_archive(folder / results.QUERIES, results.QUERIES_KIND)
    return Descriptors.from_arrays(arrays)
