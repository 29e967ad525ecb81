"""Replay golden vectors on ``vpr_core`` by cocotb, with stalls and resets at random.

``python cocotb/vpr_cocotb.py vectors/corners/tie_of_two ...`` in the folder of the project compiles
the sources by Icarus Verilog (or ``--simulator``) and replays each case; without names, all cases
of all suites. Words of every stream are compared with the case's files. What is offered must stay
until it is taken, no handshake may be undefined, and nothing may follow the last word.

The bench knows the streams of ``vpr_core`` alone: a core of one's own with the same ports can
stand in its place (``--sources``).
"""

from __future__ import annotations

import argparse
import os
import random
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, RisingEdge

#: clocks without a word after which a core stands still, and after the last word
PATIENCE = int(os.environ.get("VPR_PATIENCE", "20000"))
QUIET = 500


class Stream(NamedTuple):
    """Signals of one stream; words of ``data`` are those of a file of the case."""

    clk: Any
    valid: Any
    ready: Any
    data: Any
    last: Any = None


class Side:
    """Both sides of the streams of a device, which wait in some of the clocks."""

    def __init__(self, dut: Any, draw: random.Random, stall: int) -> None:
        self.dut, self._draw, self._stall = dut, draw, stall

    def waits(self) -> bool:
        """Draw whether a side waits in this clock."""
        return self._draw.randrange(100) < self._stall

    def stream(self, name: str) -> Stream:
        """Return a stream by its name, such as ``m_match``."""
        dut = self.dut
        valid, ready, data = (
            getattr(dut, f"{name}_{part}") for part in ("tvalid", "tready", "tdata")
        )
        last = dut.m_window_tlast if name == "m_window" else None
        return Stream(dut.clk_i, valid, ready, data, last)

    async def offer(self, name: str, words: Sequence[int]) -> None:
        """Offer words, one after the other; each stays until it is taken."""
        stream = self.stream(name)
        await FallingEdge(stream.clk)
        for word in words:
            while self.waits():
                await FallingEdge(stream.clk)
            stream.data.value = word
            stream.valid.value = 1
            ready = False
            while not ready:
                await RisingEdge(stream.clk)
                ready = defined(stream.ready, name)
            await FallingEdge(stream.clk)
            stream.valid.value = 0

    async def take(self, name: str, taken: list[tuple[int, bool]]) -> None:
        """Append what a stream gives, with its tlast; see that it stays until it is taken."""
        stream, held = self.stream(name), None
        while True:
            await FallingEdge(stream.clk)
            ready = not self.waits()
            stream.ready.value = ready
            await RisingEdge(stream.clk)
            valid = defined(stream.valid, name)
            assert valid or held is None, f"{name} was withdrawn before it was taken"
            if not valid:
                continue
            assert stream.data.value.is_resolvable, f"{name} is undefined"
            word = int(stream.data.value), stream.last is not None and defined(stream.last, name)
            assert held in (None, word), f"{name} changed before it was taken"
            held = None if ready else word
            if ready:
                taken.append(word)


def defined(signal: Any, name: str) -> bool:
    """Return a signal of one bit, which must not be undefined."""
    assert signal.value.is_resolvable, f"a handshake of {name} is undefined"
    return bool(int(signal.value))


def words_of(case: Path, name: str) -> list[int]:
    """Read a file of words, of which there may be none."""
    path = case / f"{name}.mem"
    return [int(line, 16) for line in path.read_text("ascii").split()] if path.exists() else []


@contextmanager
def running(*routines: Any) -> Iterator[None]:
    """Run coroutines at once, and end them."""
    tasks = [cocotb.start_soon(routine) for routine in routines]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()


async def reset(side: Side, case: Path) -> None:
    """Begin anew: what the start is, is read in the last clock of the reset alone."""
    dut = side.dut
    for name in ("s_place", "s_event"):
        side.stream(name).valid.value = 0
    for name in ("m_event", "m_window", "m_match"):
        side.stream(name).ready.value = 0
    await FallingEdge(dut.clk_i)
    dut.rst_i.value = 1
    (dut.start_time_i.value,) = (words_of(case, "start")[0] % (1 << len(dut.start_time_i)),)
    activity = words_of(case, "activity")
    dut.start_activity_i.value = activity[0] if activity else 0
    for _ in range(side._draw.randint(1, 3)):
        await FallingEdge(dut.clk_i)
    dut.rst_i.value = 0
    for signal in (dut.start_time_i, dut.start_activity_i):
        signal.value = side._draw.getrandbits(len(signal))


