"""Systems that the paper compares with, and others, behind one interface."""

from edge_vpr.baselines.all_pixels import map_all_pixels
from edge_vpr.baselines.baseline import Baseline
from edge_vpr.baselines.comparing import Compared, compare, match_distances
from edge_vpr.baselines.ensemble import Ensemble, Member
from edge_vpr.baselines.registry import GROUP, baseline_names, open_baseline

__all__ = [
    "GROUP",
    "Baseline",
    "Compared",
    "Ensemble",
    "Member",
    "baseline_names",
    "compare",
    "map_all_pixels",
    "match_distances",
    "open_baseline",
]
