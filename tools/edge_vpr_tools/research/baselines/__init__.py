"""Systems that the paper compares with, and others, behind one interface."""

from edge_vpr_tools.research.baselines.baseline import (
    Baseline,
    Compared,
    VectorBaseline,
    compare,
    filter_distances,
    match_distances,
)
from edge_vpr_tools.research.baselines.dense import Ensemble, Member
from edge_vpr_tools.research.baselines.registry import GROUP, baseline_names, open_baseline
from edge_vpr_tools.research.baselines.selected_pixels import map_all_pixels

__all__ = [
    "GROUP",
    "Baseline",
    "Compared",
    "Ensemble",
    "Member",
    "VectorBaseline",
    "baseline_names",
    "compare",
    "filter_distances",
    "map_all_pixels",
    "match_distances",
    "open_baseline",
]
