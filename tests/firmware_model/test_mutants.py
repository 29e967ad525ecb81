"""Generated faults of the firmware: what is generated, and that no vector misses one unproved."""

from __future__ import annotations

import pytest

from firmware_model.emulation.build import SOURCES
from firmware_model.verification import mutants as module
from firmware_model.verification.mutants import (
    DELETED,
    Bench,
    Mutant,
    all_mutants,
    chosen,
    main,
    mutants,
    proofs,
    survey,
)

pytest.importorskip("ziglang", reason="ziglang is not installed (extra firmware)")

SOURCE = """\
/* 1 + 2 */
enum {
    AT = 3
};
#define MOST 7U

static uint32_t more(const uint8_t *a, uint32_t n)
{
    uint32_t sum = 0U;
    if (n <= MOST) {
        sum += a[n];
    }
    return sum;
}
"""


def test_each_operator_number_and_statement_is_changed_once():
    """In the code; not in comments, enumerations and types."""
    found = {(m.number, m.becomes) for m in mutants("a.c", SOURCE)}
    assert found == {
        (5, "#define MOST 8U"),
        (5, "#define MOST 6U"),
        (9, "uint32_t sum = 1U;"),
        (10, "if (true) {"),
        (10, "if (false) {"),
        (7, "static uint32_t more(const uint8_t *a, uint16_t n)"),
        (7, "static uint16_t more(const uint8_t *a, uint32_t n)"),
        (9, "uint16_t sum = 0U;"),
        (10, "if (n < MOST) {"),
        (10, "if (n >= MOST) {"),
        (11, "sum -= a[n];"),
        (11, "sum = a[n];"),
        (11, DELETED),
    }
    assert {m.function for m in mutants("a.c", SOURCE)} == {"", "more"}


CHOICES = """\
static uint32_t f(uint32_t a, uint32_t b)
{
    a = (a < b) ? b : 3U;
    b = a;
    if ((a < b) && g(b)) {
        b = 1U;
    }
    return b;
}
"""


def test_choices_and_conditions_are_held_and_statements_exchanged():
    """Statements that do not depend on each other keep their order."""
    found = {m.becomes for m in mutants("a.c", CHOICES)}
    assert {"a = b;", "a = 3U;", "if (true && g(b)) {", "if ((a < b) && true) {"} <= found
    assert "b = a; a = (a < b) ? b : 3U;" in found
    apart = CHOICES.replace("b = a;", "c = d;")
    assert "c = d; a = (a < b) ? b : 3U;" not in {m.becomes for m in mutants("a.c", apart)}


def test_a_mutant_is_told_by_its_text_and_not_by_its_line_number():
    """So that a proof holds when something else is changed above it."""
    keys = [m.key for m in mutants("a.c", SOURCE)]
    moved = SOURCE.replace("/* 1 + 2 */", "/* 1 + 2\n\n */")
    assert [m.key for m in mutants("a.c", moved)] == keys


def test_some_hundreds_are_generated_and_each_is_another_source():
    """Of every function of the firmware."""
    every = all_mutants()
    assert len(every) > 500 and len({(m.file, m.text) for m in every}) == len(every)
    text = (SOURCES / "vpr.c").read_text(encoding="ascii")
    assert all(f" {m.function}(" in text for m in every if m.file == "vpr.c" and m.function)
    assert {m.function for m in every} >= {"vpr_open", "vpr_events", "vpr_match_places", "sad"}


def test_every_proof_is_of_a_mutant_and_says_something():
    """A proof of a line that was changed since is found here already."""
    keys = {m.key for m in all_mutants()}
    assert [key for key in proofs() if key not in keys] == []
    assert all(len(why) > 10 for why in proofs().values())


