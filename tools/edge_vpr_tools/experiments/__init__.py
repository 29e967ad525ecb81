"""Experiments whose figures the README and the documentation quote."""

#: each is a module of this package with a function run(data, seeds, on_start, *figures), which
#: returns Markdown, and a function draw, which returns its figure
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
