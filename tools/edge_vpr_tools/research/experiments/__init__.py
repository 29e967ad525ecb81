"""Experiments whose results the README and the documentation show.

Each is a module of this package that declares an `experiment.Experiment` as ``EXPERIMENT``. The
`PROGRAMS` have two functions instead: ``run(data, seeds, on_start, *figures)`` returns their tables
as Markdown, and ``draw`` returns their figure.
"""

#: module of each experiment by its name on the command line
EXPERIMENTS = {
    "simulated": "simulated",
    "speck-walks": "speck_walks",
    "brisbane": "brisbane",
    "codes": "codes_frontier",
    "place-filter": "place_filter",
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

#: experiments that are no declarations
PROGRAMS = ("place-filter", "calibration", "trust")

#: experiments that simulate all of their drives, with those that do the same on recorded drives
STREETS_ONLY = {
    "simulated": "fixed-number, rivals and pixel-number",
    "event-speed": "fixed-number",
    "calibration": "trust",
}

#: folders of recordings, and their sources
SOURCES = {
    "brisbane_sparse49": "event counts at 49 pixels of Brisbane-Event-VPR, sunset 1 and 2 "
    "(https://zenodo.org/records/4302805 has the data set)",
    "brisbane_lens49": "the same drives at 49 other pixels, and weights of LENS trained with them "
    "(A. D. Hines, M. Milford and T. Fischer, 2025)",
    "speck_indoor": "two walks with a Speck, 80 x 80, one frame a second (A. D. Hines, M. Milford "
    "and T. Fischer)",
    "speck_walks": "two walks with a Speck, 128 x 128, in short frames (A. D. Hines, M. Milford "
    "and T. Fischer)",
}
