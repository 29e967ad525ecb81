"""Experiments whose results the README and the documentation show.

Each is a module of this package that declares an `experiment.Experiment` as ``EXPERIMENT``.
"""

from edge_vpr_tools.research.catalogue import STAND_INS, stand_in_text

#: module of each experiment by its name on the command line
EXPERIMENTS = {
    "simulated": "simulated",
    "speck-walks": "speck_walks",
    "codes": "codes_frontier",
    "place-filter": "place_filter",
    "sensitivity": "sensitivity",
    "calibration": "calibration",
    "trust": "trust",
    "mount-shift": "mount_shift",
    "rivals": "rivals",
    "frames": "frames",
    "pixel-number": "pixel_number",
    "agreement": "agreement",
    "event-speed": "event_speed",
    "burst-filters": "burst_filters",
    "window-length": "window_length",
    "fixed-number": "fixed_number",
    "joules": "joules",
    "several-drives": "several_drives",
    "places-per-window": "places_per_window",
}

#: experiments that simulate all of their drives, with those that do the same on recorded drives
STREETS_ONLY = {
    "simulated": "fixed-number, rivals and pixel-number",
    "event-speed": "fixed-number",
    "calibration": "trust",
}

#: folders of recordings, and their sources
SOURCES = {folder: stand_in_text(folder) for folder in STAND_INS}
