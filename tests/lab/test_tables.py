"""Tables of pages come from CSV files, with the trials of each row joined."""

from __future__ import annotations

import pytest
from lab.tables import TableView, mean_and_deviation, table_of, with_tables

from edge_vpr.errors import UsageError

CSV = """drives,method,seed,P@100R,bytes
street,ours,0,0.5,57
street,ours,1,0.7,57
street,dense,0,0.25,16384
walks,ours,0,1.0,57
"""
ROWS = [
    dict(zip(CSV.split("\n")[0].split(","), line.split(","), strict=True))
    for line in CSV.strip().split("\n")[1:]
]


def test_trials_that_differ_in_their_seed_alone_are_one_row():
    assert table_of(ROWS).split("\n") == [
        "| drives | method | P@100R | bytes |",
        "| --- | --- | --- | --- |",
        "| street | ours | 0.600 ± 0.141 | 57 |",
        "| street | dense | 0.250 | 16,384 |",
        "| walks | ours | 1.000 | 57 |",
    ]


def test_a_column_goes_across_and_what_was_not_measured_is_a_dash():
    view = TableView.parse("across = drives; columns = method, P@100R")
    assert table_of(ROWS, view).split("\n") == [
        "| method | street | walks |",
        "| --- | --- | --- |",
        "| ours | 0.600 ± 0.141 | 1.000 |",
        "| dense | 0.250 | - |",
    ]


def test_several_columns_go_across_and_the_page_may_name_them():
    text = "across = drives; method = ours | dense; columns = method, P@100R, bytes"
    shown = table_of(ROWS, TableView.parse(text)).split("\n")
    assert shown[0] == "| method | street, P@100R | street, bytes | walks, P@100R | walks, bytes |"
    text += "; titles = system, street, its bytes, walks, their bytes"
    assert table_of(ROWS, TableView.parse(text)).split("\n") == [
        "| system | street | its bytes | walks | their bytes |",
        *shown[1:],
    ]


def test_rows_of_one_value_are_shown_without_its_column():
    view = TableView.parse("drives = walks")
    assert table_of(ROWS, view).split("\n")[::2] == [
        "| method | P@100R | bytes |",
        "| ours | 1.000 | 57 |",
    ]


def test_rows_of_several_values_are_shown_with_their_column():
    view = TableView.parse("method = ours | dense; drives = street; columns = method, bytes")
    assert table_of(ROWS, view).split("\n")[2:] == ["| ours | 57 |", "| dense | 16,384 |"]


def test_a_table_without_seeds_is_shown_as_it_is():
    assert table_of([{"system": "LENS", "P@100R": "0.8"}]).endswith("| LENS | 0.8 |")


@pytest.mark.parametrize(
    ("cells", "shown"),
    [([], "-"), (["", ""], "-"), (["12.34"], "12.3"), (["1500.4"], "1,500"), (["a", "a"], "a")],
)
def test_a_cell_has_as_many_digits_as_are_read(cells, shown):
    assert mean_and_deviation(cells) == shown


def test_the_table_behind_a_marker_is_replaced_and_the_rest_stays(tmp_path):
    (tmp_path / "rivals.csv").write_text(CSV)
    page = "Text.\n\n<!-- table: rivals.csv drives = walks; columns = method, bytes -->\n{}\nEnd.\n"
    filled = with_tables(page.format("\n| old |\n| --- |\n"), tmp_path)
    assert filled == page.format("\n| method | bytes |\n| --- | --- |\n| ours | 57 |\n")
    assert with_tables(filled, tmp_path) == filled
    assert with_tables(page.format(""), tmp_path) == filled


@pytest.mark.parametrize(
    ("view", "reason"),
    [
        ("drive = walks", "no column 'drive'"),
        ("drives = moon", "no row has {'drives': 'moon'}"),
        ("columns = method, P@100R; titles = system", "1 titles for 2 columns"),
    ],
)
def test_a_marker_that_names_what_is_not_there_is_refused(tmp_path, view, reason):
    (tmp_path / "rivals.csv").write_text(CSV)
    with pytest.raises(UsageError) as caught:
        with_tables(f"<!-- table: rivals.csv {view} -->\n", tmp_path)
    assert reason in str(caught.value)
