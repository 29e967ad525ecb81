"""What every power sensor says of itself, and where to look for one."""

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
ROOT = Path("/")
#: no board of this kind takes more; a reading beyond it is a fault of the sensor
MAX_WATTS = 10_000.0


class SensorError(EdgeVprError):
    """A sensor cannot be read, or reads what cannot be."""


@dataclass(frozen=True)
class About:
    """What a sensor measures, and how well.

    Attributes
    ----------
    name : str
        By which the user chooses it.
    kind : {"energy", "power"}
        Counts joules, or tells watts.
    scope : str
        What is in the reading, and what is not.
    period_s : float
        Between two native readings; faster sampling gives duplicates.
    resolution : float
        Step of a reading, in joules or watts; 0 where it is not known.
    gain_error : float
        Largest relative error of the scale, shunt included.
    detail : str
        Where the gain error is from, and what the user has to confirm.
    shunt_mohm : float, optional
        The shunt that the reading was computed with, where that is told.
    """

    name: str
    kind: Kind
    scope: str
    period_s: float
    resolution: float = 0.0
    gain_error: float = 0.0
    detail: str = ""
    shunt_mohm: float | None = None


class Sensor(ABC):
    """A source of power or energy readings."""

    about: About

    @abstractmethod
    def read(self) -> float:
        """Joules since some moment, or watts now.

        Raises
        ------
        SensorError
            If it vanished, refuses, or reads what cannot be.
        """

    def sample(self) -> tuple[float, float]:
        """Read, and tell of what moment of the monotonic clock it is.

        The same moment twice is the same reading.
        """
        before = time.monotonic()
        value = self.read()
        # of some moment between the two
        return (before + time.monotonic()) / 2, value

    def close(self) -> None:  # noqa: B027, most sensors hold nothing
        """Give back what it holds; again is harmless."""


@dataclass(frozen=True)
class Missing:
    """A kind of sensor that is not there: why, and what would help."""

    kind: str
    reason: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}; {self.remedy}"


class NumberFile:
    """One number in a file of sysfs, opened once and read from its beginning again and again.

    Parameters
    ----------
    path : path
    """

    def __init__(self, path: Path) -> None:
        self._path, self._descriptor = path, -1

    def read(self) -> float:
        """Read it anew.

        Raises
        ------
        SensorError
            If the file vanished, may not be read, or holds no number.
        """
        path = self._path
        try:
            if self._descriptor < 0:
                self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            number = float(os.pread(self._descriptor, 64, 0))
            # a file that is only left to us is not the sensor's any more
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
        """Close; a later read opens it again."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def read_text(path: Path) -> str:
    """Text of a small file; empty if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def plausible(watts: float, name: str) -> float:
    """Give the power back if it can be.

    Raises
    ------
    SensorError
        If it is negative by more than noise, or beyond what any board takes.
    """
    if not -1.0 <= watts <= MAX_WATTS:
        raise SensorError(
            f"{name} reads {watts:g} W, which is impossible: check its wiring and driver"
        )
    return watts
