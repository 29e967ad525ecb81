"""Experiments whose figures the README and the documentation quote."""

#: each is a module of this package with run(data, seeds, on_start) -> Markdown
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
}
