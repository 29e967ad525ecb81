"""Systems that the paper compares with."""

from edge_vpr.baselines.all_pixels import map_all_pixels

__all__ = ["map_all_pixels"]
