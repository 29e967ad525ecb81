"""The reference firmware on every target: it does what the vectors say, at the stated cost."""

from __future__ import annotations

import csv
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from designs import random_stream, wrapped

from firmware_model import Design, DesignError, Event, Memories, ToolError
from firmware_model.emulation.build import EMULATED, HOST, SOURCES, build
from firmware_model.emulation.emulator import OUT_WORDS, Emulator
from firmware_model.emulation.instructions import (
    FILTER,
    TABLE,
    Instructions,
    compiler,
    measure,
    table,
)
from firmware_model.image import Word, image, ram_bytes
from firmware_model.vectors import (
    FILTER_CORNERS,
    Case,
    from_binary,
    in_order,
    records,
    standard_suites,
    to_binary,
)
from firmware_model.vectors.random_cases import (
    random_adaptive_design,
    random_design,
    random_memories,
)
from firmware_model.verification.images import image_cases

pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")
pytest.importorskip("unicorn", reason="unicorn is not installed (extra firmware)")
pytest.importorskip("elftools", reason="pyelftools is not installed (extra firmware)")

DESIGN = Design(width=64, height=48, pixels=25, places=40, length=4, code_bits=3)
IMAGES = image_cases()


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """One folder for all that is compiled, and the compiler's cache."""
    return tmp_path_factory.mktemp("firmware")


@pytest.fixture(scope="session")
def cases() -> dict[str, list[Case]]:
    """The suites that any design has, and that of the filter and own-mean codes."""
    adaptive = replace(DESIGN, matching="filter", length=1, code="own-mean", full_scales=(0,))
    return standard_suites(DESIGN, seed=0) | {"filter": standard_suites(adaptive, 0)["filter"]}


@pytest.fixture(scope="session")
def expected(cases) -> dict[str, bytes]:
    """What the model says to each case."""
    return {c.name: told(c) for suite in cases.values() for c in suite}


def told(case: Case) -> bytes:
    return to_binary(records(in_order(case.trace())))


def emulated(emulator: Emulator, case: Case, out_words: int = OUT_WORDS) -> bytes:
    flash, ram = image(case.memories), ram_bytes(case.design)
    return emulator.replay(flash, case.event_bytes(), case.start, ram, out_words=out_words)


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
            assert run_host(program, case, folder) == expected[case.name], case.name
    start = cases["corners"][0].start
    for wrong in ("start.mem", "", f"{start} us"):
        words = [program, folder / "image", folder / "events", wrong, folder / "out"]
        assert subprocess.run(words, capture_output=True, check=False).returncode == 2


