"""The reference firmware on every target: it does what the vectors say, at the stated cost."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from designs import random_design, random_memories, random_stream, wrapped

from firmware_model import Design, DesignError, ToolError
from firmware_model.build import EMULATED, HOST, SOURCES, build
from firmware_model.emulator import Emulator, run_host
from firmware_model.image import image, ram_bytes
from firmware_model.vectors import Case, in_order, records, standard_suites, to_binary

pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
pytest.importorskip("unicorn", reason="unicorn is not installed (extra firmware)")
pytest.importorskip("elftools", reason="pyelftools is not installed (extra firmware)")

DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """One folder for all that is compiled, and the compiler's cache."""
    return tmp_path_factory.mktemp("firmware")


@pytest.fixture(scope="session")
def cases() -> dict[str, list[Case]]:
    """The suites that any design has."""
    return standard_suites(DESIGN, seed=0)


@pytest.fixture(scope="session")
def expected(cases) -> dict[str, bytes]:
    """What the model says to each case."""
    return {c.name: told(c) for suite in cases.values() for c in suite}


def told(case: Case) -> bytes:
    return to_binary(records(in_order(case.trace())))


def emulated(emulator: Emulator, case: Case) -> bytes:
    ram = ram_bytes(case.design)
    return emulator.replay(image(case.memories), case.event_bytes(), case.start, ram)


@pytest.fixture(scope="session", params=EMULATED, ids=lambda target: target.name)
def emulator(request, folder) -> Emulator:
    return Emulator(request.param, build(request.param, folder))


def test_every_suite_passes_on_every_emulated_processor(emulator, cases, expected):
    """Records of every event, window and match are the model's, to the byte."""
    for suite in cases.values():
        for case in suite:
            assert emulated(emulator, case) == expected[case.name], case.name


def test_every_suite_passes_on_this_computer(folder, cases, expected):
    """The same sources as an ordinary program."""
    program = build(HOST, folder)
    for suite in cases.values():
        for case in suite:
            found = run_host(program, folder, image(case.memories), case.event_bytes(), case.start)
            assert found == expected[case.name], case.name


