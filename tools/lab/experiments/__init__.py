"""Experiments whose results the README and the documentation show.

Each is a module of this package that declares an `lab.loop.Experiment` as ``EXPERIMENT``.
"""

#: names on the command line; the module of each has underscores in place of hyphens
EXPERIMENTS = (
    "simulated", "speck-walks", "codes", "place-filter", "sensitivity", "calibration", "trust",
    "mount-shift", "rivals", "frames", "pixel-number", "fixed-number", "joules", "several-drives",
    "places-per-window", "designs", "position", "robustness",
)  # fmt: skip
