"""Experiments whose figures the README and the documentation quote.

Each is a module of this package with two functions. ``run(data, seeds, on_start, *figures)``
returns its tables as Markdown; ``draw`` returns its figure.

data : path, optional
    Folder of the recorded drives (see `drive_pairs.pairs`) or of the one that the module names as
    ``FOLDER``; not used by an experiment of `STREETS_ONLY`.
seeds : int
    Number of trials: simulated streets, and draws of pixels.
on_start : callable
    Called with a description before each part begins.
*figures : path
    Files to which the figure is written.
baselines : sequence of str
    In `rivals` and `frames`, systems in addition to those that are always compared; see
    `edge_vpr_tools.research.baselines.open_baseline`.
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
}

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
    "speck_indoor": "two walks with a Speck, 80 x 80, one frame a second (A. D. Hines, M. Milford "
    "and T. Fischer)",
    "speck_walks": "two walks with a Speck, 128 x 128, in short frames (A. D. Hines, M. Milford "
    "and T. Fischer)",
}