@cocotb.test()
async def replay(dut: Any) -> None:
    """Give the case's events, after resets in the middle of it; compare all that comes."""
    case = Path(os.environ["VPR_CASE"])
    side = Side(dut, random.Random(int(os.environ["VPR_SEED"])), int(os.environ["VPR_STALL"]))
    expected = {
        name: words_of(case, f"expected_{kind}")
        for name, kind in (("m_event", "events"), ("m_window", "windows"), ("m_match", "matches"))
    }
    Clock(dut.clk_i, 20, "ns").start()
    for signal in (dut.load_i, dut.load_address_i, dut.load_word_i):
        signal.value = 0
    for left in reversed(range(int(os.environ["VPR_RESETS"]) + 1)):
        await reset(side, case)
        taken: dict[str, list[tuple[int, bool]]] = {name: [] for name in expected}

        async def give() -> None:
            # the places first: a match with part of a map has no meaning
            await side.offer("s_place", words_of(case, "places"))
            await side.offer("s_event", words_of(case, "events"))

        with running(give(), *(side.take(name, words) for name, words in taken.items())):
            if left:
                for _ in range(side._draw.randint(20, 3000)):
                    await RisingEdge(dut.clk_i)
            else:
                await until_all(dut, taken, expected)
    for name, words in expected.items():
        came = [word for word, _ in taken[name]]
        for number, (word, right) in enumerate(zip(came, words, strict=False)):
            assert word == right, f"{name} {number} is {word:#x}, and must be {right:#x}"
        assert len(came) == len(words), f"{len(came)} of {len(words)} words of {name} came"
    in_window = words_of_a_window((case / "vpr_pkg.sv").read_text("ascii"))
    for number, (_, last) in enumerate(taken["m_window"]):
        assert last == ((number + 1) % in_window == 0), f"m_window_tlast of word {number}"


def words_of_a_window(package: str) -> int:
    """Return the number of words of a descriptor by the constants of a design."""
    constants = re.findall(r"localparam \w+ +(\w+) += (?:1'd)?(\d+);", package)
    values = {name: int(value) for name, value in constants}
    return -(-values["PIXELS"] // values["LANES"])


async def until_all(
    dut: Any, taken: dict[str, list[tuple[int, bool]]], expected: dict[str, list[int]]
) -> None:
    """Wait until as many words came as must, and some clocks more, in which none may come."""
    quiet, before = 0, -1
    while True:
        await RisingEdge(dut.clk_i)
        come = sum(map(len, taken.values()))
        quiet, before = (quiet + 1 if come == before else 0), come
        whole = all(len(taken[name]) >= len(words) for name, words in expected.items())
        if quiet > (QUIET if whole else PATIENCE):
            return


def main(words: Sequence[str] | None = None) -> int:
    """Run the command: compile once for each set of parameters, and replay case after case."""
    # not within the simulation
    from cocotb_tools.check_results import get_results
    from cocotb_tools.runner import get_runner

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cases", nargs="*", type=Path, help="folders of cases")
    parser.add_argument("--simulator", default="icarus", help="a runner of cocotb")
    parser.add_argument("--sources", nargs="+", type=Path, help="in place of those in src/")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stall", type=int, default=40, metavar="PER_CENT")
    parser.add_argument("--resets", type=int, default=1, metavar="N")
    parser.add_argument("--build", type=Path, default=Path("sim_build"), metavar="FOLDER")
    args = parser.parse_args(words)
    home = Path(__file__).resolve().parents[1]
    every = sorted(path.parent for path in (home / "vectors").glob("*/*/vpr_pkg.sv"))
    cases = [case.resolve() for case in args.cases] or every
    sources = args.sources or sorted((home / "src").glob("vpr_*.sv"))
    device = [path.resolve() for path in sources if path.name not in _NOT_OF_THE_DEVICE]
    builds: dict[str, Path] = {}
    failed = 0
    for case in cases:
        package = case / "vpr_pkg.sv"
        text = package.read_text("ascii")
        new = text not in builds
        build = builds.setdefault(text, args.build.resolve() / str(len(builds)))
        runner = get_runner(args.simulator)
        runner.build(
            sources=[package, *device],
            hdl_toplevel="vpr_core",
            always=new,
            timescale=("1ns", "1ps"),
            build_dir=build,
        )
        results = build / "results.xml"
        with suppress(SystemExit):  # which says that it failed: so do the results
            runner.test(
                test_module=Path(__file__).stem,
                hdl_toplevel="vpr_core",
                build_dir=build,
                test_dir=case,
                results_xml=str(results),
                timescale=("1ns", "1ps"),
                extra_env={
                    "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
                    "COCOTB_LOG_LEVEL": "WARNING",
                    "GPI_LOG_LEVEL": "ERROR",
                    "VPR_CASE": str(case),
                    "VPR_SEED": str(args.seed),
                    "VPR_STALL": str(args.stall),
                    "VPR_RESETS": str(args.resets),
                },
            )
        number, bad = get_results(results)
        failed += bad > 0 or number == 0
        print(
            f"{case.parent.name}/{case.name}: {'DIFFERS' if bad or number == 0 else 'equal'}",
            flush=True,
        )
    print(f"{len(cases)} cases, {failed} differ")
    return int(failed > 0)


#: beside the device and its units
_NOT_OF_THE_DEVICE = {
    *("vpr_pkg.sv", "vpr_registers.sv", "vpr_axi_lite.sv", "vpr_spi.sv", "vpr_spi_device.sv"),
    *("vpr_up5k.sv", "vpr_ulx3s.sv", "vpr_bench.sv", "vpr_axi_bench.sv", "vpr_up5k_bench.sv"),
}

if __name__ == "__main__":
    sys.exit(main())
