"""Simulation of an event camera that is driven twice through a small deterministic world."""

from edge_vpr.simulation.drive import QUERY, REFERENCE, Drive, Light
from edge_vpr.simulation.pixel_model import PixelArray
from edge_vpr.simulation.recording import SimulatedRecording, simulate_pair
from edge_vpr.simulation.view import CAMERAS, Camera
from edge_vpr.simulation.world import World

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
