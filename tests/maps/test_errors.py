"""Messages that are one clean line whatever they quote."""

from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import LONGEST_MESSAGE, EdgeVprError, MissingExtraError, UsageError, printable


@given(st.text() | st.binary().map(lambda raw: raw.decode("utf-8", errors="surrogateescape")))
def test_a_message_is_one_printable_line_that_can_be_encoded(text):
    line = str(UsageError(f"file {text} is wrong: name another"))
    assert line.isprintable()
    assert len(line.splitlines()) == 1
    line.encode("utf-8")


@pytest.mark.parametrize(
    ("raw", "shown"),
    [
        ("a\x1b[2Jb", "a\\x1b[2Jb"),
        ("two\nlines\r\nand\ttabs", "two lines and tabs"),
        ("\u202egnp.exe", "\\u202egnp.exe"),
        ("bell\x07 \x9b31m", "bell\\x07 \\x9b31m"),
        ("name\udcff", "name\\udcff"),
        ("Brückenstraße 3 µs", "Brückenstraße 3 µs"),
    ],
)
def test_what_a_terminal_would_obey_is_spelled_out(raw, shown):
    assert printable(raw) == shown


def test_a_long_message_keeps_its_beginning_and_its_remedy():
    line = str(EdgeVprError(f"file {'x' * 5_000} is wrong: name another"))
    assert len(line) <= LONGEST_MESSAGE
    assert line.startswith("file xxx")
    assert line.endswith("xxx is wrong: name another")


def test_a_missing_extra_is_one_line_and_the_same_behind_a_pickle():
    error = MissingExtraError("the file a\x1bb", "no_library", "formats")
    assert str(error).startswith("the file a\\x1bb needs the library no_library, which is not")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
