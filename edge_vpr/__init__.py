"""Visual place recognition from the event counts of a few pixels.

Public names are exported here and loaded when first used, so that `import edge_vpr` loads neither
Numba nor Matplotlib.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from edge_vpr.datasets.count_pixels import CountPixels
    from edge_vpr.descriptors.bursts import BurstFilter
    from edge_vpr.descriptors.counters import count_events, count_until
    from edge_vpr.descriptors.descriptor_stream import DescriptorStream
    from edge_vpr.descriptors.descriptors import Descriptors
    from edge_vpr.descriptors.hot_pixels import find_hot_pixels, load_hot_pixels
    from edge_vpr.descriptors.pixels import PixelMap, select_pixels
    from edge_vpr.descriptors.windows import FixedCount, FixedTime
    from edge_vpr.errors import EdgeVprError
    from edge_vpr.evaluation.ground_truth import GroundTruth
    from edge_vpr.evaluation.metrics import Evaluation, PrecisionRecall, evaluate, precision_recall
    from edge_vpr.evaluation.track_files import load_track
    from edge_vpr.evaluation.tracks import Track
    from edge_vpr.evaluation.truth_from_alignment import from_alignment
    from edge_vpr.evaluation.truth_from_matrix import from_matrix
    from edge_vpr.evaluation.truth_from_tracks import from_tracks
    from edge_vpr.events import EVENT_DTYPE, Sensor, check_events, crop, make_events
    from edge_vpr.matching.distances import ReferenceIndex, distance_matrix
    from edge_vpr.matching.drive_matching import match_descriptors
    from edge_vpr.matching.matches import Matches
    from edge_vpr.matching.nearest import best_match, best_matches
    from edge_vpr.matching.sequence import sequence_sums
    from edge_vpr.online.localiser import Localiser
    from edge_vpr.online.match_records import MATCH_DTYPE
    from edge_vpr.online.schedule import MatchSchedule
    from edge_vpr.pipeline import describe, map_traverse, match_traverse
    from edge_vpr.recordings import open_recording, write_recording
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.settings import PRESETS, Settings, resolve_settings

_HOME = {
    "descriptors.bursts": ("BurstFilter",),
    "descriptors.hot_pixels": ("find_hot_pixels", "load_hot_pixels"),
    "descriptors.counters": ("count_events", "count_until"),
    "errors": ("EdgeVprError",),
    "evaluation.metrics": ("Evaluation", "PrecisionRecall", "evaluate", "precision_recall"),
    "events": ("EVENT_DTYPE", "Sensor", "check_events", "crop", "make_events"),
    "evaluation.ground_truth": ("GroundTruth",),
    "evaluation.tracks": ("Track",),
    "evaluation.track_files": ("load_track",),
    "evaluation.truth_from_alignment": ("from_alignment",),
    "evaluation.truth_from_matrix": ("from_matrix",),
    "evaluation.truth_from_tracks": ("from_tracks",),
    "online.localiser": ("Localiser",),
    "online.match_records": ("MATCH_DTYPE",),
    "matching.distances": ("ReferenceIndex", "distance_matrix"),
    "matching.nearest": ("best_match", "best_matches"),
    "matching.drive_matching": ("match_descriptors",),
    "matching.matches": ("Matches",),
    "pipeline": ("describe", "map_traverse", "match_traverse"),
    "descriptors.pixels": ("PixelMap", "select_pixels"),
    "online.schedule": ("MatchSchedule",),
    "recordings": ("open_recording", "write_recording"),
    "reference_map": ("ReferenceMap",),
    "matching.sequence": ("sequence_sums",),
    "settings": ("PRESETS", "Settings", "resolve_settings"),
    "datasets.count_pixels": ("CountPixels",),
    "descriptors.descriptor_stream": ("DescriptorStream",),
    "descriptors.descriptors": ("Descriptors",),
    "descriptors.windows": ("FixedCount", "FixedTime"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'edge_vpr' has no attribute {name!r}")
    return getattr(import_module(f"edge_vpr.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
