"""The baseline `edge_vpr` of Event-LAB, to be copied into its ``baselines/`` (docs/event_lab.md).

Event-LAB calls the methods of the class in the order in which they stand here.
"""

from __future__ import annotations

import datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from baselines.edge_vpr_matrix import Drive, EdgeVprFailedError, Request, write_distance_matrix
from baselines.EventBaselineLab import EventBaseline

CONFIG = Path(__file__).with_name("edge_vpr.yaml")
MATRIX = "edge_vpr.npy"


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
        """Find the two recordings; nothing is converted.

        Frames (``frame_*.npy``) of both drives are taken if they are there and the configuration
        says ``frames: true``; the HDF5 files of events otherwise.

        Raises
        ------
        EdgeVprFailedError
            If the windows are numbers of events, or the data set states a unit that is not known.
        """
        if config.get("frame_accumulator") == "eventcount":
            raise EdgeVprFailedError(
                f"windows of {timewindow} events are not covered: set frame_accumulator to polarity"
            )
        self.config = config
        about = [drive.get_dataset_info() for drive in (reference, query)]
        names = [info["sequence_name"] for info in about]
        self.ref_query = "_".join(names)
        other = dataset_config.get("other") or {}
        offsets, scale = other.get("offset") or {}, other.get("offset_time_scale", "s")
        folders = [_frames_of(info, timewindow) for info in about]
        by_frames = bool(self.baseline_config.get("frames")) and None not in folders
        drives = [
            Drive(folder)
            if by_frames and folder is not None
            else Drive(Path(info["hdf5_path"]), _seconds(offsets.get(info["sequence_name"]), scale))
            for info, folder in zip(about, folders, strict=True)
        ]
        width, height = dataset_config["dataset"]["resolution"]
        self.request = Request(
            *drives,
            window_ms=float(timewindow),
            resolution=(int(width), int(height)),
            time_unit=self.baseline_config.get("time_unit") or _time_unit(dataset_config),
            settings=self.baseline_config.get("settings") or {},
            program=tuple(self.baseline_config.get("program", ["edge-vpr"])),
        )
        folder = f"{config['frame_generator']}_{timewindow}"
        self.output_dir = self.outdir / about[0]["dataset_name"] / self.ref_query / folder

    def build_execute(
        self, config: dict[str, Any], data_config: dict[str, Any], ground_truth: str
    ) -> None:
        """Do nothing: `format_data` has all that `run` needs."""

    def run(self) -> None:
        """Write the distance matrix, references x queries, into the output folder."""
        write_distance_matrix(self.request, self.output_dir / MATRIX)

    def parse_results(self, GT: str) -> None:  # Event-LAB passes it by this name
        """Evaluate with Event-LAB's metrics."""
        matrix, truth = np.load(self.output_dir / MATRIX), np.load(GT)
        now = datetime.datetime.now(datetime.UTC).replace(tzinfo=None).isoformat()
        rows, curves = self.run_metrics(
            ["edge_vpr"], [matrix], truth, now, self.name, self.ref_query,
            matrix_type=self.matrix_type, outdir=str(self.output_dir),
            tolerance=self.config.get("ground_truth_tolerance", 0.0),
        )  # fmt: skip
        self.save_results(rows, curves, self.name, self.ref_query)

    def cleanup(self) -> None:
        """Do nothing: what `run` needs in between is removed as it ends."""


def _frames_of(info: dict[str, Any], timewindow: float) -> Path | None:
    """Return the folder of frames of this time window, if it is there."""
    for name, path in info.get("file_path", {}).items():
        if name.endswith(f"-{timewindow}") and any(Path(path).glob("frame_*.npy")):
            return Path(path)
    return None


#: names of the units of times in the configuration of a data set, and units in a second
_UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


def _time_unit(dataset_config: dict[str, Any]) -> str:
    """Return the unit of the times in the HDF5 files of a data set."""
    stated = (dataset_config.get("format") or {}).get("data", {}).get("timestamp_val") or "ns"
    return _unit(stated, "timestamp_val")


def _unit(stated: object, name: str) -> str:
    for unit, in_a_second in _UNITS.items():
        if stated in (unit, in_a_second):
            return unit
    raise EdgeVprFailedError(
        f"{name} of the data set is {stated!r}: expected {', '.join(_UNITS)}, or as many in a "
        "second; name the unit of the files as time_unit in edge_vpr.yaml"
    )


def _seconds(offset: object, scale: object) -> str | None:
    """Return an offset on the file's clock in seconds, as text that loses no digit."""
    if offset is None:
        return None
    unit = _unit(scale, "offset_time_scale")
    return str(offset) if unit == "s" else str(Decimal(str(offset)) / _UNITS[unit])
