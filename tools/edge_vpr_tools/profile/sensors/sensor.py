"""Interface and description of power sensors."""

from __future__ import annotations

import errno
import math
import os
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from edge_vpr.errors import EdgeVprError

Kind = Literal["energy", "power"]
#: of the file system; tests replace it
ROOT = Path("/")


class SensorError(EdgeVprError):
    """A sensor cannot be read, or what it returns is no number."""


@dataclass(frozen=True)
class About:
    """What a sensor measures, and how well."""

    name: str  #: Name by which the user chooses the sensor.
    kind: Kind  #: {"energy", "power"}: whether it counts joules or returns watts.
    scope: str  #: Parts of the machine that the reading includes, and those that it does not.
    period_s: float  #: Time between two native readings; faster sampling gives duplicates.
    resolution: float | None = None  #: Step of a reading, in joules or watts; None: not known.
    #: Largest relative error of the scale, shunt included; None if it is not known.
    gain_error: float | None = None
    detail: str = ""  #: Source of the gain error, and what the user has to confirm.
    shunt_mohm: float | None = None  #: Shunt with which the reading was computed, if it is known.


class Sensor(ABC):
    """Source of power or energy readings."""

    about: About

    def __str__(self) -> str:
        return f"{self.about.name}: {self.about.scope}"

    @abstractmethod
    def read(self) -> float:
        """Return the joules since a fixed time, or the present watts.

        Raises
        ------
        SensorError
            If it has disappeared, refuses, or returns no number.
        """

    def sample(self) -> tuple[float, float]:
        """Return the time of a reading on the monotonic clock, and the reading.

        Equal times mean the same reading.
        """
        before = time.monotonic()
        value = self.read()
        # the reading was taken between these two times
        return (before + time.monotonic()) / 2, value

    def close(self) -> None:  # noqa: B027, most sensors hold nothing
        """Release all resources; may be called again."""


@dataclass(frozen=True)
class Missing:
    """Kind of sensor that is absent: why, and what would help."""

    kind: str
    reason: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}; {self.remedy}"


class NumberFile:
    """One number in a file of sysfs, opened once and read repeatedly from its beginning."""

    def __init__(self, path: Path) -> None:
        self._path, self._descriptor = path, -1

    def read(self) -> float:
        """Read the current number.

        Raises
        ------
        SensorError
            If the file has disappeared, may not be read, or holds no number.
        """
        path = self._path
        try:
            if self._descriptor < 0:
                self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            number = float(os.pread(self._descriptor, 64, 0))
            # a deleted file that is still open does not belong to the sensor any more
            if os.fstat(self._descriptor).st_nlink == 0:
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        except PermissionError as error:
            raise SensorError(
                f"{path} may not be read: run with sudo, or allow reading it"
            ) from error
        except (OSError, ValueError) as error:
            raise SensorError(
                f"{path} cannot be read ({error}): is the sensor still there?"
            ) from error
        if not math.isfinite(number):
            raise SensorError(f"{path} reads {number}, which is no number: check the driver")
        return number

    def close(self) -> None:
        """Close the file; a later read opens it again."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def read_text(path: Path) -> str:
    """Return the text of a small file; empty if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
