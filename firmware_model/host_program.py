"""The firmware's replay program on this computer."""

from __future__ import annotations

import subprocess
from pathlib import Path

from firmware_model.errors import ToolError


def run_host(program: Path, folder: Path, image: bytes, events: bytes, start: int) -> bytes:
    """Run a case by the program that was built for this computer.

    Parameters
    ----------
    program : path
    folder : path
        For its files.
    image, events : bytes
    start : int

    Returns
    -------
    bytes
        Records of results.

    Raises
    ------
    ToolError
        If it fails.
    """
    image_file, events_file, out = (folder / f"{program.stem}.{s}" for s in ("img", "evt", "out"))
    image_file.write_bytes(image)
    events_file.write_bytes(events)
    command = [*map(str, (program.absolute(), image_file, events_file, start, out))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ToolError(f"{program.name}: {done.stderr.strip() or f'exit {done.returncode}'}")
    return out.read_bytes()
