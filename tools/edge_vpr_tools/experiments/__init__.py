"""Experiments whose figures the README and the documentation quote."""

#: each is a module of this package with run(data, seeds, on_start) -> Markdown
EXPERIMENTS = {
    "simulated": "simulated",
    "adaptive": "adaptive",
    "speck-walks": "speck_walks",
    "brisbane": "brisbane",
    "codes": "codes_frontier",
    "calibration": "calibration",
    "trust": "trust",
}