def run_host(program: Path, case: Case, folder: Path) -> bytes:
    """The records of a case by the program of this computer; its message is an error."""
    image_file, events_file, out = (folder / f"{program.stem}.{s}" for s in ("img", "evt", "out"))
    image_file.write_bytes(image(case.memories))
    events_file.write_bytes(case.event_bytes())
    command = [*map(str, (program.absolute(), image_file, events_file, case.start, out))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ToolError(done.stderr.strip())
    return out.read_bytes()


@pytest.mark.slow
def test_events_may_be_handed_over_in_batches(emulator, cases, expected):
    """The same windows and matches for 2, 7 or all events at a time."""
    for case in (*cases["corners"], *cases["filter"]):
        whole = [r for r in from_binary(expected[case.name]) if r[0] != "event"]
        for batch in (2, 7, 1 << 20):
            flash, ram = image(case.memories), ram_bytes(case.design)
            found = emulator.replay(flash, case.event_bytes(), case.start, ram, batch)
            assert list(from_binary(found)) == whole, (case.name, batch)


def test_random_designs_on_every_emulated_processor(emulator):
    """Not only the design that the vectors were made for: 60 others, with all that may vary."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        memories = random_memories(rng, random_design(rng))
        start = int(rng.integers(0, 1 << memories.design.timestamp_bits))
        events = wrapped(random_stream(rng, memories, 150, start), memories.design)
        case = Case(str(seed), memories, tuple(events), start)
        assert emulated(emulator, case) == told(case), seed


def test_random_filters_and_own_means_on_every_emulated_processor(emulator):
    """60 designs with the place filter, own-mean codes, or both; windows that pause among them."""
    paused = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        memories = random_memories(rng, random_adaptive_design(rng))
        start = int(rng.integers(0, 1 << memories.design.timestamp_bits))
        events = wrapped(random_stream(rng, memories, 150, start), memories.design)
        case = Case(str(seed), memories, tuple(events), start)
        assert emulated(emulator, case) == told(case), seed
        paused += sum(window.paused for window in case.trace().windows)
    assert paused > 100


ODD_DESIGNS = [
    *(random_design(np.random.default_rng(seed)) for seed in range(8)),
    Design(width=1, height=1, pixels=1, places=1, length=1, code="linear", code_bits=1),
    Design(width=3, height=1, pixels=3, places=1, length=1, exclusion=0, lanes=1, tau_us=1),
]


@pytest.mark.slow
@pytest.mark.parametrize("design", ODD_DESIGNS, ids=lambda d: f"{d.width}x{d.height}-{d.pixels}")
def test_suites_can_be_made_for_any_design_and_pass(design, folder):
    """Narrow clocks, one pixel, one bit: the cases that such a design has room for."""
    target = EMULATED[1]
    emulator = Emulator(target, build(target, folder))
    suites = standard_suites(design, seed=1)
    assert len(suites["corners"]) > 15
    for case in (*suites["corners"], *suites["random"]):
        assert emulated(emulator, case) == told(case), case.name


def test_ram_is_what_the_model_says_and_no_more(emulator, cases):
    """With 16 bytes less than `ram_bytes` the firmware refuses; with it, nothing beyond is hurt."""
    case = cases["corners"][0]
    flash, events, ram = image(case.memories), case.event_bytes(), ram_bytes(case.design)
    with pytest.raises(ToolError, match="refuses"):
        emulator.replay(flash, events, case.start, ram - 16)


@pytest.mark.slow
def test_a_firmware_that_writes_behind_its_ram_is_found(folder, tmp_path, cases):
    """By the program of this computer, which fills the memory there with a pattern."""
    sources = tmp_path / "c"
    shutil.copytree(SOURCES, sources)
    text = (sources / "vpr.c").read_text(encoding="ascii")
    behind = "s->windows++;\n    s->query[vpr_ram_bytes(d)] = 0U;"
    (sources / "vpr.c").write_text(text.replace("s->windows++;", behind), encoding="ascii")
    program, case = build(HOST, folder, sources=sources, name="behind"), cases["corners"][0]
    with pytest.raises(ToolError, match="byte 0 behind the RAM was written"):
        run_host(program, case, tmp_path)


def opens(emulator: Emulator, flash: bytes) -> bool:
    emulator.release()
    design, at = emulator.put(bytes(512)), emulator.put(flash)
    return bool(emulator.call("vpr_open", design, at, len(flash)) & 1)


def test_images_are_opened_up_to_their_limits_and_refused_beyond(emulator):
    """Every word of the header, every kind of entry of the tables, and how they are laid out."""
    wrong = [c.name for c in IMAGES if opens(emulator, c.image) != c.opens]
    assert wrong == []


def test_no_word_of_an_image_may_be_large(emulator, cases):
    """Any word of the header but times, margins and what is reserved."""
    flash = bytearray(image(cases["corners"][0].memories))
    for word in set(Word) - {Word.WINDOW_KIND, Word.WINDOW, Word.ACCEPT}:
        broken = flash.copy()
        broken[word * 4 : word * 4 + 4] = (0x7FFF_FFF0).to_bytes(4, "little")
        assert opens(emulator, bytes(flash)) and not opens(emulator, bytes(broken)), word


def test_the_replay_ends_when_its_results_are_full(emulator, cases):
    """A window of a microsecond, and an event half an hour later: 2^31 windows otherwise."""
    memories = cases["corners"][0].memories
    design = replace(memories.design, tau_us=1)
    short = Memories(design, memories.pixels, memories.places, memories.tables)
    case = Case("long", short, (Event((1 << 31) - 1, 0, 0, True),))
    flash, events, size = image(short), case.event_bytes(), ram_bytes(design)
    emulator.release()
    stimulus = emulator.put(flash), len(flash), emulator.put(events), 1, 1, 0
    emulator.patience_s = 5
    memory = emulator.put(bytes(size)), size, emulator.put(bytes(4000)), 1000
    assert emulator.call("vpr_replay", *stimulus, *memory) == 0


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


@pytest.fixture(scope="session")
def measured(folder) -> dict[str, Instructions]:
    """Counted anew on every processor."""
    return {target.name: measure(target, folder) for target in EMULATED}


@pytest.mark.slow
def test_the_table_of_instructions_is_true(measured):
    """Every figure beside the sources, if they are compiled by the version that it names."""
    text = TABLE.read_text(encoding="ascii")
    assert text.splitlines()[0] == table(list(measured.values())).splitlines()[0]
    told = {row["target"]: row for row in csv.DictReader(text.splitlines())}
    assert list(told) == list(measured)
    if any(row["compiler"] != compiler() for row in told.values()):
        pytest.skip(f"the table is of {told['cortex-m4']['compiler']}, this is {compiler()}")
    assert text == table(list(measured.values()))


@pytest.mark.slow
def test_instructions_stay_within_their_limits(measured):
    """Per byte of a distance, and per event at a selected pixel."""
    for core in ("cortex-m4", "cortex-m7"):
        assert measured[core].sad_per_byte <= 2.0 and measured[core].event_selected <= 30
    for core in ("cortex-a53", "cortex-a72", "cortex-a76"):
        assert measured[core].sad_per_byte <= 0.7
    for row in measured.values():
        assert row.event_unselected < row.event_selected and row.code_bytes < 15_360
        assert row.stack_bytes < 512


@pytest.mark.slow
def test_the_filter_takes_at_most_0_75_of_sequences_of_five(measured):
    """A place and window, beside the distance that both need; and its RAM grows by 2 bytes."""
    for core in ("cortex-m4", "cortex-m7"):
        row = measured[core]
        distance = row.sad_per_byte * 150
        assert row.kept_per_place - distance <= 0.75 * (row.match_per_place - distance), core
    more = replace(FILTER, places=FILTER.places + 800)
    assert ram_bytes(more) - ram_bytes(FILTER) == 2 * 800
    assert not FILTER.keep_distances and FILTER.own_mean


def test_counted_instructions_are_those_of_a_loop_by_hand(folder):
    """Of n rounds of three instructions, between one before and one behind; counted or not before.

    `movs r1, #0; again: adds r1, #1; cmp r1, r0; bne again; bx lr`
    """
    target = EMULATED[0]
    emulator = Emulator(target, build(target, folder, name="by-hand"))
    code = bytes.fromhex("0021 0131 8142 fcd1 7047")
    emulator.symbols["loop"] = (emulator.put(code) | 1, len(code))
    emulator.call("loop", 5)
    for rounds in (1, 2, 100):
        emulator.call("loop", rounds, count=True)
        assert emulator.instructions == 2 + 3 * rounds


def test_a_firmware_that_does_not_return_is_given_up(folder):
    """`b .` in the place of a function."""
    emulator = Emulator(EMULATED[0], build(EMULATED[0], folder, name="by-hand"))
    emulator.symbols["loop"] = (emulator.put(bytes.fromhex("fee7")) | 1, 2)
    emulator.patience_s = 0.1
    with pytest.raises(ToolError, match="has not returned"):
        emulator.call("loop")


CLEAR = "            s->counts[i] = 0U;\n        }\n    }\n    s->window_end"
TIME_LEFT = "(window_end - (e->t * time_scale))"
NOT_SELECTED = "if (lookup[at].pixel != pixel) {\n            continue;"
NOBODYS = "if (lookup[at].pixel == VPR_NONE)"


# What a careless engineer might write: each a change of the sources that compiles.
MUTATIONS = {
    # counting
    "saturates one too late": ("vpr.c", "count < count_max", "count <= count_max"),
    "saturates one too early": ("vpr.c", "count < count_max", "count + 1U < count_max"),
    "wraps instead of saturating": ("vpr.c", "(count + 1U) : count)", "(count + 1U) : 0U)"),
    "does not clear": ("vpr.c", CLEAR, "        }\n    }\n    s->window_end"),
    "clears all but the last": (
        "vpr.c",
        CLEAR,
        "            s->counts[i] = (i + 1U == d->slots) ? s->counts[i] : 0U;\n        }\n"
        "    }\n    s->window_end",
    ),
    "clears before it encodes": (
        "vpr.c",
        "        s->query[i] = d->code",
        "        s->counts[i] = 0U;\n        s->query[i] = d->code",
    ),
    "swaps polarities": ("vpr.c", "lookup[at].slot[pixel_on", "lookup[at].slot[~pixel_on"),
    "ignores the polarity": (
        "vpr.c",
        "lookup[at].slot[pixel_on >> ON_SHIFT]",
        "lookup[at].slot[1]",
    ),
    # look-up
    "does not look at the owner": ("vpr.c", "if (lookup[at].pixel != pixel)", NOBODYS),
    "looks at the owner's row only": (
        "vpr.c",
        "if (lookup[at].pixel != pixel)",
        "if ((lookup[at].pixel >> ROW_SHIFT) != y)",
    ),
    "looks at the owner's column only": (
        "vpr.c",
        "if (lookup[at].pixel != pixel)",
        "if ((uint16_t)lookup[at].pixel != (uint16_t)pixel)",
    ),
    "takes the polarity for a row": (
        "vpr.c",
        "        const uint32_t pixel = pixel_on & PIXEL_MASK;\n",
        "        const uint32_t pixel = pixel_on;\n",
    ),
    "forgets the displacement": (
        "vpr.c",
        "(pixel_on & COLUMN_MASK) + displacement[y]",
        "(pixel_on & COLUMN_MASK) + (0U * displacement[y])",
    ),
    "look-up does not wrap": (
        "vpr.c",
        "+ displacement[y]) & lookup_mask;",
        "+ displacement[y]);\n        if (at > lookup_mask) {\n            continue;\n        }",
    ),
    # windows
    "boundary belongs to the old window": ("vpr.c", TIME_LEFT + " <= 0", TIME_LEFT + " < 0"),
    "window is one microsecond short": ("vpr.c", TIME_LEFT + " <= 0", TIME_LEFT + " <= 1"),
    "compares times unsigned": (
        "vpr.c",
        "if ((int32_t)(window_end - (e->t * time_scale)) <= 0)",
        "if ((time_scale != 0U) && (window_end <= (e->t * time_scale)))",
    ),
    "takes a late event for a wrap": (
        "vpr.c",
        "if ((int32_t)(window_end - (e->t * time_scale)) <= 0)",
        "if ((time_scale != 0U) && ((window_end - (e->t * time_scale) - 1U) >= d->tau))",
    ),
    "clock of 32 bits always": (
        "vpr.c",
        "((uint32_t)1U << (32U - image[AT_TIMESTAMP_BITS]))",
        "1U",
    ),
    "next window starts late": (
        "vpr.c",
        "    s->window_end += d->tau;",
        "    s->window_end += d->tau + 1U;",
    ),
    "drops the event behind the window": (
        "vpr.c",
        "<= 0) {\n            status = VPR_WINDOW_ENDS;",
        "<= 0) {\n            e = &e[1];\n            status = VPR_WINDOW_ENDS;",
    ),
    "ends one window of a gap": (
        "replay.c",
        "            end_window(&writer, &design, &state, (uint32_t)(next - events));\n",
        "            end_window(&writer, &design, &state, (uint32_t)(next - events));\n"
        "            if (next != end && design.tau != 0U) {\n"
        "                state.window_end = next->t * design.time_scale + design.tau;\n"
        "            }\n",
    ),
    "budget off by one": ("vpr.c", "s->left = d->budget; /*", "s->left = d->budget + 1U; /*"),
    "budget counts every event": (
        "vpr.c",
        NOT_SELECTED,
        NOT_SELECTED.replace("continue", "left--;\n            continue"),
    ),
    "budget counts what saturates not": (
        "vpr.c",
        "        left--;\n",
        "        left -= (count < count_max) ? 1U : 0U;\n",
    ),
    "budget is not reset": ("vpr.c", "    s->left = d->budget; /*", "    /*"),
    # codes
    "one code table for all": (
        "vpr.c",
        "d->code_table[i] * (d->count_max + 1U)",
        "d->code_table[0] * (d->count_max + 1U)",
    ),
    "code tables too close": ("vpr.c", "* (d->count_max + 1U))", "* d->count_max)"),
    "no code": (
        "vpr.c",
        "d->code[(d->code_table[i] * (d->count_max + 1U)) + s->counts[i]]",
        "(uint8_t)s->counts[i]",
    ),
    # distances
    "distance forgets the last word": ("vpr.c", "codes, d->stride)", "codes, d->stride - 16U)"),
    "distance is not absolute": ("sad.h", "((uint32_t)b[i] - a[i]) :", "0U :"),
    "lanes reversed in the word": ("sad.h", "sum += (a[i] < b[i])", "sum += (a[i ^ 3U] < b[i])"),
    "distance of 8 bits": ("vpr.c", "(uint16_t)distance", "(uint8_t)distance"),
    "places one lane apart": (
        "vpr.c",
        "codes = &codes[d->stride];\n    }\n    m->trust",
        "codes = &codes[d->stride - ((place == 1U) ? 1U : 0U)];\n    }\n    m->trust",
    ),
    # sequences
    "sequence one too short": ("vpr.c", "i = 1U; i < d->length; i++", "i = 2U; i < d->length; i++"),
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
    # search
    "misses the first place": ("vpr.c", "((place + 1U) >= d->length)", "(place >= d->length)"),
    "misses the last place": (
        "vpr.c",
        "place < d->place_count; place++) {\n        const uint32_t distance",
        "place + 1U < d->place_count; place++) {\n        const uint32_t distance",
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
    # acceptance
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


FILTER_MUTATIONS = {
    "step of two places too dear": ("filter.h", "lower + two)", "lower + two + 40U)"),
    "step of three places too dear": ("filter.h", "lowest + three)", "lowest + three + 40U)"),
    "steps by activity from the place itself": (
        "filter.h",
        "metric[at - i] + costs[i]",
        "metric[at] + costs[i]",
    ),
    "fixed steps from the place itself": (
        "filter.h",
        "metric[at - i] + p->fixed[i]",
        "metric[at] + p->fixed[i]",
    ),
    "places at half windows without their longest step": (
        "vpr.c",
        "NEAR : HALF_STEPS)",
        "NEAR : (HALF_STEPS - 1U))",
    ),
    "costs of whole windows at half windows": ("filter.h", "(p->steps == NEAR) ?", "true ?"),
    "steps back see what has changed": (
        "filter.h",
        "(uint32_t)p->ahead[i] + p->back[i]",
        "(uint32_t)metric[at + 1U + i] + p->back[i]",
    ),
    "delay line of one": ("filter.h", "i = p->above; i > 1U; i--", "i = 1U; i > 1U; i--"),
    "restart at no cost": ("filter.h", "? 0U : d->restart", "? 0U : 0U"),
    "first window is a later one": ("filter.h", "? 0U : d->restart", "? d->restart : d->restart"),
    "metrics are not put back": (
        "filter.h",
        "((i < d->steps) ? d->cost[i] : FAR) - s->least",
        "((i < d->steps) ? d->cost[i] : FAR)",
    ),
    "evidence without a limit": ("filter.h", "lesser(scaled, EVIDENCE_TOP)", "scaled"),
    "metrics without a limit": ("filter.h", "+ against, METRIC_TOP);", "+ against, FAR);"),
    "evidence of full weight": (
        "filter.h",
        "(lesser(scaled, EVIDENCE_TOP) * weight) >> WEIGHT_BITS",
        "lesser(scaled, EVIDENCE_TOP) + (0U * weight)",
    ),
    "weight before the limit of the evidence": (
        "filter.h",
        "(lesser(scaled, EVIDENCE_TOP) * weight) >> WEIGHT_BITS",
        "lesser((scaled * weight) >> WEIGHT_BITS, EVIDENCE_TOP)",
    ),
    "weight from another activity": (
        "filter.h",
        "#define WEIGHT_FROM 48 ",
        "#define WEIGHT_FROM 47 ",
    ),
    "negative weight": (
        "filter.h",
        "(above > 0) ? lesser((uint32_t)above >> 1",
        "true ? lesser((uint32_t)above >> 1",
    ),
    "activities are not rounded": ("filter.h", "#define ROW_ORIGIN 100 ", "#define ROW_ORIGIN 96 "),
    "one row of costs too few": ("filter.h", "ROW_BITS, ROWS - 1U)", "ROW_BITS, ROWS - 2U)"),
    "rows of costs wrap at the bottom": (
        "filter.h",
        "return (above > 0) ? lesser((uint32_t)above >> ROW_BITS",
        "return true ? lesser((uint32_t)above >> ROW_BITS",
    ),
    "costs of the place that is left": (
        "filter.h",
        "row_of(activity, place_activity[at])",
        "row_of(activity, place_activity[at - 1U])",
    ),
    "activity without that of the place": (
        "filter.h",
        "above = activity - of_place",
        "above = activity - (0 * of_place)",
    ),
    "one entry of the costs": ("filter.h", "{5U, 1U, 10U, 26U}", "{5U, 1U, 10U, 25U}"),
    "one entry of the costs at half windows": ("filter.h", "28U, 34U}", "28U, 35U}"),
    "scaled by the spread of this window": (
        "filter.h",
        "(s->reciprocal != 0U)) {",
        "(s->reciprocal == 1U)) {",
    ),
    "spread of nothing is nothing": ("filter.h", "(sum == 0U) ? 1U : sum", "(sum < 2U) ? 2U : sum"),
    "distances of another block": (
        "filter.h",
        "&d->places[from * d->stride]",
        "&d->places[0]",
    ),
    "zone of the filter too narrow": (
        "filter.h",
        "best + d->exclusion + 1U",
        "best + d->exclusion",
    ),
    "trust does not begin anew": (
        "filter.h",
        "follows ? s->support : 0U",
        "follows ? s->support : s->support",
    ),
    "residuals of three windows": (
        "filter.h",
        "s->residual_before = s->residual;",
        "s->residual_before = 0U;",
    ),
    "margins without a limit": ("filter.h", "lesser(margin, MARGIN_TOP)", "margin"),
    "a pause does not fit": (
        "filter.h",
        "s->paused ? 0U : residual_of",
        "s->paused ? 1U : residual_of",
    ),
    "trust follows too far": ("filter.h", "<= (d->back + last)", "<= (d->back + last + 1U)"),
    "logarithms of whole octaves": (
        "vpr.c",
        "number >= sixteenth[above]",
        "number == sixteenth[above]",
    ),
    "activity of all events so far": (
        "vpr.c",
        "(int32_t)event_log(s->usual >> ACTIVITY_BITS)",
        "(int32_t)event_log(d->activity >> ACTIVITY_BITS)",
    ),
    "no mean of the window": ("vpr.c", "if (!d->contrast) {", "if (true) {"),
    "the mean of the window is cut off": ("vpr.c", "(sum * 2U) + d->slots", "sum * 2U"),
    "the mean of the window without that of the pixels": (
        "vpr.c",
        "+ LEVEL_MAX) - rounded_mean(s, i);",
        "+ LEVEL_MAX);",
    ),
    "pauses are windows": ("vpr.c", "events <= (below >> PAUSE_BITS)", "(below & 0U) != 0U"),
    "a window of few events is none that pauses": (
        "vpr.c",
        "events <= (below >> PAUSE_BITS)",
        "events == (below & 0U)",
    ),
    "means move in pauses": ("vpr.c", "        if (!s->paused) {\n", "        if (true) {\n"),
    "means move by one shift": (
        "vpr.c",
        "(s->mean_windows < (2U << shift)) ? shift : (shift + 1U)",
        "shift",
    ),
    "differences round to zero": (
        "filter.h",
        "((value - target) + ((1U << shift) - 1U)) >> shift",
        "(value - target) >> shift",
    ),
    "codes wrap at the bottom": (
        "vpr.c",
        "((above > mean) ? (above - mean) : 0U)",
        "(above - mean)",
    ),
    "codes wrap at the top": ("vpr.c", "(uint8_t)lesser(octaves, code_max)", "(uint8_t)octaves"),
    "any trust is accepted": ("vpr.c", " || (m->trust < d->trust)", ""),
    "trust is strict": ("vpr.c", "(m->trust < d->trust)", "(m->trust <= d->trust)"),
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
        # what is not changed is compiled once, and a fault is one at any level of optimisation
        replay = "replay.c" if file == "replay.c" else str(SOURCES / "replay.c")
        quickly = ("-O0", "-fno-sanitize=undefined")
        name = f"m{number}"
        files = ("vpr.c", replay)
        elf = build(target, folder, sources=sources, files=files, name=name, options=quickly)
        emulator = Emulator(target, elf)
        emulator.patience_s = 5
        return emulator

    return make


def finds(broken: Emulator, cases: list[Case], expected: dict[str, bytes]) -> bool:
    """Return whether a case has another result, or none; the shortest cases first."""
    for case in sorted(cases, key=lambda case: len(case.events)):
        try:
            found = emulated(broken, case, len(expected[case.name]) // 2)  # twice as much
        except ToolError:
            return True  # it ran into memory that is not there, or for ever
        if found != expected[case.name]:
            return True
    return False


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_broken_firmware_fails_the_vectors(name, mutated, cases, expected):
    """The suite `corners` alone finds every one of these faults."""
    broken = mutated(list(MUTATIONS).index(name), *MUTATIONS[name])
    assert finds(broken, cases["corners"], expected), name


def test_the_pages_say_how_many_corners_and_faults_there_are():
    """Of the filter, too."""
    docs = Path(__file__).parents[2] / "docs"
    vectors, testing = (
        " ".join((docs / page).read_text(encoding="utf-8").split())
        for page in ("vectors.md", "testing.md")
    )
    assert f"{len(FILTER_CORNERS)} corners" in vectors
    assert f"`corners` finds all {len(MUTATIONS)} faults" in testing
    assert f"`filter` all {len(FILTER_MUTATIONS)} faults of the filter" in testing


@pytest.mark.slow
@pytest.mark.parametrize("name", FILTER_MUTATIONS)
def test_a_broken_filter_fails_the_vectors(name, mutated, cases, expected):
    """The suite `filter` alone finds every one of these faults."""
    broken = mutated(1000 + list(FILTER_MUTATIONS).index(name), *FILTER_MUTATIONS[name])
    assert finds(broken, cases["filter"], expected), name
