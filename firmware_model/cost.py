"""Cost of a design, computed from its parameters: memories, clock cycles, operations."""

from __future__ import annotations

from typing import NamedTuple

from firmware_model.design import Design, formats_of, widths_of


class Memory(NamedTuple):
    """A memory of `depth` words of `width` bits."""

    depth: int
    width: int

    @property
    def bits(self) -> int:
        """Number of used bits."""
        return self.depth * self.width

    def tiles(self, depth: int, width: int) -> int:
        """Return the number of block memories of a shape that it takes; they cannot be divided."""
        return -(-self.depth // depth) * -(-self.width // width)


def memories(design: Design, slow_blocks: bool = False) -> dict[str, Memory]:
    """Return the sizes of all memories of the device.

    Parameters
    ----------
    slow_blocks : bool
        Whether the core has registers for slow block memories, as on an ECP5: an event then takes a
        clock more.

    Returns
    -------
    dict of str to Memory
        Row displacements and look-up, with its delay line of pixels; counters; of
        contrast codes logarithms, limits, running means, those that they begin with, and the
        differences to them; the descriptor that is compared; the places; the distances of the
        last L windows, or the filter's metrics and distances, powers of two for logarithms of
        events, activities and biases of places, and costs by these activities; the delay line of
        the search. With several gains, a place has metrics of each and the least of them, and so
        has one behind the last; there are means and descriptors of each sum of windows, and counts
        of the windows before.
    """
    bits = widths_of(design)
    lanes = design.lanes * bits["code"]
    if design.filters:
        cost_bits = max(map(max, design.step_costs)).bit_length()
        kept = {
            "metric": Memory(_metrics(design), bits["metric"]),
            "place_activity": Memory(design.places, bits["place_activity"]),
            "place_bias": Memory(design.places, bits["place_bias"]),
            # a row a quarter of an octave, of 16 octaves
            "costs": Memory(64, design.steps * cost_bits),
            "distance": Memory(design.places, bits["biased"]),
            # 16 powers of 24 bits, each in 32 words of a bit
            "powers": Memory(16 * 32, 1),
        }
    else:
        kept = {"history": Memory(design.length * design.places, bits["distance"])}
    if design.contrast:
        kept["level"] = Memory(design.count_max + 1, bits["level"])
        kept["mean"] = Memory(design.sums * design.slots, bits["mean"])
        kept["first_mean"] = Memory(design.slots, bits["level"])
        kept["limit"] = Memory(design.slots, bits["limit"])
        # with sign and rounding
        kept["deviation"] = Memory(design.slots, bits["level"] + 2)
    descriptors = design.words
    if design.gains > 1:
        # of the window before; the sums of two windows that end with it, and with the one before it
        kept["before"] = Memory(design.slots, 3 * bits["count"])
        # each at a power of two
        descriptors = design.sums << max(1, (design.words - 1).bit_length())
    return {
        "displacement": Memory(design.height, bits["address"]),
        "lookup": Memory(design.lookup_depth, bits["owner"] + bits["slot"]),
        # while its entry is read: row of a pixel, and whether it is off the sensor
        "pixel_delay": Memory(3 if slow_blocks else 2, bits["row"] + 1),
        "counts": Memory(design.slots, bits["count"]),
        "query": Memory(descriptors, lanes),
        "places": Memory(design.places * design.words, lanes),
        **kept,
        "delay": Memory(design.exclusion + 1, bits["sum"]),
    }


def _metrics(design: Design) -> int:
    """Return the number of metrics that the filter keeps."""
    return design.places if design.gains == 1 else (design.places + 1) * (design.gains + 1)


class Cycles(NamedTuple):
    """Clock cycles of an event (one can begin in each cycle), a window's end, and a match."""

    event: int
    encode: int
    compare: int
    drain: int

    @property
    def match(self) -> int:
        """From the end of a window to its match."""
        return self.encode + self.compare + self.drain


def cycles(design: Design) -> Cycles:
    """Count the clock cycles of a window and its match.

    With sequences, a place takes ``ceil(slots / P)`` cycles in the distance unit and L in the
    sequence unit. The units work in parallel, so that the longer time counts. After the last
    distance come its L terms, the search, and the acceptance test. With the filter, the count is
    for a window that is neither the first nor a pause; with several gains, for one in which they
    look at all sums of windows.
    """
    if design.filters:
        parts = filter_cycles(design)
        compare = parts.compare + parts.mean + parts.advance
        return Cycles(1, encoding_cycles(design), compare, parts.scale + 1)
    period = max(design.words, design.length)
    compare = (design.places - 1) * period + design.words
    encode = encoding_cycles(design)
    return Cycles(event=1, encode=encode, compare=compare, drain=design.length + 2)


def encoding_cycles(design: Design) -> int:
    """Count the clock cycles of encoding a window: one a slot.

    Contrast codes take a second pass over the slots, behind the division for the mean of the first:
    a bit a cycle, and the sign's. With several gains, each sum of windows is encoded.
    """
    if not design.contrast:
        return design.slots
    return design.sums * (2 * design.slots + formats_of(design)["level"].width + 1)


class FilterCycles(NamedTuple):
    """Clock cycles of the filter's parts.

    Distances to all places, P codes in a cycle; the mean; the metrics, a place in two
    cycles; the spread and its reciprocal. With several gains, each sum of windows has distances, a
    mean and a spread, which takes a pass of its own; and beside the pass of each gain, two go over
    all metrics for changes of gain, the second, in `scale`, behind the match.
    """

    compare: int
    mean: int
    advance: int
    scale: int


def filter_cycles(design: Design) -> FilterCycles:
    """Count the clock cycles of the filter's parts.

    A restoring divider takes at most a cycle for each bit of the quotient: for the mean and the
    spread as many as the sum of all distances has bits, for the reciprocal 17.
    """
    form = formats_of(design)
    total, compare = form["distance_total"].width, design.places * design.words
    scale, sums = total + form["reciprocal"].width, design.sums
    if design.gains == 1:
        return FilterCycles(compare, total, 2 * design.places, scale)
    changes = 2 * _metrics(design)
    return FilterCycles(
        compare=sums * compare,
        mean=sums * total,
        advance=2 * design.gains * design.places + changes,
        scale=sums * (scale + 2 * design.places) + changes,
    )


class Operations(NamedTuple):
    """Arithmetic of one match, whatever the number of lanes."""

    absolute_differences: int
    additions: int
    comparisons: int
    multiplications: int


def operations(design: Design) -> Operations:
    """Count the operations of one match with L windows seen.

    With the filter, the count is for a window that is neither the first nor a pause. For each place
    it has a term of two sums (all distances, and their deviations from the mean), the difference to
    the smallest distance and its product, the cost of each step and their minimum, the evidence,
    its weight and its limits, the row of the costs (a difference of activities and its limits), and
    the search by a delay line. In addition there are three divisions. With seven gains, all three
    sums of windows are looked at.

    Returns
    -------
    Operations
        Additions are those of the distances and along the diagonals; comparisons those of the
        search (against the best, the best on the left, and the second) and one to accept.
    """
    if design.filters:
        return _filter_operations(design)
    sums = design.places - design.length + 1
    return Operations(
        absolute_differences=design.places * design.slots,
        additions=design.places * (design.slots - 1) + sums * (design.length - 1),
        comparisons=3 * sums + 1,
        multiplications=0,
    )


def _filter_operations(design: Design) -> Operations:
    places, gains, sums = design.places, design.gains, design.sums
    # steps that lead to a place from within the map
    steps = sum(max(0, places - step) for step in range(design.steps))
    return Operations(
        absolute_differences=places * (sums * design.slots + 1),
        additions=(
            # distances; both sums over places; the difference to the least distance
            sums * (places * (design.slots - 1) + 2 * (places - 1) + places)
            # the cost of a step, less the least metric; the evidence
            + gains * (2 * steps + places)
            + places  # the row of the costs
            + 2 * (gains - 1) * places  # the cost of a change to the gain beside, and back
        ),
        comparisons=(
            sums * (places - 1)  # least distance
            # least cost, and restart; limits of evidence and metric
            + gains * (steps + 3 * places)
            # the least gain of a place; changes of gain
            + 3 * (gains - 1) * places
            + 4 * places  # search; those of the row
            + 1  # accept
        ),
        multiplications=2 * places * sums,
    )
