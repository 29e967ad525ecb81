"""Systems that the paper compares with, and others, behind one interface."""

from edge_vpr.baselines.all_pixels import map_all_pixels
from edge_vpr.baselines.baseline import GROUP, Baseline, baseline_names, open_baseline
from edge_vpr.baselines.comparing import Compared, compare, match_distances

__all__ = [
    "GROUP",
    "Baseline",
    "Compared",
    "baseline_names",
    "compare",
    "map_all_pixels",
    "match_distances",
    "open_baseline",
]
