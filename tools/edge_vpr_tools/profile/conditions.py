"""Conditions of the machine: governor, clock, temperature, throttling."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

from edge_vpr_tools.profile.sensors.pmic import vcgencmd
from edge_vpr_tools.profile.sensors.sensor import ROOT, read_text

#: bits of ``vcgencmd get_throttled``; the same bits shifted by 16 cover the time since boot
_NOW = {0: "under-voltage", 1: "frequency capped", 2: "throttled", 3: "soft temperature limit"}


@dataclass(frozen=True)
class Conditions:
    """Conditions that affect a measurement; None means not known."""

    governor: str | None
    frequency_hz: float | None  #: Clock of the first core.
    temperature_c: float | None  #: Temperature of the hottest zone.
    throttled: int | None  #: Bits as returned by ``vcgencmd get_throttled``.
    #: Number of times that cores were throttled since boot, if the processor counts them.
    throttle_events: int | None

    @classmethod
    def now(cls, root: Path = ROOT) -> Conditions:
        """Read the current conditions."""
        cpu = root / "sys/devices/system/cpu/cpu0/cpufreq"
        clock = _number(cpu / "scaling_cur_freq")
        zones = [_number(p) for p in (root / "sys/class/thermal").glob("thermal_zone*/temp")]
        counters = root.glob("sys/devices/system/cpu/cpu*/thermal_throttle/core_throttle_count")
        events = [count for count in map(_number, counters) if count is not None]
        degrees = [zone / 1e3 for zone in zones if zone is not None]
        return cls(
            governor=read_text(cpu / "scaling_governor") or None,
            frequency_hz=None if clock is None else clock * 1e3,
            temperature_c=max(degrees, default=None),
            throttled=_throttled(root),
            throttle_events=int(sum(events)) if events else None,
        )

    def __str__(self) -> str:
        """Return the known conditions, with units."""
        parts = []
        if self.governor is not None:
            parts.append(f"governor {self.governor}")
        if self.frequency_hz is not None:
            parts.append(f"clock {self.frequency_hz / 1e6:,.0f} MHz")
        if self.temperature_c is not None:
            parts.append(f"{self.temperature_c:.1f} degrees Celsius")
        if self.throttled is not None:
            parts.append(f"throttled 0x{self.throttled:x}")
        if self.throttle_events is not None:
            parts.append(f"throttled {self.throttle_events} times since the start")
        return ", ".join(parts) or "governor, clock, temperature and throttling are not known"

    @property
    def faults(self) -> list[str]:
        """Causes that currently throttle the machine."""
        bits = self.throttled or 0
        return [text for bit, text in _NOW.items() if bits >> bit & 1]


def void_because(*moments: Conditions) -> str:
    """Return why a run under these conditions is void; empty if it is valid as far as known."""
    faults = [fault for moment in moments for fault in moment.faults]
    before, after = moments[0], moments[-1]
    if before.throttled is not None and after.throttled is not None:
        new = (after.throttled & ~before.throttled) >> 16
        faults += [f"{text} meanwhile" for bit, text in _NOW.items() if new >> bit & 1]
    if (after.throttle_events or 0) > (before.throttle_events or 0):
        faults.append("throttled by temperature meanwhile")
    return ", ".join(dict.fromkeys(faults))


def _number(path: Path) -> float | None:
    try:
        return float(read_text(path))
    except ValueError:
        return None


def _throttled(root: Path) -> int | None:
    command = vcgencmd(root)
    if command is None:
        return None
    try:
        done = subprocess.run(
            [command, "get_throttled"], capture_output=True, text=True, check=True, timeout=5
        )
        return int(done.stdout.strip().partition("=")[2], 16)
    except (OSError, subprocess.SubprocessError, ValueError):
        return None
