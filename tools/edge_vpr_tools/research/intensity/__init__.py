"""Intensity images of a conventional camera, and the choice of images at given times."""

from edge_vpr_tools.research.intensity.frames import IntensityFrames, frames_at
from edge_vpr_tools.research.intensity.registry import open_intensity

__all__ = ["IntensityFrames", "frames_at", "open_intensity"]
