"""Draw the core's handshakes: ``python -m firmware_model.hardware.waves -o waves.svg``.

A case is simulated with stalls. Its trace is drawn around the end of a window and around a match.
Needs Icarus Verilog.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from firmware_model.design import Design
from firmware_model.errors import ToolError, VectorError
from firmware_model.hardware import simulation
from firmware_model.hardware.parameters import PACKAGE
from firmware_model.vectors.suite import standard_suites, write_suites

DESIGN = Design(
    width=24,
    height=16,
    pixels=9,
    places=4,
    length=2,
    code_bits=4,
    window="count",
    window_events=6,
    lanes=5,
)
CASE = "random_0"
#: signals of each of the two drawings; an empty name is a gap
EVENTS = (
    *("clk", "", "s_event_tvalid", "s_event_tready", "", "m_event_tvalid", "m_event_tready"),
    *("", "window_end", "", "m_window_tvalid", "m_window_tready", "m_window_tlast"),
)
MATCH = (
    *("clk", "", "m_match_tvalid", "m_match_tready"),
    *("", "s_event_tvalid", "s_event_tready", "", "window_end"),
)
_WIDTH, _HEIGHT, _STEP, _LEFT = 26, 14, 22, 140

#: one dict of values for each clock
Samples = list[dict[str, str]]


def sample(trace: str, names: Sequence[str]) -> Samples:
    """Return the signals at each rising edge of ``clk``.

    Parameters
    ----------
    trace : str
        Text of a VCD file.
    names : sequence of str
        Names of signals of one bit.

    Returns
    -------
    list of dict of str to str
        ``0``, ``1`` or ``x`` of each signal, for each rising edge.
    """
    codes: dict[str, list[str]] = {}
    now = dict.fromkeys(names, "x")
    samples: Samples = []
    before = dict(now)
    for line in trace.splitlines():
        words = line.split()
        if words[:1] == ["$var"] and words[4] in now:
            codes.setdefault(words[3], []).append(words[4])
        elif line[:1] == "#":
            before = dict(now)
        elif line[:1] in ("0", "1", "x", "z"):
            for name in codes.get(line[1:], ()):
                if name == "clk" and line[0] == "1":
                    samples.append(before)
                now[name] = line[0]
    missing = set(names) - {name for found in codes.values() for name in found}
    if missing:
        raise VectorError(f"the trace has no signal {', '.join(sorted(missing))}")
    return samples


def around(samples: Samples, name: str, before: int, after: int, most: dict[str, str]) -> Samples:
    """Return the clocks around a rise of a signal, the rise with the most clocks like `most`."""
    rises = [
        samples[at - before : at + after]
        for at in range(before, len(samples) - after)
        if samples[at][name] == "1" and samples[at - 1][name] == "0"
    ]
    if not rises:
        raise VectorError(f"{name} does not rise in the trace: is it of the case {CASE}?")
    return max(rises, key=lambda clocks: sum(most.items() <= clock.items() for clock in clocks))


def draw(panels: Sequence[tuple[str, Sequence[str], Samples]]) -> str:
    """Draw panels one below another, and return them as SVG.

    Parameters
    ----------
    panels : sequence of (str, sequence of str, samples)
        Title, signals from top to bottom, and clocks from left to right.
    """
    width = _LEFT + _WIDTH * max(len(clocks) for _, _, clocks in panels) + 12
    lines: list[str] = []
    top = 12
    for title, names, clocks in panels:
        lines.append(f'<text x="12" y="{top + 12}" font-weight="bold">{title}</text>')
        top += 34
        foot = top + sum(_STEP if name else _STEP // 2 for name in names)
        for at in range(len(clocks) + 1):
            x = _LEFT + at * _WIDTH
            lines.append(f'<path d="M{x} {top - 6}V{foot - 2}" stroke="#ddd"/>')
        for valid in (name for name in names if name.endswith("_tvalid")):
            y = top + sum(_STEP if name else _STEP // 2 for name in names[: names.index(valid)])
            lines.extend(
                f'<rect x="{_LEFT + at * _WIDTH}" y="{y - 3}" width="{_WIDTH}" '
                f'height="{_STEP * 2 - 2}" fill="#d8ecd8"/>'
                for at, clock in enumerate(clocks)
                if clock[valid] == clock[valid.replace("tvalid", "tready")] == "1"
            )
        for name in names:
            if name:
                lines.append(
                    f'<text x="{_LEFT - 8}" y="{top + 12}" text-anchor="end">{name}</text>'
                )
                lines.append(_wave([clock[name] for clock in clocks], top, clock=name == "clk"))
            top += _STEP if name else _STEP // 2
        top += 16
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {top}" '
            'font-family="sans-serif" font-size="12" role="img" aria-labelledby="title">',
            '<title id="title">Handshakes of the core in a simulation</title>',
            f'<rect width="{width}" height="{top}" fill="#ffffff"/>',
            *lines,
            "</svg>\n",
        ]
    )


def _wave(values: Sequence[str], top: int, *, clock: bool) -> str:
    """Draw one signal; the clock falls in the middle of each of its periods."""
    high, low = top, top + _HEIGHT
    parts = []
    for at, value in enumerate(values):
        x = _LEFT + at * _WIDTH
        if clock:
            parts.append(f"M{x} {low}V{high}H{x + _WIDTH // 2}V{low}H{x + _WIDTH}")
        else:
            y = {"0": low, "1": high}.get(value, (low + high) // 2)
            parts.append(f"{'L' if at else 'M'}{x} {y}H{x + _WIDTH}")
    return f'<path d="{"".join(parts)}" fill="none" stroke="#1f4e79" stroke-width="1.6"/>'


def simulate() -> str:
    """Simulate the case, and return its trace as VCD.

    Raises
    ------
    ToolError
        If Icarus Verilog is not installed.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cases = [
            case for case in standard_suites(DESIGN, 1, "random")["random"] if case.name == CASE
        ]
        write_suites(folder / "v", DESIGN, {"random": cases}, 1, rtl=True)
        case = folder / "v" / "random" / CASE
        simulation.compile_bench(case / f"{PACKAGE}.sv", folder / "core.vvp")
        trace = folder / "trace.vcd"
        conditions = simulation.Conditions(stall=35)
        simulation.replay(
            folder / "core.vvp", case, CASE, folder / "results.csv", conditions, trace=trace
        )
        return trace.read_text(encoding="ascii")


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a tool is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.svg")
    args = parser.parse_args(words)
    try:
        samples = sample(simulate(), sorted({*EVENTS, *MATCH} - {""}))
        panels = [
            (
                "Events, one of which ends a window",
                EVENTS,
                around(
                    samples, "window_end", 14, 18, {"s_event_tvalid": "1", "s_event_tready": "1"}
                ),
            ),
            (
                "A match, which waits until it is taken; so does the end of the next window",
                MATCH,
                around(
                    samples,
                    "m_match_tvalid",
                    14,
                    18,
                    {"m_match_tvalid": "1", "m_match_tready": "0"},
                ),
            ),
        ]
    except (ToolError, VectorError) as error:
        print(error, file=sys.stderr)
        return 1
    args.output.write_text(draw(panels), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
