"""Damage images of the reference firmware at random, open them, and run those that open.

``python -m firmware_model.verification.fuzz_images --images 1_000_000`` does so under
AddressSanitizer and UndefinedBehaviorSanitizer. Images that open run on random events, and what
they return must be in the ranges that the image gives.
"""

from __future__ import annotations

import argparse
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from firmware_model.emulation.build import build_sanitized
from firmware_model.errors import ToolError
from firmware_model.image import image
from firmware_model.vectors.random_cases import (
    random_adaptive_design,
    random_design,
    random_memories,
)
from firmware_model.verification.images import image_cases, packed_block

FILES = ("vpr.c", "fuzz_main.c")
#: number of undamaged images of random designs, in addition to those of `image_cases`
DESIGNS = 96
#: larger images would make the run slow without testing anything else
_LARGEST = 4096
#: number of images in one call of the program
_CHUNK = 50_000


@dataclass(frozen=True)
class FuzzResult:
    """Outcome of damaged images.

    Attributes
    ----------
    images, opened, ran : int
        Images that need more than 1 MB of RAM open and do not run.
    events, windows, matches : int
        Of those that ran.
    """

    images: int = 0
    opened: int = 0
    ran: int = 0
    events: int = 0
    windows: int = 0
    matches: int = 0

    def __add__(self, other: FuzzResult) -> FuzzResult:
        return FuzzResult(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


def undamaged(seed: int) -> list[bytes]:
    """Return the images that will be damaged.

    Returns
    -------
    list of bytes
        Of random small designs, and those of `image_cases` that open.
    """
    rng = np.random.default_rng(seed)
    draws = (random_design, partial(random_adaptive_design, gains=(1, 7)))
    images = [image(random_memories(rng, draws[i % 2](rng))) for i in range(DESIGNS)]
    return images + [c.image for c in image_cases() if c.opens and len(c.image) <= _LARGEST]


class Fuzzer:
    """The compiled program, and the images that it damages.

    Parameters
    ----------
    folder : path
        For both.
    seed : int
        Of the images, and of the damage.

    Raises
    ------
    ToolError
        If the computer has no compiler with the sanitizers.
    """

    def __init__(self, folder: str | Path, seed: int) -> None:
        self.seed = seed
        self._program = build_sanitized(folder, FILES, "fuzz")
        self._images = Path(folder) / "undamaged"
        images = undamaged(seed)
        parts = [struct.pack("<I", len(images))]
        self._images.write_bytes(b"".join(parts + [packed_block(data) for data in images]))

    def run(self, number: int, first: int = 0) -> FuzzResult:
        """Damage and run images, from number `first` of the seed on.

        Raises
        ------
        ToolError
            At the first fault, value out of range or endless loop; the message names the image.
        """
        command = [*map(str, (self._program.absolute(), self._images, self.seed, first, number))]
        options = {"ASAN_OPTIONS": "abort_on_error=1:quarantine_size_mb=8"}
        options["UBSAN_OPTIONS"] = "abort_on_error=1:print_stacktrace=1"
        done = subprocess.run(
            command, capture_output=True, text=True, env=os.environ | options, check=False
        )
        if done.returncode:
            raise ToolError(
                f"seed {self.seed}, images from {first} on: exit {done.returncode}: "
                f"{done.stderr.strip()}"
            )
        return FuzzResult(*map(int, done.stdout.split()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the requested number of images, and print the outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=1_000_000, help="default %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="default %(default)s")
    parser.add_argument("--first", type=int, default=0, help="number of the first image")
    options = parser.parse_args(arguments)
    total, begun, at = FuzzResult(), time.monotonic(), options.first
    with tempfile.TemporaryDirectory() as folder:
        try:
            fuzzer = Fuzzer(folder, options.seed)
            while total.images < options.images:
                number = min(_CHUNK, options.images - total.images)
                total += fuzzer.run(number, at)
                at += number
                sys.stderr.write(f"{total.images:,} images\n")
        except ToolError as error:
            sys.exit(f"fuzz_images: {error}")
    sys.stdout.write(
        f"{total.images:,} damaged images, {total.opened:,} of which opened and {total.ran:,} ran: "
        f"{total.events:,} events, {total.windows:,} windows and {total.matches:,} matches; "
        f"no fault, no endless loop ({time.monotonic() - begun:.0f} "
        f"s, seed {options.seed})\n"
    )


if __name__ == "__main__":
    main()
