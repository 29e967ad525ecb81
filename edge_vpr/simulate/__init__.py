"""Simulation of an event camera that is driven twice through a small deterministic world."""

from edge_vpr.simulate.camera import CAMERAS, Camera
from edge_vpr.simulate.drive import QUERY, REFERENCE, Drive, Light
from edge_vpr.simulate.pixel_model import PixelArray
from edge_vpr.simulate.recording import SimulatedRecording, simulate_pair
from edge_vpr.simulate.world import World

__all__ = [
    "CAMERAS",
    "QUERY",
    "REFERENCE",
    "Camera",
    "Drive",
    "Light",
    "PixelArray",
    "SimulatedRecording",
    "World",
    "simulate_pair",
]
