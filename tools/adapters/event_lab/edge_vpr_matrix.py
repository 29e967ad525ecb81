"""Distances of two drives by `edge-vpr` in a process of its own.

Event-LAB pins a NumPy that edge-vpr does not run with. edge-vpr is therefore not imported here, and
this module needs Python's standard library alone.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path


class EdgeVprFailedError(RuntimeError):
    """`edge-vpr` ended with an error; the text is its own line."""


@dataclass(frozen=True)
class Drive:
    """One recording in Event-LAB's form.

    Attributes
    ----------
    path : Path
        HDF5 with ``events/{x,y,t,p}``, or a folder of ``frame_*.npy`` with ``metadata.json``.
    offset_s : str or None
        Second on the file's clock to begin at, as text, so that no digit is lost.
    """

    path: Path
    offset_s: str | None = None

    @property
    def is_frames(self) -> bool:
        """Whether it is a folder of count frames."""
        return self.path.is_dir()


@dataclass(frozen=True)
class Request:
    """What is to be matched, and how.

    Attributes
    ----------
    reference, query : Drive
    window_ms : float
        Length of a window.
    resolution : (int, int)
        Width and height of the sensor, in pixels.
    time_unit : str
        Of the times in HDF5: ns, us, ms or s.
    settings : mapping
        Settings of edge-vpr by name, such as ``{"preset": "paper", "pixels": 150}``.
    program : sequence of str
        By which edge-vpr is called, for example the path of it in its own environment.
    """

    reference: Drive
    query: Drive
    window_ms: float
    resolution: tuple[int, int]
    time_unit: str = "ns"
    settings: Mapping[str, object] = field(default_factory=dict)
    program: Sequence[str] = ("edge-vpr",)


def write_distance_matrix(request: Request, output: Path) -> None:
    """Map the reference, match the query, and write all distances.

    Parameters
    ----------
    output : Path
        ``.npy`` of float64, shape (references, queries), all finite; replaced if it exists.

    Raises
    ------
    EdgeVprFailedError
        If edge-vpr is not there or ends with an error.
    """
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="edge_vpr_") as folder:
        for words in commands(request, output, Path(folder)):
            _call(words)


#: Event-LAB's truth has a row for each window
_EACH_WINDOW = ("--places-per-window", "1")


def commands(request: Request, output: Path, folder: Path) -> list[list[str]]:
    """Return the two command lines; map and matches are written into `folder`."""
    reference, query = request.reference, request.query
    tau = [] if reference.is_frames else ["--tau", f"{request.window_ms:g}ms"]
    return [
        [*request.program, "map", str(reference.path), "-o", str(folder / "map.npz"), "--quiet",
         *_reading(request, reference), *tau, *_EACH_WINDOW, *_flags(request.settings)],
        [*request.program, "match", str(folder / "map.npz"), str(query.path), "--quiet",
         "-o", str(folder / "matches"), "--no-figures", "--overwrite", "--matrix", str(output),
         *_reading(request, query)],
    ]  # fmt: skip


def _reading(request: Request, drive: Drive) -> list[str]:
    words = []
    if drive.is_frames:
        words += ["--frames-as-windows"]
        if not (drive.path / "metadata.json").is_file():
            words += ["--frame-period", f"{request.window_ms:g}/1000"]
    else:
        width, height = request.resolution
        words += ["--sensor", f"{width}x{height}", "--time-unit", request.time_unit]
    if drive.offset_s is not None and not drive.is_frames:
        words += ["--start-offset", drive.offset_s]
    return words


def _flags(settings: Mapping[str, object]) -> list[str]:
    words = []
    for name, value in settings.items():
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", str(value)]
    return words


def _call(words: Sequence[str]) -> None:
    try:
        run = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError as error:
        raise EdgeVprFailedError(
            f"{words[0]} cannot be started ({error.strerror}): install edge-vpr in an environment "
            "of its own, and name its program in edge_vpr.yaml"
        ) from error
    if run.returncode:
        lines = run.stderr.strip().splitlines()
        raise EdgeVprFailedError(lines[-1] if lines else f"{words[0]} ended with {run.returncode}")