def test_mutants_are_chosen_by_their_line_or_their_function():
    """So that a survivor is run again without all the others."""
    every = all_mutants()
    line = next(m for m in every if m.function == "quotient")
    place = f"{line.file}:{line.number}"
    assert {(m.file, m.number) for m in chosen(every, [place])} == {(line.file, line.number)}
    both = chosen(every, ["quotient", "sad"])
    assert {m.function for m in both} == {"quotient", "sad"}
    assert chosen(every, []) == every


def test_a_place_without_a_mutant_is_refused(capsys):
    """Beside another that has some."""
    with pytest.raises(SystemExit):
        main(["--only", "sad", "vpr.c:1"])
    assert "no mutant is at 'vpr.c:1'" in capsys.readouterr().err


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Bench:
    """The firmware, which passes, and a place for its mutants."""
    return Bench(tmp_path_factory.mktemp("mutants"))


@pytest.mark.slow
def test_a_sample_of_the_mutants_is_found_or_proved_to_be_equal(bench):
    """One in eighty; `python -m firmware_model.verification.mutants` takes all."""
    outcomes = survey(bench, all_mutants()[7::80])
    survivors = {mutant.key for mutant, outcome in outcomes.items() if outcome == "survives"}
    assert survivors - proofs().keys() == set()
    assert list(outcomes.values()).count("found") > 4


@pytest.mark.slow
def test_a_survivor_without_a_proof_and_a_proof_without_a_survivor_are_told(
    bench, monkeypatch, capsys
):
    """Either makes the command fail."""
    every, proved = all_mutants(), proofs()
    equal = next(m for m in every if m.key in proved)
    wrong = next(m for m in every if m.becomes == "s->windows--;")
    monkeypatch.setattr(module, "Bench", lambda folder: bench)
    monkeypatch.setattr(module, "all_mutants", lambda: [equal, wrong])
    for known, code, said in (
        ({equal.key: "why"}, 0, "1 found, 1 proved to be equal, 0 neither"),
        ({}, 1, f"{equal.function}: SURVIVES WITHOUT A PROOF"),
        (dict.fromkeys([equal.key, wrong.key], "why"), 1, "PROOF OF NO SURVIVOR: vpr_window_end: "),
    ):
        monkeypatch.setattr(module, "proofs", lambda known=known: known)
        assert main([]) == code
        assert said in capsys.readouterr().out


#: faults that an engineer put in, and that passed the vectors until they had cases for them
OVERLOOKED = {
    "16-bit number of events": ("vpr.c", "const uint32_t counted =", "const uint16_t counted ="),
    "no saturation at 23 bits": (
        "vpr.c", "(counted < EVENTS_TOP) ? counted : EVENTS_TOP", "counted"
    ),
    "16-bit total": ("filter.h", "uint32_t total = 0U", "uint16_t total = 0U"),
    "16-bit deviations": ("filter.h", "uint32_t deviations = 0U", "uint16_t deviations = 0U"),
    "16-bit sum of the first window's deviations": (
        "filter.h", "    uint32_t sum = 0U;\n    for", "    uint16_t sum = 0U;\n    for"
    ),
    "16-bit sum over the blocks": (
        "filter.h", "        uint32_t sum = 0U;\n", "        uint16_t sum = 0U;\n"
    ),
    "16-bit sum of a sequence": (
        "vpr.c", "uint32_t sum = s->history[at]", "uint16_t sum = s->history[at]"
    ),
    "range of a jump of a few steps": (
        "filter.h", "((d->steps > FEW_STEPS) ? d->steps : FEW_STEPS) - 1U", "d->steps - 1U"
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("fault", OVERLOOKED)
def test_faults_that_were_overlooked_are_found(bench, fault):
    """Each needs a number above 16 or 23 bits, or a design of fewer than three steps."""
    file, old, new = OVERLOOKED[fault]
    text = (SOURCES / file).read_text(encoding="ascii")
    assert text.count(old) == 1
    assert bench.run(Mutant(file, "", 0, old, new, text.replace(old, new))) == "found"
