"""Visual place recognition from the event counts of a few pixels.

Public names are exported here and loaded when first used, so that `import edge_vpr` loads neither
Numba nor Matplotlib.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from edge_vpr.cleaning import BurstFilter, find_hot_pixels, load_hot_pixels
    from edge_vpr.counters import count_events, count_until
    from edge_vpr.errors import EdgeVprError
    from edge_vpr.evaluation import Evaluation, PrecisionRecall, evaluate, precision_recall
    from edge_vpr.events import EVENT_DTYPE, Sensor, check_events, crop, make_events
    from edge_vpr.ground_truth import (
        GroundTruth,
        Track,
        from_alignment,
        from_matrix,
        from_tracks,
        load_track,
    )
    from edge_vpr.localiser import MATCH_DTYPE, Localiser
    from edge_vpr.matcher import ReferenceIndex, best_match, best_matches, distance_matrix
    from edge_vpr.matches import Matches, match_descriptors
    from edge_vpr.pipeline import describe, map_traverse, match_traverse
    from edge_vpr.pixels import PixelMap, select_pixels
    from edge_vpr.policy import Every
    from edge_vpr.recordings import open_recording, write_recording
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.sequence import sequence_sums
    from edge_vpr.settings import PRESETS, Settings, resolve_settings
    from edge_vpr.sliding_window import SlidingWindow
    from edge_vpr.transforms import CountPixels
    from edge_vpr.windows import Descriptors, DescriptorStream, FixedCount, FixedTime

_HOME = {
    "cleaning": ("BurstFilter", "find_hot_pixels", "load_hot_pixels"),
    "counters": ("count_events", "count_until"),
    "errors": ("EdgeVprError",),
    "evaluation": ("Evaluation", "PrecisionRecall", "evaluate", "precision_recall"),
    "events": ("EVENT_DTYPE", "Sensor", "check_events", "crop", "make_events"),
    "ground_truth": (
        "GroundTruth",
        "Track",
        "from_alignment",
        "from_matrix",
        "from_tracks",
        "load_track",
    ),
    "localiser": ("MATCH_DTYPE", "Localiser"),
    "matcher": ("ReferenceIndex", "best_match", "best_matches", "distance_matrix"),
    "matches": ("Matches", "match_descriptors"),
    "pipeline": ("describe", "map_traverse", "match_traverse"),
    "pixels": ("PixelMap", "select_pixels"),
    "policy": ("Every",),
    "recordings": ("open_recording", "write_recording"),
    "reference_map": ("ReferenceMap",),
    "sequence": ("sequence_sums",),
    "settings": ("PRESETS", "Settings", "resolve_settings"),
    "sliding_window": ("SlidingWindow",),
    "transforms": ("CountPixels",),
    "windows": ("Descriptors", "DescriptorStream", "FixedCount", "FixedTime"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'edge_vpr' has no attribute {name!r}")
    return getattr(import_module(f"edge_vpr.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
