"""Visual place recognition from the event counts of a few pixels.

Public names are exported here and loaded when first used, so that `import edge_vpr` loads neither
Numba nor Matplotlib.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from edge_vpr.descriptors.cleaning import BurstFilter, find_hot_pixels, load_hot_pixels
    from edge_vpr.descriptors.counting import (
        CountPixels,
        DescriptorStream,
        count_events,
        count_until,
    )
    from edge_vpr.descriptors.pixels import PixelMap, select_pixels
    from edge_vpr.descriptors.windows import Descriptors, FixedCount, FixedTime
    from edge_vpr.errors import EdgeVprError
    from edge_vpr.evaluation.ground_truth import (
        GroundTruth,
        from_alignment,
        from_matrix,
        from_tracks,
    )
    from edge_vpr.evaluation.metrics import Evaluation, PrecisionRecall, evaluate, precision_recall
    from edge_vpr.evaluation.tracks import Track, load_track
    from edge_vpr.events import EVENT_DTYPE, Sensor, check_events, crop, make_events
    from edge_vpr.matching.distances import (
        ReferenceIndex,
        best_match,
        best_matches,
        distance_matrix,
    )
    from edge_vpr.matching.drive import match_descriptors
    from edge_vpr.matching.matches import Matches
    from edge_vpr.matching.sequences import sequence_sums
    from edge_vpr.online.localiser import Localiser
    from edge_vpr.online.state import MATCH_DTYPE, MatchSchedule
    from edge_vpr.pipeline import describe, map_traverse, match_traverse
    from edge_vpr.recordings import open_recording, write_recording
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.settings import PRESETS, Settings, resolve_settings

_HOME = {
    "descriptors.cleaning": (
        "BurstFilter",
        "find_hot_pixels",
        "load_hot_pixels",
    ),
    "descriptors.counting": (
        "CountPixels",
        "DescriptorStream",
        "count_events",
        "count_until",
    ),
    "descriptors.pixels": (
        "PixelMap",
        "select_pixels",
    ),
    "descriptors.windows": (
        "Descriptors",
        "FixedCount",
        "FixedTime",
    ),
    "errors": ("EdgeVprError",),
    "evaluation.ground_truth": (
        "GroundTruth",
        "from_alignment",
        "from_matrix",
        "from_tracks",
    ),
    "evaluation.metrics": (
        "Evaluation",
        "PrecisionRecall",
        "evaluate",
        "precision_recall",
    ),
    "evaluation.tracks": (
        "Track",
        "load_track",
    ),
    "events": (
        "EVENT_DTYPE",
        "Sensor",
        "check_events",
        "crop",
        "make_events",
    ),
    "matching.distances": (
        "ReferenceIndex",
        "best_match",
        "best_matches",
        "distance_matrix",
    ),
    "matching.drive": ("match_descriptors",),
    "matching.matches": ("Matches",),
    "matching.sequences": ("sequence_sums",),
    "online.localiser": ("Localiser",),
    "online.state": (
        "MATCH_DTYPE",
        "MatchSchedule",
    ),
    "pipeline": (
        "describe",
        "map_traverse",
        "match_traverse",
    ),
    "recordings.registry": (
        "open_recording",
        "write_recording",
    ),
    "reference_map": ("ReferenceMap",),
    "settings": (
        "PRESETS",
        "Settings",
        "resolve_settings",
    ),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'edge_vpr' has no attribute {name!r}")
    return getattr(import_module(f"edge_vpr.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
