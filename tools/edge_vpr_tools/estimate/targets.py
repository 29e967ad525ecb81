"""Targets and cited constants, from TOML files here and from the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.records import from_json, parse_errors, read_toml
from edge_vpr_tools.estimate.emulation import scaling

_HERE = Path(__file__).parent
KINDS = ("processor", "fpga")
_FASTEST_HZ, _MOST_BLOCKS = 1e15, 1 << 32


@dataclass(frozen=True)
class Spread:
    """A value known within bounds."""

    low: float
    central: float
    high: float

    def __mul__(self, other: float | Spread) -> Spread:
        """Multiply by a number, or end by end by another spread."""
        by = other if isinstance(other, Spread) else Spread(other, other, other)
        return Spread(self.low * by.low, self.central * by.central, self.high * by.high)

    def reciprocal(self) -> Spread | None:
        """Return one over the value; None if it can be 0."""
        return Spread(1 / self.high, 1 / self.central, 1 / self.low) if self.low > 0 else None

    def __add__(self, other: Spread) -> Spread:
        """Add end by end."""
        return Spread(self.low + other.low, self.central + other.central, self.high + other.high)


@dataclass(frozen=True)
class Constant:
    """A cited constant."""

    name: str
    unit: str
    value: Spread
    year: int | str  #: Of the measurement.
    #: node, source, uncertainty: what was measured, by whom, and what low and high stand for.
    node: str
    source: str
    uncertainty: str


@dataclass(frozen=True, kw_only=True)
class Target:
    """A device to estimate for; see the files in ``targets/``."""

    name: str  #: Of its file, as `--target` takes it.
    kind: str  #: {"processor", "fpga"}: what computes.
    clock_hz: float
    core: str = ""  #: Row of the table of instructions; processors only.
    cpi: tuple[float, ...] = ()  #: Cycles per instruction, an assumption; low, central, high.
    cpi_source: str = ""
    note: str = ""
    #: cycle_energy, cell_energy, idle_power: names of constants; empty where none is known. Of an
    #: FPGA whose `cell_energy` is known, a cycle takes that for each logic cell of the core
    #: besides.
    cycle_energy: str = ""
    cell_energy: str = ""
    idle_power: str = ""
    unknown: str = ""  #: Unknown figures, in a sentence; empty if there are none.
    logic_cells: int = 0  #: Of an FPGA for which the core's area is known; else 0.
    #: blocks, large_blocks: block memories, of the shapes (depth, width) that follow.
    blocks: int = 0
    #: block_shapes, large_block_shapes: depth and width of each shape that a block can take.
    block_shapes: tuple[tuple[int, int], ...] = ()
    large_blocks: int = 0
    large_block_shapes: tuple[tuple[int, int], ...] = ()

    @classmethod
    def load(cls, path: str | Path) -> Target:
        """Read a target from a TOML file.

        Raises
        ------
        UsageError
            If it cannot be read, or a name or value is wrong.
        """
        path = Path(path)
        values = _read(path)
        keys = {field.name for field in fields(cls)} - {"name"}
        for name in values:
            if name not in keys:
                raise UsageError(
                    f"{path} has the unknown name {name!r}: choose from {sorted(keys)}"
                )
        with parse_errors(path, "a target", "check its values"):
            target = from_json(cls, {"name": path.stem, **values})
        if target.kind not in KINDS:
            raise UsageError(f"{path}: kind = {target.kind!r}: choose from {', '.join(KINDS)}")
        if not 0 < target.clock_hz <= _FASTEST_HZ:
            raise UsageError(f"{path}: clock_hz = {target.clock_hz}: expected a positive number")
        sides = [*chain(*target.block_shapes, *target.large_block_shapes)]
        sizes = [target.logic_cells, target.blocks, target.large_blocks]
        if not (all(sides) and all(0 <= size <= _MOST_BLOCKS for size in sizes + sides)):
            raise UsageError(f"{path}: blocks and cells are numbers from 0 to {_MOST_BLOCKS}")
        if target.kind == "processor":
            _check_processor(target, path)
        for name in (target.cycle_energy, target.cell_energy, target.idle_power):
            if name and name not in constants():
                raise UsageError(f"{path}: there is no constant {name!r} in energy.toml")
        return target


def find(name: str) -> Target:
    """Find a target by the name of its file here, or by the path of the user's own."""
    targets = names()
    if name in targets:
        return Target.load(_HERE / "targets" / f"{name}.toml")
    if name.endswith(".toml"):
        return Target.load(name)
    raise UsageError(f"target {name!r}: choose from {', '.join(targets)}, or name a TOML file")


def names() -> list[str]:
    """Return the names of the targets that come with edge-vpr."""
    return sorted(path.stem for path in (_HERE / "targets").glob("*.toml"))


@cache
def constants() -> Mapping[str, Constant]:
    """Read the cited constants by name."""
    return {
        name: Constant(
            name=name,
            unit=row["unit"],
            value=Spread(row["low"], row["central"], row["high"]),
            **{key: row[key] for key in ("year", "node", "source", "uncertainty")},
        )
        for name, row in _read(_HERE / "energy.toml").items()
    }


def _check_processor(target: Target, path: str | Path) -> None:
    if target.core not in scaling():
        raise UsageError(
            f"{path}: core = {target.core!r}: the firmware was emulated on {', '.join(scaling())}"
        )
    if (
        len(target.cpi) != 3
        or not 0 < target.cpi[0] <= target.cpi[1] <= target.cpi[2] <= _FASTEST_HZ
    ):
        raise UsageError(f"{path}: cpi = {list(target.cpi)}: expected low, central and high")


def _read(path: Path) -> dict[str, Any]:
    return read_toml(path, "a target", "name a TOML file as those in estimate/targets")
