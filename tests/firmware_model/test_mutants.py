"""Generated faults of the firmware: what is generated, and that vectors find them."""

from __future__ import annotations

from zlib import crc32

import pytest

from firmware_model.emulation.build import SOURCES
from firmware_model.errors import ToolError
from firmware_model.verification import hardware_mutants
from firmware_model.verification import mutants as module
from firmware_model.verification.mutants import (
    DELETED,
    Bench,
    Mutant,
    all_mutants,
    chosen,
    main,
    mutants,
)
from firmware_model.verification.outcomes import Outcomes, equal_mutants

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


def test_some_hundreds_are_generated_and_each_is_another_source():
    """Of every function of the firmware."""
    every = all_mutants()
    assert len(every) > 500 and len({(m.file, m.text) for m in every}) == len(every)
    text = (SOURCES / "vpr.c").read_text(encoding="ascii")
    assert all(f" {m.function}(" in text for m in every if m.file == "vpr.c" and m.function)
    assert {m.function for m in every} >= {"vpr_open", "vpr_events", "vpr_match_places", "sad"}


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
def test_a_fault_is_found_and_an_equal_change_survives(bench, monkeypatch, capsys):
    """The command prints the survivor alone."""
    every = all_mutants()
    wrong = next(m for m in every if m.becomes == "s->windows--;")
    text = (SOURCES / wrong.file).read_text(encoding="ascii")
    equal = Mutant(wrong.file, wrong.function, wrong.number, "one", "another", text + "\n")
    monkeypatch.setattr(module, "Bench", lambda folder: bench)
    monkeypatch.setattr(module, "all_mutants", lambda: [equal, wrong])
    main([])
    out = capsys.readouterr().out
    assert f"1 of 2: {equal.place}: survives\n2 of 2: {wrong.place}: found\n" in out
    assert "survives\n  - one\n  + another\n2 mutants; found: 1, survives: 1\n" in out


@pytest.mark.slow
def test_a_sample_of_the_mutants_is_found_or_equal(bench):
    """One in eighty; `python -m firmware_model.verification.mutants` takes all.

    Chosen by what it changes, so that a change of another line chooses no other ones.
    """
    sample = [m for m in all_mutants() if not crc32("".join(m.change).encode()) % 80]
    survivors = {m.change for m in sample if bench.run(m) == "survives"}
    assert len(sample) > 15
    assert survivors - equal_mutants().keys() == set()


def test_a_run_goes_on_where_it_was_ended(tmp_path, capsys):
    """Of the same sources and vectors; what is equal is said with its reason."""
    every, keep = list(mutants("a.c", SOURCE))[:3], tmp_path / "kept.csv"
    Outcomes(every, "digest", keep).add(every[0], "found", "corners/walk")
    again = Outcomes(every, "digest", keep)
    assert again.left() == every[1:]
    for mutant in again.left():
        again.add(mutant, "survives")
    assert "3 of 3: a.c:" in capsys.readouterr().out
    assert list(again.report())[-1] == "3 mutants; found: 1, survives: 2"
    assert Outcomes(every, "digest", keep).left() == []
    with pytest.raises(ToolError, match="of other sources or vectors: name a new file"):
        Outcomes(every, "another", keep)


def test_each_equal_mutant_is_one_of_the_sources():
    """A reason that nothing needs any more goes."""
    encoder = mutants("evpr.c", (SOURCES / "evpr.c").read_text(encoding="ascii"))
    every = [*all_mutants(), *encoder, *hardware_mutants.all_mutants()]
    assert equal_mutants().keys() <= {mutant.change for mutant in every}
    assert all(equal_mutants().values())
