"""The baseline `edge_vpr` of Event-LAB.

1. Install edge-vpr with the extra ``hdf5`` in an environment of its own.
2. Copy this file and ``edge_vpr.yaml`` into Event-LAB's ``baselines/``, and name the program in the
   latter (``program: [/path/of/that/environment/bin/edge-vpr]``).
3. Register it in ``baselines/get_baseline.py`` (``"edge_vpr": lambda: EdgeVprBaseline()``) and in
   ``config.yaml`` under ``VPR-Baselines``. There, set ``stream: true``: the runner of 25d5425
   prepares a baseline only then.

Event-LAB calls `format_data`, `build_execute`, `run`, `parse_results` and `cleanup` in this order.
It pins NumPy 1, and edge-vpr needs NumPy 2: edge-vpr runs in a process of its own environment.
"""

from __future__ import annotations

import datetime
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from baselines.EventBaselineLab import EventBaseline

CONFIG = Path(__file__).with_name("edge_vpr.yaml")
MATRIX = "edge_vpr.npy"
#: units of times in the configuration of a data set, which also states them in ticks a second
UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


class EdgeVprFailedError(RuntimeError):
    """edge-vpr, or what Event-LAB asks of it, fails; the text is one line."""


class EdgeVprBaseline(EventBaseline):  # type: ignore[misc]
    """Distances of places from the event counts of a few pixels."""

    def __init__(self) -> None:
        super().__init__()
        self.name = "edge_vpr"
        self.matrix_type = "distance"
        self.outdir = Path("output/edge_vpr")
        with CONFIG.open(encoding="utf-8") as file:
            self.baseline_config = yaml.safe_load(file)

    def format_data(
        self, config: dict[str, Any], dataset_config: dict[str, Any], reference: Any, query: Any,
        timewindow: float,
    ) -> None:  # fmt: skip
        """Prepare to map one recording and to match the other; nothing is converted.

        Raises
        ------
        EdgeVprFailedError
            If the windows are numbers of events, or a unit of times is not known.
        """
        if config.get("frame_accumulator") == "eventcount":
            raise EdgeVprFailedError(
                f"windows of {timewindow} events are not covered: set frame_accumulator to polarity"
            )
        drives = [drive.get_dataset_info() for drive in (reference, query)]
        self.config = config
        self.ref_query = "_".join(drive["sequence_name"] for drive in drives)
        self.output_dir = (
            self.outdir / drives[0]["dataset_name"] / self.ref_query
            / f"{config['frame_generator']}_{timewindow}"
        )  # fmt: skip
        self.reference, self.query = (_recording(drive, dataset_config) for drive in drives)
        # Event-LAB's truth has a row for each window
        self.mapping = ["--tau", f"{float(timewindow):g}ms", "--places-per-window", "1"]

    def build_execute(
        self, config: dict[str, Any], data_config: dict[str, Any], ground_truth: str
    ) -> None:
        """Check that `format_data` was called.

        Raises
        ------
        EdgeVprFailedError
            If it was not: some versions of Event-LAB call it only with ``stream: true``.
        """
        if not hasattr(self, "reference"):
            raise EdgeVprFailedError(
                "format_data was not called: set stream to true in Event-LAB's config.yaml"
            )

    def run(self) -> None:
        """Write the distance matrix, references x queries, into the output folder.

        Raises
        ------
        EdgeVprFailedError
            If edge-vpr is not there or ends with an error.
        """
        self.output_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="edge_vpr_") as folder:
            map_file, matches = f"{folder}/map.npz", f"{folder}/matches"
            settings = _flags(self.baseline_config.get("settings") or {})
            self._call("map", *self.reference, "-o", map_file, *self.mapping, *settings)
            self._call("match", map_file, *self.query, "-o", matches, "--no-figures",
                       "--overwrite", "--matrix", str(self.output_dir / MATRIX))  # fmt: skip

    def parse_results(self, GT: str) -> None:  # Event-LAB passes it by this name
        """Evaluate with Event-LAB's metrics."""
        matrix, truth = np.load(self.output_dir / MATRIX), np.load(GT)
        now = datetime.datetime.now(datetime.UTC).replace(tzinfo=None).isoformat()
        rows, curves = self.run_metrics(
            [self.name], [matrix], truth, now, self.name, self.ref_query,
            matrix_type=self.matrix_type, outdir=str(self.output_dir),
            tolerance=self.config.get("ground_truth_tolerance", 0.0),
        )  # fmt: skip
        self.save_results(rows, curves, self.name, self.ref_query)

    def cleanup(self) -> None:
        """Do nothing: what `run` needs in between is removed as it ends."""

    def _call(self, *words: str) -> None:
        program = self.baseline_config.get("program") or ["edge-vpr"]
        try:
            run = subprocess.run(
                [*program, *words, "--quiet"], capture_output=True, text=True, check=False
            )
        except OSError as error:
            raise EdgeVprFailedError(
                f"{program[0]} cannot be started ({error.strerror}): install edge-vpr in an "
                "environment of its own, and name its program in edge_vpr.yaml"
            ) from error
        if run.returncode:
            lines = run.stderr.strip().splitlines()
            raise EdgeVprFailedError(
                lines[-1] if lines else f"{program[0]} ended with {run.returncode}"
            )


def _recording(drive: dict[str, Any], dataset_config: dict[str, Any]) -> list[str]:
    """Return the words that name a recording and say how it is read."""
    width, height = dataset_config["dataset"]["resolution"]
    stated = (dataset_config.get("format") or {}).get("data", {}).get("timestamp_val") or "ns"
    unit = next((unit for unit, ticks in UNITS.items() if stated in (unit, ticks)), None)
    if unit is None:
        raise EdgeVprFailedError(
            f"timestamp_val of the data set is {stated!r}: expected {', '.join(UNITS)}, or the "
            "ticks in a second of one of them"
        )
    words = [str(drive["hdf5_path"]), "--sensor", f"{width}x{height}", "--time-unit", unit]
    other = dataset_config.get("other") or {}
    offset = (other.get("offset") or {}).get(drive["sequence_name"])
    if offset is not None:
        scale = other.get("offset_time_scale", "s")
        if scale != "s":
            raise EdgeVprFailedError(
                f"offset_time_scale of the data set is {scale!r}: state other.offset in seconds "
                "and offset_time_scale as s"
            )
        words += ["--start-offset", str(offset)]
    return words


def _flags(settings: dict[str, object]) -> list[str]:
    """Return settings as flags of the same names."""
    words = []
    for name, value in settings.items():
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", str(value)]
    return words
