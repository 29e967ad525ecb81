"""Event recordings of many formats behind one function.

>>> from edge_vpr.recordings import open_recording
>>> for events in open_recording("drive.raw"):  # doctest: +SKIP
...     ...
"""

from edge_vpr.recordings.frames import CountFrames, parse_period, read_count_frames
from edge_vpr.recordings.recording import Faults, Recording
from edge_vpr.recordings.registry import FORMATS, Format, open_recording, write_recording

__all__ = [
    "FORMATS",
    "CountFrames",
    "Faults",
    "Format",
    "Recording",
    "open_recording",
    "parse_period",
    "read_count_frames",
    "write_recording",
]
