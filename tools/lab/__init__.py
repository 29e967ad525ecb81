"""Experiments on several methods and data sets: of a clone, and not installed with edge-vpr."""