def test_random_designs_on_every_emulated_processor(emulator):
    """Not only the design that the vectors were made for: 60 others, with all that may vary."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        memories = random_memories(rng, random_design(rng))
        start = int(rng.integers(0, 1 << memories.design.timestamp_bits))
        events = wrapped(random_stream(rng, memories, 150, start), memories.design)
        case = Case(str(seed), memories, tuple(events), start)
        assert emulated(emulator, case) == told(case), seed


def test_ram_is_what_the_model_says_and_no_more(emulator, cases):
    """With 16 bytes less than `ram_bytes` the firmware refuses; with it, nothing beyond is hurt."""
    case = cases["corners"][0]
    flash, events, ram = image(case.memories), case.event_bytes(), ram_bytes(case.design)
    with pytest.raises(ToolError, match="refuses"):
        emulator.replay(flash, events, case.start, ram - 16)


@pytest.mark.parametrize("word", [0, 1, 2, 6, 8, 9, 10, 16, 19, 20, 21, 22, 23, 24])
def test_an_image_that_cannot_be_is_refused(emulator, cases, word):
    """A header of another kind, version or size, beyond the limits, or with tables outside."""
    flash = bytearray(image(cases["corners"][0].memories))
    flash[word * 4 : word * 4 + 4] = (0x7FFF_FFF0).to_bytes(4, "little")
    with pytest.raises(ToolError, match="refuses"):
        emulator.replay(bytes(flash), b"", 0, 1 << 16)


def test_designs_beyond_the_firmware_are_refused():
    """Wide codes and clocks, and sums that would not fit, each named."""
    for changes, message in (
        ({"code": "linear", "code_bits": 9, "full_scales": (0,)}, "codes up to 511"),
        ({"timestamp_bits": 40}, "timestamps"),
        ({"pixels": 3000, "code_bits": 5}, "a distance up to"),
        (
            {"accept": "ratio", "ratio": (1, 65_535), "pixels": 2000, "length": 40, "places": 40},
            "sums times",
        ),
    ):
        design = replace(DESIGN, **({"lookup_depth": 0} | changes))
        memories = random_memories(np.random.default_rng(0), design)
        with pytest.raises(DesignError, match=message):
            image(memories)


# What a careless engineer might write: each a change of the sources that compiles.
MUTATIONS = {
    "saturates one too late": ("vpr.c", "count < d->count_max", "count <= d->count_max"),
    "saturates one too early": ("vpr.c", "count < d->count_max", "count + 1U < d->count_max"),
    "wraps instead of saturating": (
        "vpr.c",
        "if (count < d->count_max) {\n        s->counts[slot] = (uint16_t)(count + 1U);\n    }",
        "s->counts[slot] = (uint16_t)((count < d->count_max) ? (count + 1U) : 0U);",
    ),
    "does not clear": (
        "vpr.c",
        "        s->counts[i] = 0U;\n    }\n    s->start += d->tau;",
        "    }\n    s->start += d->tau;",
    ),
    "clears all but the last": (
        "vpr.c",
        "        s->counts[i] = 0U;\n    }\n    s->start += d->tau;",
        "        s->counts[i] = (i + 1U == d->slots) ? s->counts[i] : 0U;\n    }\n"
        "    s->start += d->tau;",
    ),
    "boundary belongs to the old window": (
        "vpr.c",
        "elapsed > d->open_until",
        "elapsed > d->open_until + 1",
    ),
    "window is one microsecond short": (
        "vpr.c",
        "elapsed > d->open_until",
        "elapsed >= d->open_until",
    ),
    "compares times unsigned": (
        "vpr.c",
        "if (elapsed > d->open_until)",
        "if ((uint32_t)elapsed > (uint32_t)d->open_until)",
    ),
    "compares times without the wrap": (
        "vpr.c",
        "if (elapsed > d->open_until)",
        "if ((d->tau != 0U) && (e->t > s->start) && (elapsed > d->open_until))",
    ),
    "next window starts at its first event": (
        "replay.c",
        "end_window(&writer, &design, &state, i);\n",
        "end_window(&writer, &design, &state, i);\n            state.start = events[i].t;\n",
    ),
    "drops the event behind the window": (
        "replay.c",
        "            status = vpr_event(&design, &state, &events[i]);\n        }",
        "            status = VPR_TAKEN;\n        }",
    ),
    "ends one window of a gap": (
        "replay.c",
        "while (status == VPR_END_THEN_RETRY)",
        "if (status == VPR_END_THEN_RETRY)",
    ),
    "budget off by one": ("vpr.c", "s->counted == d->budget", "s->counted == d->budget + 1U"),
    "budget counts every event": (
        "vpr.c",
        "    const uint32_t slot = slot_of(d, e);\n    if",
        "    const uint32_t slot = slot_of(d, e);\n"
        "    s->counted += (slot == VPR_NONE) ? 1U : 0U;\n    if",
    ),
    "budget is not reset": (
        "vpr.c",
        "    s->counted = 0U;\n    s->windows++;",
        "    s->windows++;",
    ),
    "swaps polarities": ("vpr.c", "(e->y_on & ON_BIT) != 0U", "(e->y_on & ON_BIT) == 0U"),
    "ignores the polarity": ("vpr.c", "? slot : (slot + d->off_slot)", "? slot : slot"),
    "takes rows for owners": ("vpr.c", "if ((entry >> 16) != y)", "if ((entry >> 16) > y)"),
    "does not look at the owner": (
        "vpr.c",
        "if ((entry >> 16) != y)",
        "if ((entry >> 16) == 0xFFFFU)",
    ),
    "takes columns off the sensor": ("vpr.c", "(x >= d->width) || ", ""),
    "one code table for all": (
        "vpr.c",
        "d->code_table[i] * (d->count_max + 1U)",
        "d->code_table[0] * (d->count_max + 1U)",
    ),
    "no code": (
        "vpr.c",
        "d->code[(d->code_table[i] * (d->count_max + 1U)) + s->counts[i]]",
        "(uint8_t)s->counts[i]",
    ),
    "distance forgets the last word": (
        "vpr.c",
        "sad(s->query, codes, d->stride)",
        "sad(s->query, codes, d->stride - 16U)",
    ),
    "distance is not absolute": (
        "sad.h",
        "(a[i] < b[i]) ? ((uint32_t)b[i] - a[i]) : ((uint32_t)a[i] - b[i])",
        "(a[i] < b[i]) ? 0U : ((uint32_t)a[i] - b[i])",
    ),
    "lanes reversed in the word": ("sad.h", "sum += (a[i] < b[i])", "sum += (a[i ^ 3U] < b[i])"),
    "distance of 8 bits": ("vpr.c", "(uint16_t)distance", "(uint8_t)distance"),
    "sequence one too short": (
        "vpr.c",
        "for (uint32_t i = 1U; i < d->length; i++)",
        "for (uint32_t i = 2U; i < d->length; i++)",
    ),
    "sequence down a column": ("vpr.c", "at -= d->place_count + 1U;", "at -= d->place_count;"),
    "sequence the other way": ("vpr.c", "at -= d->place_count + 1U;", "at -= d->place_count - 1U;"),
    "matches before the sequence is complete": (
        "vpr.c",
        "complete = s->seen == d->length",
        "complete = s->seen + 1U >= d->length",
    ),
    "matches where the diagonal leaves the map": (
        "vpr.c",
        "((place + 1U) >= d->length)",
        "((place + 2U) >= d->length)",
    ),
    "misses the first place": ("vpr.c", "((place + 1U) >= d->length)", "(place >= d->length)"),
    "misses the last place": (
        "vpr.c",
        "place < d->place_count; place++",
        "place + 1U < d->place_count; place++",
    ),
    "ties to the highest place": ("vpr.c", "(sum < m->sum)", "(sum <= m->sum)"),
    "ties of seconds to the highest": ("vpr.c", "(sum < m->second_sum)", "(sum <= m->second_sum)"),
    "ties on the left to the highest": (
        "vpr.c",
        "(left_sum < f->left_sum)",
        "(left_sum <= f->left_sum)",
    ),
    "zone too narrow on the right": (
        "vpr.c",
        "(place - m->place) > d->exclusion",
        "(place - m->place) >= d->exclusion",
    ),
    "zone too wide on the right": (
        "vpr.c",
        "(place - m->place) > d->exclusion",
        "(place - m->place) > d->exclusion + 1U",
    ),
    "zone too wide on the left": (
        "vpr.c",
        "f->taken > d->exclusion",
        "f->taken > d->exclusion + 1U",
    ),
    "keeps the old second": (
        "vpr.c",
        "        m->second = f->left;\n",
        "        m->second = (f->taken == 0U) ? f->left : m->second;\n",
    ),
    "does not count ties anew": (
        "vpr.c",
        "        m->ties = 0U;\n",
        "        m->ties = (f->taken == 0U) ? 0U : m->ties;\n",
    ),
    "accepts without a second": (
        "vpr.c",
        "        return false;\n    }\n    if (d->ratio_denominator",
        "        return true;\n    }\n    if (d->ratio_denominator",
    ),
    "margin is strict": (
        "vpr.c",
        "(m->second_sum - m->sum) >= d->accept",
        "(m->second_sum - m->sum) > d->accept",
    ),
    "ratio is strict": ("vpr.c", "<= (m->second_sum * d->accept)", "< (m->second_sum * d->accept)"),
    "ratio of nothing to nothing": ("vpr.c", "(m->second_sum != 0U) &&\n           ", ""),
    "ratio upside down": (
        "vpr.c",
        "(m->sum * d->ratio_denominator) <= (m->second_sum * d->accept)",
        "(m->sum * d->accept) <= (m->second_sum * d->ratio_denominator)",
    ),
}


@pytest.fixture(scope="session")
def mutated(folder):
    """Make the firmware with one change, for the smallest processor: it has the portable code."""
    target = EMULATED[0]

    def make(number: int, file: str, old: str, new: str) -> Emulator:
        sources = folder / f"mutation-{number}"
        shutil.copytree(SOURCES, sources)
        text = (sources / file).read_text(encoding="ascii")
        assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times in {file}"
        (sources / file).write_text(text.replace(old, new), encoding="ascii")
        return Emulator(target, build(target, folder, sources=sources, name=f"m{number}"))

    return make


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_broken_firmware_fails_the_vectors(name, mutated, cases, expected):
    """The suite `corners` alone finds every one of these faults."""
    broken = mutated(list(MUTATIONS).index(name), *MUTATIONS[name])
    for case in cases["corners"]:
        try:
            found = emulated(broken, case)
        except ToolError:
            return  # it ran into memory that is not there
        if found != expected[case.name]:
            return
    pytest.fail(f"no case of the suite finds a firmware that {name}")
