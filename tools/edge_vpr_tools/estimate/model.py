"""What a design costs on a target: instructions or cycles, time, and modelled energy.

The layers are separate: counts are exact, instructions come from tables that were counted on the
emulated firmware, time needs an assumed number of cycles per instruction, and energy a cited
constant. Without a constant the energy is None, which is shown as unknown.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr_tools.estimate import core_area
from edge_vpr_tools.estimate.emulation import predict
from edge_vpr_tools.estimate.targets import Spread, Target, constants
from firmware_model.cost import Memory, cycles, memories, operations
from firmware_model.design import Design
from firmware_model.emulation.instructions import TABLE
from firmware_model.image import image_bytes, ram_bytes
from fixedpoint.formats import packed_bytes

# Exact counts of a design, from its parameters alone.


#: depths and widths in which a block memory can be used
Shapes = Sequence[tuple[int, int]]


class Search(NamedTuple):
    """What the search for the place of a window does, once L windows have been seen.

    An addition has two operands: the first term of a sum is not added to anything. A comparison is
    one use of a comparator: best, best on the left and second for every place, though a program may
    know without looking.
    """

    absolute_differences: int
    additions: int
    comparisons: int
    multiplications: int
    bytes_moved: float  #: Read from and written to all memories, packed without gaps.


def search_work(design: Design) -> Search:
    """Count what the search of a window that does not pause does."""
    return Search(*operations(design), _bytes_moved(design))


def _bytes_moved(design: Design) -> float:
    """Return the bytes of all words that a search reads and writes."""
    places, sized = design.places, memories(design)
    words = places * design.words * design.sums
    if design.filters:
        moved = {
            # those of the other places of a step are already read
            "metric": 2 * places * design.gains,
            "place_activity": places,
            "distance": 2 * places * design.sums,
            "delay": max(0, places - design.exclusion - 1) + places,
        }
    else:
        sums = places - design.length + 1
        moved = {
            "history": sums * (design.length - 1) + places,
            "delay": max(0, sums - design.exclusion - 1) + sums,
        }
    moved |= {"query": words, "places": words}
    return sum(number * sized[name].width for name, number in moved.items()) / 8


@dataclass(frozen=True)
class Sizes:
    """Memory that a design takes."""

    place_bytes: int  #: One place: its codes packed without gaps, and the filter's activity.
    packed_bytes: int  #: All memories of the device, without gaps.
    #: image_bytes, state_bytes: of the reference firmware in C, which keeps a byte a code: the map
    #: and its tables, and the arrays in RAM.
    image_bytes: int
    state_bytes: int


def sizes(design: Design) -> Sizes:
    """Size a design's memories."""
    bits = sum(memory.bits for memory in memories(design).values())
    return Sizes(
        place_bytes=packed_bytes(design.slots, design.code_bits) + design.filters,
        packed_bytes=-(-bits // 8),
        image_bytes=image_bytes(design),
        state_bytes=ram_bytes(design),
    )


def block_memories(design: Design, shapes: Shapes) -> int:
    """Count block memories: each memory takes whole ones, in the shape that suits it best."""
    return _blocks(memories(design).values(), shapes)


def large_and_small_blocks(design: Design, large: Shapes, small: Shapes) -> tuple[int, int]:
    """Count large blocks for places and metrics of several gains, and small ones for the rest."""
    sized = memories(design)
    in_large = [sized.pop(name) for name in ("places", *(["metric"] * (design.gains > 1)))]
    return _blocks(in_large, large), _blocks(sized.values(), small)


def _blocks(sized: Iterable[Memory], shapes: Shapes) -> int:
    return sum(min(memory.tiles(*shape) for shape in shapes) for memory in sized if memory.depth)


_PICO = 1e-12
#: events that the firmware takes in one call
_EVENTS_PER_CALL = 64
#: shortest bit of the core's SPI line, in clocks
_SPI_CLOCKS = 6
_ZERO = Spread(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Mission:
    """Rates of events and matches that a device has to process."""

    events_per_s: float  #: Of the whole sensor.
    selected_share: float  #: Of those, at selected pixels.
    matches_per_s: float

    def __post_init__(self) -> None:
        if not (self.events_per_s >= 0 and 0 <= self.selected_share <= 1):
            raise UsageError(
                f"{self.events_per_s:g} events per second, a share of {self.selected_share:g} at "
                "selected pixels: expected a rate from 0 and a share from 0 to 1"
            )
        if not self.matches_per_s > 0:
            raise UsageError(f"{self.matches_per_s:g} matches per second: expected more than 0")

    @classmethod
    def of(cls, design: Design, events_per_s: float, selected_share: float) -> Mission:
        """Return the mission of a design at a rate of events; each window gives a match."""
        matches_per_s = 1e6 / design.tau_us
        if design.window == "count":
            matches_per_s = events_per_s * selected_share / design.window_events
        return cls(events_per_s, selected_share, matches_per_s)

    @property
    def rates(self) -> dict[str, float]:
        """How often a second each unit of work is done."""
        selected = self.events_per_s * self.selected_share
        return {
            "selected event": selected,
            "other event": self.events_per_s - selected,
            "window": self.matches_per_s,
            "search": self.matches_per_s,
        }


@dataclass(frozen=True)
class Firmware:
    """Figures of a processor in the table next to the C sources."""

    compiler: str
    event_selected: int
    event_unselected: int
    events_call: int
    code_bytes: int
    stack_bytes: int


@cache
def firmware() -> Mapping[str, Firmware]:
    """Read the table that the emulated firmware wrote, by processor."""
    with TABLE.open(encoding="ascii", newline="") as file:
        return {
            row["target"]: Firmware(
                row["compiler"],
                *(int(row[name]) for name in list(Firmware.__dataclass_fields__)[1:]),
            )
            for row in csv.DictReader(file)
        }


@dataclass(frozen=True)
class Cost:
    """What each unit of work takes on a target.

    A match takes its share of the events, the end of its window, and the search for its place. The
    energy of a match is that of all three.
    """

    clock_hz: float  #: Of the target, an assumption.
    instructions: dict[str, float] | None  #: Processors only.
    #: Of the core, predicted from measured netlists; FPGAs that there are such of.
    logic_cells: int | None
    cycles: dict[str, Spread]  #: By the unit of work.
    seconds: dict[str, Spread]  #: By the unit of work.
    load: Spread  #: Share of the time that it is busy at the mission's rates; it must stay below 1.
    #: Most events per second that the SPI line of an FPGA carries; None of a processor.
    spi_events_per_s: float | None
    energy_j: dict[str, Spread] | None  #: Modelled; None if unknown.
    #: idle_w, whole_w: modelled: what is used besides the work, with a clock that runs between the
    #: events, and both, which is None if either is unknown.
    idle_w: Spread | None
    whole_w: Spread | None
    per_match_j: Spread | None  #: What the work of a match adds.
    matches_per_joule: Spread | None  #: One over it, as in a profile.

    def too_slow(self, events_per_s: float) -> str:
        """Return what may not keep up with a rate of events; empty if all does."""
        if self.load.high >= 1:
            return f"its speed: busy {self.load.low:.2g} to {self.load.high:.2g} of the time"
        if self.spi_events_per_s is not None and events_per_s > self.spi_events_per_s:
            return f"its SPI line: {self.spi_events_per_s:,.0f} events/s"
        return ""


def cost(design: Design, target: Target, mission: Mission) -> Cost:
    """Model a design on a target."""
    instructions = None
    if target.kind == "processor":
        instructions = instructions_of(design, target.core)
        taken = {unit: Spread(*target.cpi) * number for unit, number in instructions.items()}
    else:
        device = cycles(design)
        number = {
            "selected event": device.event,
            "other event": device.event,
            "window": device.encode,
            "search": device.compare + device.drain,
        }
        taken = {unit: Spread(1.0, 1.0, 1.0) * count for unit, count in number.items()}
    cells = core_area.cells(design) if target.logic_cells else None
    seconds = {unit: value * (1 / target.clock_hz) for unit, value in taken.items()}
    load = per_second(seconds, mission)
    energy = idle = clock = None
    if target.cycle_energy:
        clock = a_cycle = constants()[target.cycle_energy].value
        if target.cell_energy and cells is not None:
            a_cycle = a_cycle + constants()[target.cell_energy].value * cells
        energy = {unit: value * a_cycle * _PICO for unit, value in taken.items()}
    if target.idle_power:
        idle = constants()[target.idle_power].value
        if clock is not None and target.kind == "fpga":
            # the oscillator runs on; the work has the cycles that it takes
            idle = idle + clock * (target.clock_hz * max(0.0, 1 - load.central) * _PICO)
    marginal = None if energy is None else per_second(energy, mission)
    whole = None if marginal is None or idle is None else marginal + idle
    per_match = None if marginal is None else marginal * (1 / mission.matches_per_s)
    return Cost(
        clock_hz=target.clock_hz,
        instructions=instructions,
        logic_cells=cells,
        cycles=taken,
        seconds=seconds,
        load=load,
        spi_events_per_s=_spi_events_per_s(design, target),
        energy_j=energy,
        idle_w=idle,
        whole_w=whole,
        per_match_j=per_match,
        matches_per_joule=None if per_match is None else per_match.reciprocal(),
    )


def _spi_events_per_s(design: Design, target: Target) -> float | None:
    if target.kind != "fpga":
        return None
    return target.clock_hz / _SPI_CLOCKS / (64 if design.timestamp_bits <= 32 else 96)


def instructions_of(
    design: Design, core: str, events_per_call: int = _EVENTS_PER_CALL
) -> dict[str, float]:
    """Return the instructions of the reference firmware in C, for each unit of work.

    A call's own instructions are shared among its events.
    """
    counted, window_and_match = firmware()[core], predict(design, core)
    call = counted.events_call / events_per_call
    return {
        "selected event": counted.event_selected + call,
        "other event": counted.event_unselected + call,
        "window": float(window_and_match.window),
        "search": float(window_and_match.match),
    }


def per_second(of_unit: Mapping[str, Spread], mission: Mission) -> Spread:
    """Add up what the units of work of a second of the mission take."""
    return sum((of_unit[unit] * rate for unit, rate in mission.rates.items()), _ZERO)
